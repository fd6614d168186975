"""What processes of FAST know of Prefect: nothing that a person set for another use of it.

Prefect reads `PREFECT_...` variables, a profile in its home, and `.env`, `prefect.toml` and `pyproject.toml` of the
working folder. FAST brings a server of its own, so it leaves all of them aside. A setting that is meant for FAST is a
variable `FAST_PREFECT_...`: `FAST_PREFECT_API_URL` names a server to use in place of an own one.
"""

import json
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from fast.flows.server.access import Api
from fast.flows.server.loopback import settle

PREFIX = "PREFECT_"
OWN_PREFIX = f"FAST_{PREFIX}"
SERVER_VARIABLE = f"{OWN_PREFIX}API_URL"
LOGIN_VARIABLE = f"{OWN_PREFIX}API_AUTH_STRING"
FOLDER_VARIABLE = "FAST_SERVED_FROM"  # the folder of `fast serve`, for page and worker: paths of configs start there
LAB_VARIABLE = "FAST_LAB"  # process id of `fast serve`, for what its worker does
DATABASE_VARIABLE = f"{OWN_PREFIX}API_DATABASE_CONNECTION_URL"  # a lab's own, such as PostgreSQL

OFFLINE = {
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "DO_NOT_TRACK": "1",
    "PREFECT_CLOUD_ENABLE_ORCHESTRATION_TELEMETRY": "false",
    "PREFECT_SERVER_UI_SHOW_PROMOTIONAL_CONTENT": "false",
    "PREFECT_SERVER_UI_V2_ENABLED": "false",
}
PATIENT = {"PREFECT_CLIENT_MAX_RETRIES": "7"}  # about four minutes, where a server of others is gone
QUIET = {"PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "CRITICAL"}


def named_server() -> Api | None:
    """Return the server that `FAST_PREFECT_API_URL` names, with its login if one is given."""
    url = os.environ.get(SERVER_VARIABLE)
    return Api(url.rstrip("/"), os.environ.get(LOGIN_VARIABLE)) if url else None


def list_ignored(environment: Mapping[str, str] = os.environ) -> list[str]:
    """List the variables for another use of Prefect that are left aside, sorted."""
    return sorted(name for name in environment if name.startswith(PREFIX))


def make_environment(api: Api, home: Path, environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Make the variables of a process of FAST that talks to a server; `home`: folder of Prefect's own state."""
    kept = {name: value for name, value in environment.items() if not name.startswith(PREFIX)}
    settle(kept)
    kept |= {**OFFLINE, **PATIENT, "PREFECT_HOME": str(home.resolve())}
    kept |= {name.removeprefix("FAST_"): value for name, value in environment.items() if name.startswith(OWN_PREFIX)}
    kept["PREFECT_API_URL"] = api.url
    if api.login:
        kept["PREFECT_API_AUTH_STRING"] = api.login
        # Those of Prefect's clients that listen to events bring the login late, and are sent away at the gate.
        kept["PREFECT_CLIENT_CUSTOM_HEADERS"] = json.dumps(api.headers)
    return kept


def enter_environment(api: Api, home: Path) -> None:
    """Give this process the settings of `make_environment` and import Prefect, which reads them just then.

    A flow run of a worker has Prefect already, with the settings that the worker got from us.
    """
    wanted = make_environment(api, home) | QUIET
    if "prefect" not in sys.modules:
        for name in list_ignored():
            del os.environ[name]
    os.environ.update(wanted)
    with _empty_folder(home):
        import prefect.context  # noqa: F401 - here it looks for settings in the working folder


@contextmanager
def _empty_folder(home: Path) -> Iterator[None]:
    """Work in a folder without files of settings, unless Prefect has looked for them already."""
    if "prefect" in sys.modules:
        yield
        return
    before = Path.cwd()
    empty = home / "empty"
    empty.mkdir(parents=True, exist_ok=True)
    os.chdir(empty)
    try:
        yield
    finally:
        os.chdir(before)
