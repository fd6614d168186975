"""Searches of tests take the rehearsal of another panel: one of their own takes half a minute."""

from typing import Any

import pytest

from fast.models.gap.evidence.rehearsal import Rehearsal
from tests.synthetic.rehearsal import USUAL


@pytest.fixture(autouse=True)
def no_rehearsal(monkeypatch: pytest.MonkeyPatch) -> None:
    """`tests.tasks.gap.test_rehearse` has the real one."""

    def rehearse_panel(*_: Any, **__: Any) -> Rehearsal:
        return USUAL

    monkeypatch.setattr("fast.models.gap.evidence.rehearsal.rehearse_panel", rehearse_panel)
