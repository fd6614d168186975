"""This machine as seen from itself."""

import tempfile
from collections.abc import MutableMapping
from pathlib import Path

LOOPBACK_NAMES = ("127.0.0.1", "localhost", "::1")


def spare_loopback(environment: MutableMapping[str, str]) -> None:
    """Have requests to this machine go past any proxy, whatever else the variables for proxies say."""
    for name in ("NO_PROXY", "no_proxy"):
        listed = [one.strip() for one in environment.get(name, "").split(",") if one.strip()]
        environment[name] = ",".join([*listed, *(one for one in LOOPBACK_NAMES if one not in listed)])


def forget_missing_certificates(environment: MutableMapping[str, str]) -> None:
    """Have no certificates looked for where there are none: no client could be made, not even of loopback."""
    for name in ("SSL_CERT_FILE", "SSL_CERT_DIR"):
        if name in environment and not Path(environment[name]).exists():
            del environment[name]


def give_home(environment: MutableMapping[str, str]) -> None:
    """Have libraries find a home where a user has neither a name nor `HOME`, as in some containers."""
    try:
        Path.home()
    except RuntimeError:
        environment["HOME"] = tempfile.gettempdir()
