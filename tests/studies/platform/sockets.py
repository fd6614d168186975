"""Where processes of this machine listen, from /proc: no program beside Python is needed."""

import os
from collections.abc import Collection, Iterator
from pathlib import Path

_LISTENING = "0A"
_LOOPBACK = ("127.", "::1", "::ffff:127.")


def listening(pids: Collection[int]) -> set[tuple[str, int]]:
    """Addresses and ports on which these processes listen for TCP connections."""
    inodes = {inode for pid in pids for inode in _sockets(pid)}
    return {place for table in ("tcp", "tcp6") for place, inode in _table(table) if inode in inodes}


def is_loopback(address: str) -> bool:
    """True for an address that only this machine reaches."""
    return address.startswith(_LOOPBACK)


def family(pid: int) -> set[int]:
    """A process and all its living descendants."""
    parents = {int(p.name): _parent(int(p.name)) for p in Path("/proc").iterdir() if p.name.isdigit()}
    found = {pid}
    while grown := {child for child, parent in parents.items() if parent in found} - found:
        found |= grown
    return found


def _parent(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    except (OSError, IndexError):
        return 0


def _sockets(pid: int) -> Iterator[str]:
    """Inodes of the sockets that a process holds."""
    try:
        handles = list(Path(f"/proc/{pid}/fd").iterdir())
    except OSError:
        return
    for handle in handles:
        try:
            target = os.readlink(handle)
        except OSError:
            continue
        if target.startswith("socket:["):
            yield target[len("socket:[") : -1]


def _table(name: str) -> Iterator[tuple[tuple[str, int], str]]:
    """Address and port, and inode, of each listening socket of a kernel table."""
    try:
        lines = Path(f"/proc/net/{name}").read_text().splitlines()[1:]
    except OSError:
        return
    for line in lines:
        fields = line.split()
        if fields[3] == _LISTENING:
            address, _, port = fields[1].partition(":")
            yield (_address(address), int(port, 16)), fields[9]


def _address(code: str) -> str:
    """An address as people write it, from the kernel's little-endian words."""
    import ipaddress

    content = b"".join(bytes.fromhex(code[i : i + 8])[::-1] for i in range(0, len(code), 8))
    return str(ipaddress.ip_address(content))
