"""Audit of the installed packages against requirements.lock, without network; part of `make check`.

It finds packages that are not pinned, other versions than the lock's, packages that nobody locked, and installed files
that changed since they were installed. It cannot know of published vulnerabilities: that is `make audit-online`.
"""

import base64
import hashlib
import sys
from collections.abc import Iterator
from importlib.metadata import Distribution, PackagePath
from pathlib import Path

from fast.flows.dependencies import LOCK, find_mismatches, installed_packages, list_distributions, read_lock

OWN = "fast-gripper-lab"
UNLOCKED = frozenset({"pip", OWN})  # `make lock` leaves them out


def findings(text: str) -> Iterator[str]:
    """What is wrong with the installed packages, one sentence each."""
    pins, loose = read_lock(text)
    yield from (f"`{line}` of the lock is no exact pin; run `make lock`." for line in loose)
    yield from find_mismatches(text)
    installed = installed_packages()
    for name in sorted(set(installed) - set(pins) - UNLOCKED):
        yield f"{name} {installed[name].version} is installed but not locked; uninstall it, or `make lock`."


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


def main() -> int:
    """Print what is wrong; 1 if anything is."""
    wrong = list(findings(LOCK.read_text(encoding="utf-8")))
    wrong += [sentence for found in list_distributions() for sentence in changed_files(found)]
    for sentence in wrong:
        sys.stderr.write(f"audit: {sentence}\n")
    if not wrong:
        sys.stdout.write(
            "audit: all packages are as locked and as installed; known vulnerabilities: `make audit-online`\n"
        )
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
