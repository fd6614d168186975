"""Sealed worlds: drawn from a secret, answered from data alone, judged after the answers are in the file.

Three steps, each of which leaves its file. *Seal*: data go to the folder `sealed`, a hash of every key to
`sealed.jsonl`, keys and salts to `sealed-keys.jsonl`, which only the judge opens. *Answer*: reads data,
writes `sealed-answers.jsonl` with a hash of each answer. *Judge*: checks every hash, and counts.
"""

import secrets
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np

from fast.flows.challenge.hidden.worlds import MODULI_MPA, Group, WorldKey, Worlds
from fast.flows.challenge.keys import hash_key
from fast.models.design.space import numbered_design
from fast.models.errors import UsageError
from fast.models.gap.bank.bank import Bank
from fast.models.gap.data import GapData
from fast.models.gap.evidence.rehearsal import Rehearsal
from fast.models.gap.grasps import Grasps, of_one_setup
from fast.models.records import GraspContext, Record
from fast.models.traces.step_noise import SensorNoise
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.benchmarks.outcomes import RecordFile, read_records
from tests.studies.gap.answers import Answer, answer, measure_twin, naming_code
from tests.studies.gap.development import open_panels, rehearse_worlds
from tests.studies.gap.judgement import Judged
from tests.studies.gap.local_banks import LocalBanks
from tests.studies.gap.tables import gap_tables
from tests.studies.gap.truth import results_folder

BankOf = Callable[[Sequence[int], Sequence[int]], Bank]

# Banks around fitted thetas lie on a lattice of Young's modulus; worlds of one lot of material share them.
ONE_LOT_MPA = (8.8, 9.3)
N_SEALED: dict[Group, int] = {"null": 96, "single": 96, "alias": 6, "unlisted": 32, "pair": 30}


class Sealed(Record):
    """What anybody may see of a world before it is judged."""

    world: str
    key_hash: str
    code: str


class SealedAnswer(Record):
    """The answer to a sealed world, and the hash that was written with it."""

    world: str
    answer: Answer
    answer_hash: str


class SealedKey(Record):
    """The key of a sealed world, with the salt of its hash."""

    world: str
    salt: str
    key: WorldKey

    @property
    def key_hash(self) -> str:
        """SHA-256 of salt and key."""
        return hash_key(self.salt, self.key)


def measure_gap_sealed(options: Options) -> Tables:
    """The figures of gap discovery on sealed worlds, local banks only with `--workers N`."""
    folder = results_folder(options)
    panels, bank = open_panels(folder)
    known = Worlds(panels, bank, "public", has_other_laws=True)
    rehearsal = rehearse_worlds(known, options)
    banks = None if options.workers is None else LocalBanks.of(folder, options.workers)
    if not (folder / "sealed.jsonl").exists():
        moduli_mpa = MODULI_MPA if banks is None else ONE_LOT_MPA
        worlds = Worlds(panels, bank, secrets.token_hex(16), moduli_mpa, has_other_laws=True)
        seal(worlds, folder, options)
    answer_all(folder, known.bank_of, banks, rehearsal, options)
    judged(folder)  # no key is opened before every hash is checked
    ask_without_truth(folder, known.bank_of, banks, rehearsal, options)
    twins = _measure_twins(folder, known, banks, rehearsal, options)
    found = [replace(one, twin_n=twins.get(one.key.world_id)) for one in judged(folder)]
    return gap_tables([*found, *left_out(folder)])


class Twin(Record):
    """Held-out error of a world without its effect, N."""

    world_id: str
    twin_n: float


def _measure_twins(
    folder: Path, worlds: Worlds, banks: LocalBanks | None, rehearsal: Rehearsal, options: Options
) -> dict[str, float]:
    """Errors of the twins of worlds with one effect, from the results file or measured now."""
    path = folder / "sealed-twins.jsonl"
    known = {one.world_id: one.twin_n for one in read_records(path, Twin, "twin of a sealed world")}
    with RecordFile(path) as file:
        for one in judged(folder):
            if one.key.group == "single" and one.key.world_id not in known:
                problem = worlds.problem(worlds.twin(one.key))
                twin = Twin(world_id=one.key.world_id, twin_n=measure_twin(problem, rehearsal, banks))
                known[twin.world_id] = twin.twin_n
                file.append(twin)
                options.tell(f"{twin.world_id}: {twin.twin_n:.3f} N with nothing hidden")
    return known


def seal(worlds: Worlds, folder: Path, options: Options) -> None:
    """Draw worlds in an order that tells nothing, and write data, hashes and keys."""
    counts = {group: n if options.worlds is None else min(n, options.worlds) for group, n in N_SEALED.items()}
    wanted = [(group, number) for group, n in counts.items() for number in range(n)]
    order = np.random.default_rng(secrets.randbits(64)).permutation(len(wanted))
    (folder / "sealed").mkdir(exist_ok=True)
    with RecordFile(folder / "sealed-keys.jsonl") as keys, RecordFile(folder / "sealed.jsonl") as public:
        for place, number in enumerate(order):
            group, of_group = wanted[int(number)]
            name = f"world-{place:03d}"
            key = SealedKey(world=name, salt=secrets.token_hex(16), key=worlds.draw(group, of_group))
            designs = worlds.of(key.key).panels.designs
            write_problem(folder / "sealed" / f"{name}.npz", worlds.problem(key.key), designs)
            keys.append(key)
            public.append(Sealed(world=name, key_hash=key.key_hash, code=naming_code()))
            options.tell(f"{name} sealed, {key.key_hash[:12]}")


