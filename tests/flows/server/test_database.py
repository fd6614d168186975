"""A new lake's server starts with a copy of the empty database that the first one on the machine made."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from fast.flows.server import database
from fast.flows.server.database import NAME, keep_empty_database, take_empty_database
from fast.flows.server.environment import DATABASE_VARIABLE, SERVER_VARIABLE
from fast.flows.server.server import server, state_folder


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv(DATABASE_VARIABLE, raising=False)
    monkeypatch.setattr(database, "_kept", lambda: tmp_path / "cache" / "prefect-1.db")
    return tmp_path / "cache" / "prefect-1.db"


def home_of(lake: Path, *tables: str) -> Path:
    """State folder of a lake, with a database of these tables if there are any."""
    lake.mkdir()
    if tables:
        with closing(sqlite3.connect(lake / NAME)) as made:
            made.executescript("PRAGMA journal_mode=wal;" + "".join(f"CREATE TABLE {name} (a);" for name in tables))
    return lake


def tables_of(home: Path) -> list[str]:
    with closing(sqlite3.connect(home / NAME)) as found:
        return [name for (name,) in found.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]


def test_what_the_first_server_made_is_given_to_the_next(kept: Path, tmp_path: Path) -> None:
    assert take_empty_database(home_of(tmp_path / "first"))
    (tmp_path / "first").rmdir()
    keep_empty_database(home_of(tmp_path / "first", "flow_run"))
    second = home_of(tmp_path / "second")
    assert not take_empty_database(second)
    assert tables_of(second) == ["flow_run"]
    assert [path.name for path in kept.parent.iterdir()] == [kept.name]


def test_no_database_is_replaced(kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep_empty_database(home_of(tmp_path / "first", "flow_run"))
    used = home_of(tmp_path / "used", "flow_run", "log")
    assert not take_empty_database(used)
    assert tables_of(used) == ["flow_run", "log"]
    monkeypatch.setenv(DATABASE_VARIABLE, "postgresql+asyncpg://fast@127.0.0.1/prefect")
    other = home_of(tmp_path / "other")
    assert not take_empty_database(other)
    assert not (other / NAME).exists()


def test_the_database_lies_in_its_lake_whatever_signs_the_path_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of `lab?/lake`, it lay in a file `lab`, and was that of all lakes of such names."""
    for variable in (DATABASE_VARIABLE, SERVER_VARIABLE):
        monkeypatch.delenv(variable, raising=False)
    root = tmp_path / "lab? #1 50%" / "lake"
    with server(root):
        assert "flow_run" in tables_of(state_folder(root))
    assert [path.name for path in tmp_path.iterdir()] == ["lab? #1 50%"]
