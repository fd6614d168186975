"""This machine as seen from itself."""

from collections.abc import MutableMapping

LOOPBACK_NAMES = ("127.0.0.1", "localhost", "::1")


def spare_loopback(environment: MutableMapping[str, str]) -> None:
    """Have requests to this machine go past any proxy, whatever else the variables for proxies say."""
    for name in ("NO_PROXY", "no_proxy"):
        listed = [one.strip() for one in environment.get(name, "").split(",") if one.strip()]
        environment[name] = ",".join([*listed, *(one for one in LOOPBACK_NAMES if one not in listed)])