def answer_all(folder: Path, bank_of: BankOf, banks: LocalBanks | None, rehearsal: Rehearsal, options: Options) -> None:
    """Answer every sealed world once, from its data alone.

    Raises:
        UsageError: the code is not that under which the worlds were sealed.
    """
    answers = folder / "sealed-answers.jsonl"
    known = {one.world for one in read_records(answers, SealedAnswer, "answer to a sealed world")}
    end = time.monotonic() + 60.0 * options.limit_minutes
    with RecordFile(answers) as file:
        for one in read_records(folder / "sealed.jsonl", Sealed, "sealed world"):
            if one.world in known or time.monotonic() > end:
                continue
            if one.code != naming_code():
                raise UsageError(
                    f"{one.world} was sealed for other code; move the sealed files away and seal new worlds."
                )
            said = answer(read_problem(folder / "sealed" / f"{one.world}.npz", bank_of), rehearsal, banks=banks)
            file.append(SealedAnswer(world=one.world, answer=said, answer_hash=said.answer_hash))
            options.tell(f"{one.world}: {said.rounds[0].kind}, {said.cpu_s:.1f} s")


def ask_without_truth(
    folder: Path, bank_of: BankOf, banks: LocalBanks | None, rehearsal: Rehearsal, options: Options
) -> None:
    """Ask answered worlds with one effect again, the effect taken out of the catalogue; their keys are open by now."""
    path = folder / "sealed-left-out.jsonl"
    known = {one.world for one in read_records(path, SealedAnswer, "answer to a sealed world")}
    keys = _keys(folder)
    end = time.monotonic() + 60.0 * options.limit_minutes
    with RecordFile(path) as file:
        for one in read_records(folder / "sealed-answers.jsonl", SealedAnswer, "answer to a sealed world"):
            key = keys[one.world].key
            if key.group != "single" or one.world in known or time.monotonic() > end:
                continue
            problem = read_problem(folder / "sealed" / f"{one.world}.npz", bank_of)
            said = answer(problem, rehearsal, without=key.names, max_rounds=1, banks=banks)
            file.append(SealedAnswer(world=one.world, answer=said, answer_hash=said.answer_hash))
            options.tell(f"{one.world} without its effect: {said.rounds[0].kind}")


def left_out(folder: Path) -> list[Judged]:
    """Answers of `ask_without_truth` with their keys."""
    keys = _keys(folder)
    answers = read_records(folder / "sealed-left-out.jsonl", SealedAnswer, "answer to a sealed world")
    return [Judged(keys[one.world].key, one.answer, left_out=True) for one in answers]


def _keys(folder: Path) -> dict[str, SealedKey]:
    return {one.world: one for one in read_records(folder / "sealed-keys.jsonl", SealedKey, "key of a sealed world")}


def judged(folder: Path) -> list[Judged]:
    """Answered worlds with their keys, every hash checked.

    Raises:
        UsageError: a key or an answer was changed after its hash was written.
    """
    public = {one.world: one for one in read_records(folder / "sealed.jsonl", Sealed, "sealed world")}
    keys = _keys(folder)
    found: list[Judged] = []
    for one in read_records(folder / "sealed-answers.jsonl", SealedAnswer, "answer to a sealed world"):
        if keys[one.world].key_hash != public[one.world].key_hash:
            raise UsageError(f"the key of {one.world} does not fit its hash; this sealed run is void.")
        if one.answer.answer_hash != one.answer_hash:
            raise UsageError(f"the answer to {one.world} does not fit its hash; this sealed run is void.")
        found.append(Judged(keys[one.world].key, one.answer))
    return found


def write_problem(path: Path, problem: GapData, designs: Sequence[int]) -> None:
    """Grasps of a problem and what is held out; the bank is known."""
    grasps = problem.grasps
    contexts = np.array([[getattr(c, name) for name in GraspContext.model_fields] for c in grasps.contexts])
    np.savez_compressed(
        path,
        tool=grasps.tool,
        obj=grasps.obj,
        contexts=contexts,
        steps_n=grasps.steps_n,
        designs=np.array(designs),
        objects=np.array(grasps.objects),
        noise=np.array(list(asdict(grasps.noise).values())),
        held_out_tools=problem.held_out_tools,
        held_out_objects=problem.held_out_objects,
    )


def read_problem(path: Path, bank_of: BankOf) -> GapData:
    """The problem of a file of `write_problem`. bank_of: the bank of designs and objects (numbers)."""
    with np.load(path) as file:
        data = {name: file[name] for name in file.files}
    names = list(GraspContext.model_fields)
    contexts = tuple(
        GraspContext(
            **{name: value if name == "clock_s" else int(value) for name, value in zip(names, row, strict=True)}
        )
        for row in data["contexts"].tolist()
    )
    grasps = Grasps(
        tools=tuple(f"T{number:02d}" for number in range(len(data["designs"]))),
        designs=tuple(numbered_design(int(number)) for number in data["designs"]),
        objects=tuple(int(number) for number in data["objects"]),
        tool=data["tool"],
        obj=data["obj"],
        contexts=contexts,
        steps_n=data["steps_n"],
        grasp_ids=tuple(f"g{number}" for number in range(len(contexts))),
        noise=SensorNoise(**dict(zip([f.name for f in fields(SensorNoise)], data["noise"].tolist(), strict=True))),
        **of_one_setup(len(contexts)),
    )
    bank = bank_of(data["designs"].tolist(), data["objects"].tolist())
    return GapData(grasps, bank, data["held_out_tools"], data["held_out_objects"])
