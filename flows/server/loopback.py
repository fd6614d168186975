"""This machine as seen from itself: what keeps programs on it from each other, or a library from being imported."""

import os
import socket
import stat
import tempfile
from collections.abc import Iterable, MutableMapping
from pathlib import Path

LOOPBACK = "127.0.0.1"
LOOPBACK_NAMES = (LOOPBACK, "localhost", "::1")

_EVERYWHERE = "0.0.0.0"


def open_listeners(host: str, port: int, backlog: int) -> list[socket.socket]:
    """Open sockets that listen on a port of an address, and of loopback: programs of this machine ask there.

    Raises:
        OSError: the port is taken, or the address is not of this machine.
    """
    listeners = [socket.create_server((host, port), backlog=backlog)]
    if host not in (LOOPBACK, _EVERYWHERE):
        try:
            listeners.append(socket.create_server((LOOPBACK, listeners[0].getsockname()[1]), backlog=backlog))
        except OSError:
            listeners[0].close()
            raise
    return listeners


def list_addresses(host: str) -> list[str]:
    """List where a person opens what listens on `host`: for 0.0.0.0 the addresses this machine has in networks."""
    if host != _EVERYWHERE:
        return [host]
    import psutil  # a hundredth of a second that other commands do not need

    known = [one.address for card in psutil.net_if_addrs().values() for one in card if one.family == socket.AF_INET]
    return [address for address in known if not address.startswith("127.")] or [LOOPBACK]


def join_numbers(listeners: Iterable[socket.socket]) -> str:
    """Join the numbers of listening sockets as an argument of the process that gets them; see `split_numbers`."""
    return ",".join(str(listener.fileno()) for listener in listeners)


def split_numbers(numbers: str) -> list[socket.socket]:
    """Return the listening sockets that the parent of this process handed on."""
    return [socket.socket(fileno=int(number)) for number in numbers.split(",")]


def settle(environment: MutableMapping[str, str]) -> None:
    """Have programs on this machine reach each other, whatever the variables for proxies, certificates and home say."""
    _spare_loopback(environment)
    _forget_missing_certificates(environment)
    _give_home(environment)


def _spare_loopback(environment: MutableMapping[str, str]) -> None:
    """Have requests to this machine go past any proxy, whatever else the variables for proxies say."""
    for name in ("NO_PROXY", "no_proxy"):
        listed = [one.strip() for one in environment.get(name, "").split(",") if one.strip()]
        environment[name] = ",".join([*listed, *(one for one in LOOPBACK_NAMES if one not in listed)])


def _forget_missing_certificates(environment: MutableMapping[str, str]) -> None:
    """Have no certificates looked for where there are none: no client could be made, not even of loopback."""
    for name in ("SSL_CERT_FILE", "SSL_CERT_DIR"):
        if name in environment and not Path(environment[name]).exists():
            del environment[name]


def _give_home(environment: MutableMapping[str, str]) -> None:
    """Have libraries find a home where a user has neither a name nor `HOME`, as in some containers.

    It is the user's alone: what others left there would be read as settings, or run as compiled code.
    """
    try:
        Path.home()
    except RuntimeError:
        folder = Path(tempfile.gettempdir()) / f"fast-home-{os.getuid()}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        is_own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
        environment["HOME"] = str(folder) if is_own else tempfile.mkdtemp(prefix="fast-home-")
