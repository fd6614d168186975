"""A PostgreSQL server on loopback, started and stopped by the tests; no root needed, but not run as root either."""

import os
import pwd
import secrets
import shutil
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

DEBIAN = Path("/usr/lib/postgresql")
USER = "fast"
START_LIMIT_S = 120.0


def program(name: str) -> str | None:
    """Path of one of its programs, None where it is not installed."""
    found = sorted(DEBIAN.glob(f"*/bin/{name}"), key=lambda path: float(path.parts[-3]))
    return str(found[-1]) if found else shutil.which(name)


def account() -> str | None:
    """Who may run it: this user, or for root, whom it refuses, one without rights."""
    if os.getuid() != 0:
        return pwd.getpwuid(os.getuid()).pw_name
    known = {entry.pw_name for entry in pwd.getpwall()}
    return next((name for name in ("postgres", "nobody") if name in known), None)


WHY_NOT = (
    "PostgreSQL is not installed (Debian: apt-get install postgresql)"
    if program("initdb") is None
    else "no account without rights to run PostgreSQL"
    if account() is None
    else ""
)


@contextmanager
def postgres() -> Iterator[str]:
    """URL of an empty database, as Prefect wants it."""
    who, password = account(), secrets.token_hex(8)
    port = _free_port()
    with tempfile.TemporaryDirectory(prefix="fast-postgres-", ignore_cleanup_errors=True) as name:
        folder, data = Path(name), Path(name) / "data"
        (folder / "password").write_text(password)
        for path in (folder, folder / "password"):
            shutil.chown(path, who)
        as_user = {"user": who, "group": pwd.getpwnam(str(who)).pw_gid, "extra_groups": []} if os.getuid() == 0 else {}
        made = ["--auth=scram-sha-256", f"--username={USER}", f"--pwfile={folder / 'password'}", "--no-sync"]
        subprocess.run([str(program("initdb")), "-D", str(data), *made], check=True, capture_output=True, **as_user)
        options = ["-p", str(port), "-k", str(folder), "-c", "listen_addresses=127.0.0.1", "-c", "fsync=off"]
        with (folder / "log.txt").open("wb") as log:
            server = subprocess.Popen([str(program("postgres")), "-D", str(data), *options], stderr=log, **as_user)
        try:
            _wait(port, server, folder / "log.txt")
            yield f"postgresql+asyncpg://{USER}:{password}@127.0.0.1:{port}/postgres"
        finally:
            server.terminate()
            server.wait(60)


def _wait(port: int, server: "subprocess.Popen[bytes]", log: Path) -> None:
    deadline = time.monotonic() + START_LIMIT_S
    ready = [str(program("pg_isready")), "-h", "127.0.0.1", "-p", str(port), "-q"]
    while subprocess.run(ready, check=False).returncode != 0:
        assert server.poll() is None, log.read_text()
        assert time.monotonic() < deadline, log.read_text()
        time.sleep(0.2)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
