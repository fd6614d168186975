"""What a check-up found, collected one by one."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from fast.models.errors import FastError


class Finding(NamedTuple):
    """One look: what was seen, or what is wrong and how to put it right."""

    name: str
    ok: bool
    note: str


class Findings:
    """A list of findings that grows while a bench is looked at."""

    def __init__(self) -> None:
        self.found: list[Finding] = []

    def add(self, name: str, note: str, fix: str | None = None) -> None:
        """Note what was seen; with a `fix` it is a failure."""
        self.found.append(Finding(name, fix is None, note if fix is None else f"{note}; {fix}"))

    def judge(self, name: str, is_ok: bool, note: str, fix: str) -> None:
        """Note what was seen, with its fix unless it is as it should be."""
        self.add(name, note, None if is_ok else fix)

    @contextmanager
    def section(self, name: str) -> Iterator[None]:
        """Turn an expected error into a finding; the rest of the section cannot be looked at."""
        try:
            yield
        except FastError as error:
            self.found.append(Finding(name, False, str(error)))
