"""What a challenge's folder says of itself: its id, its worlds with the hashes of their keys, noise, and effects."""

import csv
from pathlib import Path

from fast.models.errors import UsageError
from fast.models.records import Record
from fast.models.traces.step_noise import SensorNoise
from fast.models.validation import closest, load_record, parse_json

FILE, BANK, OBJECTS, EFFECTS = "challenge.json", "bank.parquet", "objects.csv", "effects.csv"
NOT_LISTED = "not listed"
TOOLS_PER_BATCH = 7


class Manifest(Record):
    """`challenge.json`. challenge: id of the set, derived from the hashes. worlds: by name, the hash of each key."""

    challenge: str
    format: int = 1
    load_cell: SensorNoise
    worlds: dict[str, str]

    @staticmethod
    def read(folder: Path) -> "Manifest":
        """Read the manifest of a challenge's folder.

        Raises:
            UsageError: there is none, or it is of another form.
        """
        path = folder / FILE
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise UsageError(
                f"{folder} is no folder of a challenge ({FILE} cannot be read); `fast challenge start` makes one."
            ) from error
        return load_record(Manifest, parse_json(text, str(path)), str(path))

    def write(self, folder: Path) -> None:
        """Write `challenge.json`."""
        (folder / FILE).write_text(self.model_dump_json(indent=1) + "\n", encoding="utf-8")

    def name_worlds(self) -> str:
        """Name the worlds, the first to the last."""
        names = list(self.worlds)
        return f"{names[0]} to {names[-1]}"


def read_families(folder: Path) -> dict[str, str]:
    """Read the family of each effect that may be named, in words; that of `not listed` is empty."""
    return {row["effect"]: row["family"] for row in read_table(folder / EFFECTS)}


def read_table(path: Path) -> list[dict[str, str]]:
    """Read the rows of a CSV file of a challenge's folder, which nobody edits.

    Raises:
        UsageError: it cannot be read.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return list(csv.DictReader(file))
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror}); copy the challenge's folder again.") from error


def check_effect(name: str, families: dict[str, str]) -> str:
    """Say what is wrong with the name of an effect; empty if nothing is."""
    return "" if name in families else f"`{name}` is no listed effect; {closest(name, list(families))}"
