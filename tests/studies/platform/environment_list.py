"""Machines that are not ours: settings, proxies, folders and rights under which a campaign has to run.

In variables `{folder}` is the folder of the run.
"""

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field

NOWHERE = "http://127.0.0.1:9"  # the port of `discard`: nobody listens
UNWRITABLE = "/proc/nothing"  # not even root makes a folder there
NOBODY = "65534"
_MATPLOTLIBRC = "backend: TkAgg\ntext.usetex: True\nfont.family: Nobody's\nsavefig.format: eps\n"
_MODULE_NAMES = ("numpy", "prefect", "tasks", "lake", "queue", "random", "secrets", "signal", "types", "calibrate")
_BAD_TOML = "this is = no [ TOML\n"
_PROFILE = (
    f'active = "other"\n[profiles.other]\nPREFECT_API_URL = "{NOWHERE}/api"\nPREFECT_LOGGING_LEVEL = "nonsense"\n'
)
# Rights of a person: root may write everywhere, whatever the bits of a folder say.
_NO_RIGHTS = ("setpriv", "--bounding-set=-all", "--inh-caps=-all")


@dataclass(frozen=True)
class Environment:
    """One way in which a machine differs from ours.

    `variables` are set, or taken away by None; `files` are written into the folder; `closed` are folders that are made
    and may not be written; `command` stands before the program's; `status` is the exit status that is right; `says` is
    what must be said; `owner` is the user to whom the folder belongs.
    """

    name: str
    variables: Mapping[str, str | None] = field(default_factory=dict)
    files: Mapping[str, str] = field(default_factory=dict)
    closed: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    folder: str = "run"
    status: int = 0
    says: str = ""
    owner: int | None = None
    is_copied: bool = False

    @property
    def missing(self) -> str:
        """Why this machine cannot play the environment; empty where it can."""
        program = next(iter(self.command), "bash")
        if shutil.which(program) is None:
            return f"needs {program}"
        return "needs root" if program in ("setpriv", "unshare") and os.geteuid() != 0 else ""


def _shell(line: str) -> tuple[str, ...]:
    return ("bash", "-c", f'{line}; exec "$@"', "-")


def _not_root(user: str) -> tuple[str, ...]:
    """A user who may read everywhere (an interpreter in root's home could not even be started), and write nowhere."""
    return (
        "setpriv", f"--reuid={user}", f"--regid={user}", "--clear-groups",
        "--inh-caps=+dac_read_search", "--ambient-caps=+dac_read_search",
    )  # fmt: skip


def _mounted(folder: str, size: str) -> tuple[str, ...]:
    """A small file system on a folder, for this command alone."""
    return ("unshare", "--mount", *_shell(f"mount -t tmpfs -o size={size} none {folder}"))


def _prefect(name: str, *settings: str) -> Environment:
    """Variables of Prefect, `NAME=value`, for another use of it."""
    variables = {f"PREFECT_{key}": value for key, _, value in (setting.partition("=") for setting in settings)}
    says = f"left aside, since FAST brings its own Prefect server: {', '.join(sorted(variables))} "
    return Environment(f"Prefect: {name}", variables, says=says)


