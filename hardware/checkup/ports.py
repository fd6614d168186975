"""Whether the ports of a bench can be used, and if not, why: missing, forbidden, held by somebody, nobody answers."""

import os
import socket
from pathlib import Path

from serial.tools import list_ports

from fast.hardware.wire.serial import LinkLostError, check_is_device

_PTY = "/dev/pts/"


def check_serial_port(port: str) -> str:
    """Say what a serial port is, for people.

    Raises:
        LinkLostError: it cannot be opened; says what to do.
    """
    if not os.path.exists(port):
        there = ", ".join(found.device for found in list_ports.comports()) or "none"
        raise LinkLostError(f"{port} does not exist (there are: {there}); plug it in, or correct it in the bench file.")
    check_is_device(port)
    if not os.access(port, os.R_OK | os.W_OK):
        try:
            fix = f"run `sudo usermod -aG {Path(port).group()} $USER` and log in again"
        except KeyError:  # as in a container, whose files do not name the computer's groups
            fix = f"its group {os.stat(port).st_gid} has no name here; run as a member of it"
        raise LinkLostError(f"{port} may not be opened by this user; {fix}.")
    if os.path.realpath(port).startswith(_PTY):
        return f"{port}, a virtual one"
    held_by = holders(port)
    if held_by:
        raise LinkLostError(f"{port} is held by {', '.join(held_by)}; end that program first.")
    return f"{port}, free"


def holders(port: str) -> list[str]:
    """List other processes that have a file open, as `name (process 123)`; only those that this user may see."""
    target = os.path.realpath(port)
    found = []
    for process in sorted(Path("/proc").glob("[0-9]*")):
        if process.name != str(os.getpid()) and any(_points_to(handle, target) for handle in _handles(process)):
            found.append(f"{_name(process)} (process {process.name})")
    return found


def check_address(host: str, port: int, timeout_s: float) -> str:
    """Say what a TCP address is, for people; connect once and hang up.

    Raises:
        LinkLostError: nobody answers; says what to do.
    """
    try:
        socket.create_connection((host, port), timeout_s).close()
    except socket.gaierror as error:
        raise LinkLostError(f"{host} is no known host; give its number in the bench file, such as 192.168.0.10.") from (
            error
        )
    except ConnectionRefusedError as error:
        raise LinkLostError(f"{host} is there but refuses port {port}; switch its Modbus TCP server on.") from error
    except OSError as error:
        raise LinkLostError(
            f"{host}:{port} does not answer in {timeout_s:g} s; check its power, the cable, and that this computer has "
            "an address in the same network."
        ) from error
    return f"{host}:{port} answers"


def _handles(process: Path) -> list[Path]:
    try:
        return list((process / "fd").iterdir())
    except OSError:
        return []  # another user's, or gone


def _points_to(handle: Path, target: str) -> bool:
    try:
        return os.readlink(handle) == target
    except OSError:
        return False


def _name(process: Path) -> str:
    try:
        return (process / "comm").read_text().strip()
    except OSError:
        return "unknown"
