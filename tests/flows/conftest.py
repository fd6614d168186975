import pytest

from tests.flows.undrawn import leave_undrawn


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    leave_undrawn(monkeypatch)