_PREFECT = (
    _prefect("address", f"API_URL={NOWHERE}/api"),
    _prefect("address that is none", "API_URL=lab"),
    _prefect("keys", "API_KEY=pnu_other", "API_AUTH_STRING=a:b", "CLIENT_CUSTOM_HEADERS={"),
    _prefect("profile", "PROFILE=other"),
    _prefect("home", f"HOME={UNWRITABLE}", f"PROFILES_PATH={UNWRITABLE}", f"LOCAL_STORAGE_PATH={UNWRITABLE}"),
    _prefect(
        "database", "API_DATABASE_CONNECTION_URL=postgresql+asyncpg://a:b@127.0.0.1:9/x",
        "SERVER_DATABASE_CONNECTION_URL=sqlite+aiosqlite:////nowhere/x.db", "SERVER_DATABASE_MIGRATE_ON_START=false",
        "API_DATABASE_TIMEOUT=x",
    ),
    _prefect(
        "logging", "LOGGING_LEVEL=nonsense", "LOGGING_SETTINGS_PATH=/nowhere.yml", "LOGGING_TO_API_ENABLED=maybe",
        "LOGGING_EXTRA_LOGGERS=[", "LOGGING_COLORS=x",
    ),
    _prefect(
        "server", "SERVER_API_HOST=203.0.113.1", "SERVER_API_PORT=1", "SERVER_API_AUTH_STRING=a:b",
        "SERVER_API_BASE_PATH=/x", "SERVER_ALLOW_EPHEMERAL_MODE=false", "SERVER_EPHEMERAL_ENABLED=false",
        "SERVER_API_CSRF_PROTECTION_ENABLED=true", "UI_API_URL=x", "UI_SERVE_BASE=/x",
    ),
    _prefect(
        "results", "RESULTS_DEFAULT_SERIALIZER=none", "RESULTS_PERSIST_BY_DEFAULT=true",
        "RESULTS_LOCAL_STORAGE_PATH=/proc/nothing", "DEFAULT_RESULT_STORAGE_BLOCK=s3-bucket/other",
    ),
    _prefect(
        "runs", "FLOWS_DEFAULT_RETRIES=7", "FLOW_DEFAULT_RETRIES=7", "TASKS_DEFAULT_RETRIES=x",
        "TASKS_REFRESH_CACHE=true", "TASK_RUNNER_THREAD_POOL_MAX_WORKERS=0", "RUNNER_POLL_FREQUENCY=x",
        "WORKER_HEARTBEAT_SECONDS=x", "TEST_MODE=true", "DEBUG_MODE=true", "INTERNAL_LOGGING_LEVEL=x",
    ),
    _prefect(
        "certificates", "API_TLS_INSECURE_SKIP_VERIFY=x", "API_SSL_CERT_FILE=/nowhere.pem", "CLOUD_API_URL=x",
        "CLIENT_MAX_RETRIES=x", "API_ENABLE_HTTP2=true",
    ),
    Environment("Prefect: profiles.toml in the home", {"HOME": "{folder}"}, {".prefect/profiles.toml": _PROFILE}),
    Environment("Prefect: broken profiles.toml", {"HOME": "{folder}"}, {".prefect/profiles.toml": _BAD_TOML}),
    Environment("Prefect: prefect.toml", files={"prefect.toml": f'[api]\nurl = "{NOWHERE}/api"\n[server]\nx = 1\n'}),
    Environment("Prefect: broken prefect.toml", files={"prefect.toml": _BAD_TOML}),
    Environment("Prefect: .env", files={".env": f"PREFECT_API_URL={NOWHERE}/api\nPREFECT_LOGGING_LEVEL=nonsense\n"}),
    Environment("Prefect: pyproject.toml", files={"pyproject.toml": f'[tool.prefect]\napi.url = "{NOWHERE}/api"\n'}),
    Environment(
        "FAST_PREFECT_API_URL that nobody answers", {"FAST_PREFECT_API_URL": f"{NOWHERE}/api"}, status=2,
        says="FAST_PREFECT_API_URL is http://127.0.0.1:9/api, which does not answer or does not let us in; ",
    ),
    Environment(
        "FAST_PREFECT_LOGGING_LEVEL=nonsense", {"FAST_PREFECT_LOGGING_LEVEL": "nonsense"}, status=2,
        says="FAST_PREFECT_LOGGING_LEVEL is `nonsense`: Input should be 'DEBUG', 'INFO', 'WARNING', 'ERROR'",
    ),
    Environment(
        "FAST_PREFECT_CLIENT_MAX_RETRIES=x", {"FAST_PREFECT_CLIENT_MAX_RETRIES": "x"}, status=2,
        says="FAST_PREFECT_CLIENT_MAX_RETRIES is `x`: Input should be a valid integer",
    ),
    Environment(
        "FAST_PREFECT_LOGGIN_LEVEL", {"FAST_PREFECT_LOGGIN_LEVEL": "INFO"}, status=2,
        says="FAST_PREFECT_LOGGIN_LEVEL is `INFO`: is no setting of Prefect; ",
    ),
    Environment(
        "FAST_PREFECT_... that Prefect knows",
        {"FAST_PREFECT_LOGGING_LEVEL": "DEBUG", "FAST_PREFECT_SERVER_LOGGING_LEVEL": "INFO"},
    ),
)  # fmt: skip

