"""An entrant's answers: `ANSWERS.json`, and beside it, if wanted, a CSV file of the forces of the asked grasps."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from pydantic import Field

from fast.flows.challenge.manifest import Manifest, check_effect, read_families, read_table
from fast.flows.challenge.world_folder import ASKED
from fast.models.errors import UsageError
from fast.models.records import Record
from fast.models.traces.step_features import STEP_MM
from fast.models.validation import load_record, parse_json
from fast.tasks.gap.simulated import read_curves

GRADED_MM = 40.0  # of lift: beyond, little is in the fingers
LIFT_MM = STEP_MM * (np.arange(round(GRADED_MM / STEP_MM)) + 0.5)
_COLUMNS = ("world", "grasp_id", "lift_mm", "force_n")
_BEYOND_MM = 5.0  # at either end of a curve, where its first and last force are held
_MOST_NAMED = 5


class WorldAnswer(Record):
    """What is said of one world.

    missing: whether anything is missing in the simulator. probability: that something is. effect: of `effects.csv`, or
    "not listed"; empty without a name. cpu_s: what the answer cost.
    """

    world: str
    missing: bool = Field(strict=True)
    probability: float = Field(ge=0, le=1)
    effect: str = ""
    cpu_s: float | None = Field(default=None, ge=0)


class Answers(Record):
    """`ANSWERS.json`. forces: name of the file of foretold forces, beside it; none without one."""

    entrant: str = Field(min_length=1, max_length=60)
    challenge: str
    forces: str = ""
    answers: tuple[WorldAnswer, ...]

    @staticmethod
    def read(path: Path) -> "Answers":
        """Read the answers of a file.

        Raises:
            UsageError: it is no such file.
        """
        try:
            text = path.read_text(encoding="utf-8-sig")
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(f"{path} cannot be read ({error}); give the file of your answers.") from error
        return load_record(Answers, parse_json(text, str(path)), str(path))

    def check(self, folder: Path, source: str) -> None:
        """Check that these answer the worlds of a challenge's folder, each once.

        Raises:
            UsageError: they are of another challenge; a world is missing, doubled or unknown; an effect is unknown.
        """
        manifest, families = Manifest.read(folder), read_families(folder)
        if self.challenge != manifest.challenge:
            raise UsageError(
                f"{source} answers challenge `{self.challenge}`, but {folder} is `{manifest.challenge}`, made from "
                "another seed; give the folder that was answered as --challenge."
            )
        counts = Counter(one.world for one in self.answers)
        faults = {
            "not of this challenge": [name for name in counts if name not in manifest.worlds],
            "answered more than once": [name for name, n in counts.items() if n > 1],
            "not answered": [name for name in manifest.worlds if name not in counts],
        }
        told = [f"{_name(names)} {_is(names)} {what}" for what, names in faults.items() if names]
        if told:
            worlds = f"the {len(manifest.worlds)} worlds {manifest.name_worlds()}"
            raise UsageError(f"{source}: {'; '.join(told)}; answer each of {worlds} once.")
        for one in self.answers:
            if one.effect and (fault := check_effect(one.effect, families)):
                raise UsageError(f"{source}: {one.world}, effect: {fault}")
        silent = [one.world for one in self.answers if one.effect and not one.missing]
        if silent:
            raise UsageError(
                f"{source}: nothing is missing in {_name(silent)} by `missing`, and an `effect` is by name; correct "
                "one of the two."
            )


def read_forces(path: Path, folder: Path) -> dict[str, dict[str, np.ndarray]]:
    """Read foretold forces (80: means over 0.5 mm up to 40 mm of lift) by world and grasp; a world has all or none.

    Raises:
        UsageError: the file is of another form, or lacks some of a world's asked grasps, or of their lift.
    """
    manifest = Manifest.read(folder)
    found: dict[str, dict[str, np.ndarray]] = {}
    for (world, grasp_id), curve in read_curves(path, _COLUMNS, lambda row: (row["world"], row["grasp_id"])).items():
        lift_mm, force_n = curve.T
        if lift_mm[0] > _BEYOND_MM or lift_mm[-1] < GRADED_MM - _BEYOND_MM:
            raise UsageError(
                f"{path}: {grasp_id} of {world} has forces from {lift_mm[0]:g} to {lift_mm[-1]:g} mm of lift; give "
                f"them in mm, from 0 to {GRADED_MM:g}."
            )
        found.setdefault(world, {})[grasp_id] = np.interp(LIFT_MM, lift_mm, force_n)
    for world, of_world in found.items():
        if world not in manifest.worlds:
            raise UsageError(f"{path}: `{world}` is not of this challenge; its worlds are {manifest.name_worlds()}.")
        _check_grasps(path, world, of_world, list_asked(folder / world))
    return found


def list_asked(world: Path) -> list[str]:
    """List the grasps of a world whose forces are asked for."""
    return [row["grasp_id"] for row in read_table(world / ASKED)]


def _check_grasps(path: Path, world: str, of_world: Mapping[str, np.ndarray], asked: Sequence[str]) -> None:
    for names, what in (
        ([name for name in of_world if name not in asked], "not asked for"),
        ([name for name in asked if name not in of_world], "not foretold"),
    ):
        if names:
            raise UsageError(
                f"{path}: {_name(names)} of {world} {_is(names)} {what}; foretell the {len(asked)} grasps of its "
                f"{ASKED}, or none."
            )


def _name(names: Sequence[str]) -> str:
    more = len(names) - _MOST_NAMED
    return ", ".join(names[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")


def _is(names: Sequence[str]) -> str:
    return "is" if len(names) == 1 else "are"
