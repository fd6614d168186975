"""Keys of sealed worlds: what each hides, and what its asked grasps measured; hashed before anybody answers.

The keys lie in a folder of their own beside the challenge's, which goes to nobody until the answers are in.
"""

import hashlib
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fast.flows.challenge.answers import GRADED_MM, LIFT_MM
from fast.flows.challenge.hidden.worlds import WorldKey
from fast.flows.challenge.manifest import Manifest
from fast.models.errors import UsageError
from fast.models.records import Record
from fast.models.traces.step_features import STEP_MM
from fast.models.validation import load_record, parse_json

FILE, WITHHELD = "keys.jsonl", "withheld.parquet"
_N_GRADED = round(GRADED_MM / STEP_MM)


class SealedKey(Record):
    """The key of a world. before_n: error of the asked grasps with theta alone, root mean square in N.

    twin_n: the same in the world without what is hidden, which nobody can close. bound: how probably the likelihood
    ratio sees what is hidden. withheld: hash of the forces that the asked grasps measured.
    """

    world: str
    salt: str
    key: WorldKey
    before_n: float
    twin_n: float
    bound: float
    withheld: str

    @property
    def key_hash(self) -> str:
        """SHA-256 of all of it; the salt keeps it from being guessed."""
        return hash_key(self.salt, self)


def hash_key(salt: str, key: Record) -> str:
    """Return the SHA-256 of a salt and a key."""
    return hashlib.sha256(f"{salt}|{key.model_dump_json()}".encode()).hexdigest()


def name_challenge(hashes: dict[str, str]) -> str:
    """Return the id of a set of worlds: of the hashes of their keys."""
    return "C" + hashlib.sha256("|".join(hashes.values()).encode()).hexdigest()[:11]


def hash_forces(forces: dict[str, np.ndarray]) -> str:
    """Hash forces (80 each, N) by grasp, to a thousandth of a newton."""
    digest = hashlib.sha256()
    for name in sorted(forces):
        digest.update(name.encode() + np.round(1e3 * forces[name]).astype("<i8").tobytes())
    return digest.hexdigest()


def find_keys(folder: Path) -> Path:
    """Find where the keys of a challenge's folder lie, unless told otherwise."""
    whole = folder if folder.name not in ("", "..") else folder.resolve()
    return whole.with_name(f"{whole.name}_keys")


def write_keys(folder: Path, keys: list[SealedKey], withheld: dict[str, dict[str, np.ndarray]]) -> None:
    """Write keys, and what asked grasps measured (80 each, N) by world and grasp."""
    folder.mkdir(parents=True)
    (folder / FILE).write_text("".join(key.model_dump_json() + "\n" for key in keys), encoding="utf-8")
    rows = [(world, name, force_n) for world, of_world in withheld.items() for name, force_n in of_world.items()]
    columns = {
        "world": np.repeat([world for world, _, _ in rows], _N_GRADED),
        "grasp_id": np.repeat([name for _, name, _ in rows], _N_GRADED),
        "lift_mm": np.tile(LIFT_MM, len(rows)),
        "force_n": np.round(np.concatenate([force_n for _, _, force_n in rows]), 3),
    }
    pq.write_table(pa.table(columns), folder / WITHHELD, compression="zstd", compression_level=19)


def open_keys(folder: Path, challenge: Path) -> tuple[list[SealedKey], dict[str, dict[str, np.ndarray]]]:
    """Open the keys of a challenge's worlds and the withheld forces, every hash checked.

    Raises:
        UsageError: there are none, they are of other worlds, or were changed after they were sealed.
    """
    path, manifest = folder / FILE, Manifest.read(challenge)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        table = pq.read_table(folder / WITHHELD, columns=["world", "grasp_id", "force_n"])
        force_n = np.array(table["force_n"]).reshape(-1, _N_GRADED)
    except (OSError, ValueError) as error:  # those of Arrow are ValueErrors, too
        cause = str(error).splitlines()[0]
        raise UsageError(
            f"the keys of {challenge} cannot be read in {folder} ({cause}); who made the challenge has them: give "
            "their folder as --keys."
        ) from error
    keys = {}
    for number, line in enumerate(lines, start=1):
        key = load_record(SealedKey, parse_json(line, f"{path} line {number}"), f"{path} line {number}")
        keys[key.world] = key
    if name_challenge(manifest.worlds) != manifest.challenge:
        raise UsageError(
            f"the hashes in {challenge} are not those that challenge {manifest.challenge} is named after: they were "
            "changed after it was handed out; grade with the folder that the entrants got."
        )
    if missing := [name for name in manifest.worlds if name not in keys]:
        raise UsageError(f"{path} has no key of {missing[0]}; it is of another challenge than {challenge}.")
    withheld: dict[str, dict[str, np.ndarray]] = {}
    for row, at in zip(force_n, range(0, len(table), _N_GRADED), strict=True):
        withheld.setdefault(table["world"][at].as_py(), {})[table["grasp_id"][at].as_py()] = row
    for name, key_hash in manifest.worlds.items():
        if keys[name].key_hash != key_hash or hash_forces(withheld.get(name, {})) != keys[name].withheld:
            raise UsageError(
                f"the key of {name} does not fit the hash in {challenge}: it was changed after it was sealed, or is of "
                "another seed; this challenge cannot be graded with it."
            )
    return [keys[name] for name in manifest.worlds], withheld