_PROXY_NAMES = ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY", "http_proxy", "https_proxy", "all_proxy")
_NETWORK = (
    Environment("proxy that nobody answers", dict.fromkeys(_PROXY_NAMES, NOWHERE)),
    Environment("proxy with own NO_PROXY", {**dict.fromkeys(_PROXY_NAMES, NOWHERE), "NO_PROXY": "lab.example"}),
    Environment("proxy of SOCKS", dict.fromkeys(_PROXY_NAMES, "socks5://127.0.0.1:9")),
    Environment("proxy without a scheme", dict.fromkeys(_PROXY_NAMES, "proxy.example:3128")),
    Environment("NO_PROXY of everything", {"NO_PROXY": "*", "no_proxy": "*"}),
    Environment("NO_PROXY that is no list", {**dict.fromkeys(_PROXY_NAMES, NOWHERE), "NO_PROXY": "10.0.0.0/8,[::1],,"}),
    Environment(
        "certificates that are not there",
        {"SSL_CERT_FILE": "/nowhere.pem", "SSL_CERT_DIR": "/nowhere", "REQUESTS_CA_BUNDLE": "/nowhere.pem"},
    ),
    Environment("no network", command=("unshare", "--net", *_shell("ip link set lo up"))),
    Environment(
        "no network, not even to itself", command=("unshare", "--net"), status=2,
        says="programs on this machine cannot reach each other at 127.0.0.1",
    ),
    Environment("settings of a web server", {"WEB_CONCURRENCY": "4", "FORWARDED_ALLOW_IPS": "*", "PORT": "1"}),
    Environment("FAST_PASSWORD with letters of others", {"FAST_PASSWORD": "pä:ss wörd 実験"}, says="Campaign tiny; "),
)  # fmt: skip

_FOLDERS = (
    Environment(
        "NUMBA_CACHE_DIR that cannot be written", {"NUMBA_CACHE_DIR": UNWRITABLE},
        says=f"NUMBA_CACHE_DIR is {UNWRITABLE}, which cannot be written; ",
    ),
    Environment("TMPDIR that is not there", {"TMPDIR": UNWRITABLE, "TMP": UNWRITABLE, "TEMP": UNWRITABLE}),
    Environment("TMPDIR of a long path", {"TMPDIR": "{folder}/" + "long-" * 20}, {"long-" * 20 + "/x": ""}),
    Environment(
        "XDG folders that cannot be written",
        dict.fromkeys(("XDG_CACHE_HOME", "XDG_STATE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME"), UNWRITABLE),
    ),
    Environment("MPLCONFIGDIR, MPLBACKEND of a desktop", {"MPLCONFIGDIR": UNWRITABLE, "MPLBACKEND": "TkAgg"}),
    Environment("home that cannot be written", {"HOME": "{folder}/home"}, closed=("home",), command=_NO_RIGHTS),
    Environment("home that is not there", {"HOME": "/nowhere"}),
    Environment("no HOME", {"HOME": None, "USER": None, "LOGNAME": None}),
    Environment("checkout that is read-only", command=_NO_RIGHTS, is_copied=True),
    Environment(
        "read-only checkout, and no home", {"HOME": "{folder}/home"}, closed=("home",), command=_NO_RIGHTS,
        is_copied=True, says="no folder for compiled code can be written",
    ),
    Environment("folder with spaces and letters of others", folder="Zoë's läb 実験 [1] 100%"),
    Environment("umask 077", command=_shell("umask 077")),
    Environment("umask 000", command=_shell("umask 000")),
    Environment("not root", {"HOME": "{folder}"}, command=_not_root(NOBODY), owner=int(NOBODY)),
    Environment(
        "64 open files", command=_shell("ulimit -n 64"), status=2, says="this process may have 64 open files at once, "
    ),
    Environment("64 open files, more if asked for", command=_shell("ulimit -S -n 64")),
    Environment("128 open files", command=_shell("ulimit -n 128")),
    Environment("user without a name", {"HOME": None}, command=_not_root("54321"), owner=54321),
    Environment(
        "folder that cannot be written", closed=("lake",), command=_NO_RIGHTS, status=2, says="lake cannot be written"
    ),
    Environment("TMPDIR that is full", {"TMPDIR": "{folder}/full"}, {"full/x": ""}, command=_mounted("full", "4k")),
    Environment("little shared memory", command=_mounted("/dev/shm", "64k")),
    Environment("one core", command=("taskset", "-c", "0")),
    Environment("8 GB of addresses", command=_shell("ulimit -v 8000000")),
)  # fmt: skip

