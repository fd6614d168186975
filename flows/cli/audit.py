"""Audit of the installed packages against requirements.lock, without network; part of `make check`.

It finds packages that are not pinned, other versions than the lock's, packages that nobody locked, and installed files
that changed since they were installed. It cannot know of published vulnerabilities: that is `make audit-online`.
"""

import base64
import hashlib
import re
import sys
import sysconfig
from collections.abc import Iterator
from importlib.metadata import Distribution, PackagePath, distributions
from pathlib import Path

LOCK = Path(__file__).resolve().parents[2] / "requirements.lock"
OWN = "fast-gripper-lab"
UNLOCKED = frozenset({"pip", OWN})  # `make lock` leaves them out
_PIN = re.compile(r"(?P<name>[A-Za-z0-9._-]+)==(?P<version>[A-Za-z0-9.+!_-]+)")


def locked(text: str) -> tuple[dict[str, str], list[str]]:
    """Versions by package of a lock file, and the lines that pin nothing."""
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    found = {line: _PIN.fullmatch(line) for line in lines}
    pins = {_plain(match["name"]): match["version"] for match in found.values() if match}
    return pins, [line for line, match in found.items() if match is None]


def findings(text: str) -> Iterator[str]:
    """What is wrong with the installed packages, one sentence each."""
    pins, loose = locked(text)
    yield from (f"`{line}` of the lock is no exact pin; run `make lock`." for line in loose)
    yield from mismatches(text)
    installed = _installed()
    for name in sorted(set(installed) - set(pins) - UNLOCKED):
        yield f"{name} {installed[name].version} is installed but not locked; uninstall it, or `make lock`."


def mismatches(text: str) -> Iterator[str]:
    """Locked packages that are missing, or there in another version."""
    installed = _installed()
    for name, version in locked(text)[0].items():
        found = installed.get(name)
        if found is None:
            yield f"{name} {version} is locked but not installed; run `make clean setup`."
        elif found.version.partition("+")[0] != version.partition("+")[0]:
            yield f"{name} is {found.version}, the lock says {version}; run `make clean setup`."


def _distributions() -> list[Distribution]:
    """What is in the environment; setuptools, once imported, adds copies of its own to the path, which do not count."""
    paths = sysconfig.get_paths()
    return list(distributions(path=list(dict.fromkeys([paths["purelib"], paths["platlib"]]))))


def _installed() -> dict[str, Distribution]:
    return {_plain(found.metadata["Name"]): found for found in _distributions()}


def changed_files(found: Distribution) -> Iterator[str]:
    """Files of a package whose content is not what was installed."""
    for file in found.files or []:
        if file.hash is not None and file.suffix != ".pyc" and not _is_intact(file):
            yield f"{file} of {found.metadata['Name']} was changed after its installation; run `make clean setup`."


def _is_intact(file: PackagePath) -> bool:
    try:
        content = Path(str(file.locate())).read_bytes()
    except OSError:
        return False
    if file.hash is None:
        return True
    digest = hashlib.new(file.hash.mode, content).digest()
    return base64.urlsafe_b64encode(digest).rstrip(b"=").decode() == file.hash.value


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def main() -> int:
    """Print what is wrong; 1 if anything is."""
    wrong = list(findings(LOCK.read_text(encoding="utf-8")))
    wrong += [sentence for found in _distributions() for sentence in changed_files(found)]
    for sentence in wrong:
        sys.stderr.write(f"audit: {sentence}\n")
    if not wrong:
        sys.stdout.write(
            "audit: all packages are as locked and as installed; known vulnerabilities: `make audit-online`\n"
        )
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
