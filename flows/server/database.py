"""The database of a new lake's server: a copy of an empty one, since Prefect makes it in hundreds of migrations.

They take 6 s of CPU on a slow machine, two thirds of the first start. The empty database is kept beside this package as
the first server of the machine leaves it before anyone asks it anything: tables, and Prefect's own kinds of blocks.
"""

import os
import shutil
import sqlite3
from collections.abc import MutableMapping
from contextlib import closing
from importlib.metadata import version
from pathlib import Path

from fast.flows.server.environment import DATABASE_VARIABLE
from fast.models.solver_code import cache_folder

NAME = "prefect.db"
_SETTINGS = ("PREFECT_SERVER_DATABASE_", "PREFECT_API_DATABASE_")


def name_database(environment: MutableMapping[str, str]) -> None:
    """Name the database in the settings of a server, unless a person has named one.

    It is named as seen from the folder that the server works in (`ChildProcess`), which lies beside it: Prefect's
    default has the whole path, of which a `?` would be the end.
    """
    if not any(name.startswith(_SETTINGS) for name in environment):
        environment["PREFECT_SERVER_DATABASE_CONNECTION_URL"] = f"sqlite+aiosqlite:///../{NAME}"


def take_empty_database(home: Path) -> bool:
    """Give a new server a database; True if no empty one is kept, so that Prefect makes it."""
    if os.environ.get(DATABASE_VARIABLE) or (home / NAME).exists():
        return False
    if not _kept().exists():
        return True
    part = home / f"{NAME}.part"
    shutil.copyfile(_kept(), part)
    part.replace(home / NAME)
    return False


def keep_empty_database(home: Path) -> None:
    """Keep the database that Prefect has just made, for the servers of lakes to come."""
    part = _kept().with_suffix(f".part{os.getpid()}")
    part.parent.mkdir(parents=True, exist_ok=True)
    with closing(sqlite3.connect(home / NAME)) as made, closing(sqlite3.connect(part)) as copy:
        made.backup(copy)
    part.replace(_kept())


def _kept() -> Path:
    return cache_folder(Path(__file__).parent) / f"prefect-{version('prefect')}.db"