_PYTHON = (
    Environment("C locale", {"LC_ALL": "C", "LANG": "C"}),
    Environment(
        "C locale without UTF-8", {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}, folder="Zoë's läb"
    ),
    Environment("output of ASCII", {"PYTHONIOENCODING": "ascii"}, folder="Zoë's läb"),
    Environment("locale that is not there", {"LC_ALL": "xx_YY.ISO-8859-1", "LANG": "xx_YY", "LANGUAGE": "xx"}),
    Environment("PYTHONWARNINGS=error", {"PYTHONWARNINGS": "error"}),
    Environment("PYTHONOPTIMIZE=2", {"PYTHONOPTIMIZE": "2"}),
    Environment("PYTHONDEVMODE=1", {"PYTHONDEVMODE": "1"}),
    Environment("time zone far away", {"TZ": "Pacific/Kiritimati"}),
    Environment("time zone that is none", {"TZ": "Nowhere/Nothing"}),
    Environment("threads that are none", {"OMP_NUM_THREADS": "many", "OPENBLAS_NUM_THREADS": "0"}),
    Environment(
        "Numba of a developer",
        {"NUMBA_DISABLE_JIT": "1", "NUMBA_THREADING_LAYER": "tbb", "NUMBA_FULL_TRACEBACKS": "1"},
        says="NUMBA_DISABLE_JIT is left aside: the simulator has to be compiled.",
    ),
    Environment("Numba: .numba_config.yaml", files={".numba_config.yaml": "disable_jit: 1\n"}),
    Environment("matplotlibrc of a paper", files={"matplotlibrc": _MATPLOTLIBRC}),
    Environment(
        "modules named like others", files={f"{name}.py": "raise SystemExit(3)\n" for name in _MODULE_NAMES}
    ),
    Environment("PYTHONSAFEPATH, PYTHONPYCACHEPREFIX", {"PYTHONSAFEPATH": "1", "PYTHONPYCACHEPREFIX": UNWRITABLE}),
    Environment("git of others", {"GIT_DIR": "/nowhere", "GIT_WORK_TREE": "/nowhere"}),
    Environment("64 threads", dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "64")),
    Environment("terminal that can nothing", {"TERM": "dumb", "COLUMNS": "1", "LINES": "x", "NO_COLOR": "1"}),
    Environment("no stdin", command=_shell("exec 0<&-")),
    Environment("nohup", command=("nohup",)),
    Environment("no PATH", {"PATH": "/nowhere"}),
)  # fmt: skip

OURS = Environment("ours")
# Many at once, for the suite.
COMPUTER_OF_OTHERS = Environment(
    "computer of another user of Prefect behind a proxy",
    {
        "HOME": "{folder}", "PREFECT_API_URL": f"{NOWHERE}/api", "PREFECT_API_KEY": "pnu_other",
        "PREFECT_API_AUTH_STRING": "a:b", "PREFECT_SERVER_API_AUTH_STRING": "a:b", "PREFECT_PROFILE": "other",
        "PREFECT_SERVER_DATABASE_CONNECTION_URL": "sqlite+aiosqlite:////nowhere/x.db",
        "PREFECT_LOGGING_LEVEL": "nonsense", **dict.fromkeys(_PROXY_NAMES, NOWHERE),
    },
    {".prefect/profiles.toml": _PROFILE, "prefect.toml": _BAD_TOML, ".env": "PREFECT_LOGGING_LEVEL=nonsense\n"},
    command=_shell("ulimit -n 128"), folder="Zoë's läb",
    says="left aside, since FAST brings its own Prefect server: PREFECT_API_AUTH_STRING, PREFECT_API_KEY, ",
)  # fmt: skip
CONTAINER = Environment(
    "container in which nothing can be written",
    {
        **dict.fromkeys(("HOME", "NUMBA_CACHE_DIR", "MPLCONFIGDIR", "TMPDIR"), UNWRITABLE),
        **dict.fromkeys(("XDG_CACHE_HOME", "XDG_STATE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME"), UNWRITABLE),
        "PATH": "/nowhere", "LC_ALL": "POSIX", "TZ": "Nowhere/Nothing", "TERM": "dumb", "COLUMNS": "1",
    },
    says=f"NUMBA_CACHE_DIR is {UNWRITABLE}, which cannot be written; ",
)  # fmt: skip
GROUPS = {
    "ours": (OURS,),
    "settings of Prefect": _PREFECT,
    "networks": _NETWORK,
    "folders, rights, limits": _FOLDERS,
    "locales, Python, libraries": _PYTHON,
    "many at once": (COMPUTER_OF_OTHERS, CONTAINER),
}
ENVIRONMENTS = tuple(environment for group in GROUPS.values() for environment in group)
