"""Who may talk to the server of a lake: whoever has its key, which lies in the lake for its owner alone."""

import base64
import hashlib
import hmac
import os
import secrets
from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from fast.flows.server.loopback import LOOPBACK, list_addresses
from fast.lake.storage.files import writing_failed
from fast.models.errors import FastError

PASSWORD_VARIABLE = "FAST_PASSWORD"
USER = "fast"
_KEY_BYTES = 24


class Role(StrEnum):
    """What whoever opens a page may do; each may do what those before it may."""

    LOOK = "look"
    SAY = "say"
    MOVE = "move"

    def may(self, other: "Role") -> bool:
        """Return whether this one includes another."""
        roles = list(Role)
        return roles.index(self) >= roles.index(other)


def role_login(login: str, role: Role) -> str:
    """Return the login of a role: that of a server, or one that follows from it and does not tell it."""
    if role is Role.MOVE:
        return login
    return f"{USER}:{hmac.new(login.encode(), f'role {role}'.encode(), hashlib.sha256).hexdigest()[:32]}"


@dataclass(frozen=True)
class Api:
    """Address of a server's interface, such as http://127.0.0.1:4200/api, and `user:password` if it has one."""

    url: str
    login: str | None = field(default=None, repr=False)

    @property
    def page(self) -> str:
        """Address of its pages."""
        return self.url.removesuffix("/api")

    @property
    def headers(self) -> dict[str, str]:
        """What a request carries to be let in."""
        if not self.login:
            return {}
        return {"Authorization": f"Basic {base64.b64encode(self.login.encode()).decode()}"}


def own_login(lake_root: Path) -> str:
    """Return `user:password` of a lake's server: FAST_PASSWORD, or the key of the lake, made here if there is none.

    Raises:
        FastError: the key is another user's.
    """
    return f"{USER}:{os.environ.get(PASSWORD_VARIABLE) or _read_key(key_path(lake_root))}"


def key_path(lake_root: Path) -> Path:
    """Return where the key of a lake is."""
    return lake_root / ".state" / "key"


def address_for_person(api: Api) -> str:
    """Return the address that lets a browser in, once and for good; without the key where a person chose a password."""
    if not api.login or os.environ.get(PASSWORD_VARIABLE):
        return api.page
    return f"{api.page}/?key={api.login.partition(':')[2]}"


def addresses_for_person(api: Api, host: str) -> list[str]:
    """Return the same for each address at which a server listening on `host` is opened from where a person may be."""
    ours, loopback = address_for_person(api), f"//{LOOPBACK}:"
    return [ours.replace(loopback, f"//{one}:", 1) for one in list_addresses(host)] if loopback in ours else [ours]


def session_of(login: str) -> str:
    """Return what a browser that was let in keeps: it follows from the key, and does not tell it."""
    return hmac.new(login.encode(), b"browser", hashlib.sha256).hexdigest()


def _read_key(path: Path) -> str:
    try:
        with suppress(FileExistsError):
            _write_key(path)
        key = path.read_text().strip()
    except PermissionError as error:
        raise FastError(
            f"{path} is the key of another user, who runs the server of this lake; ask that user, or set "
            f"{PASSWORD_VARIABLE} for both of you."
        ) from error
    except OSError as error:
        raise writing_failed(path.parent, error) from error
    if not key:
        raise FastError(f"{path}, the key of the lake's server, is empty; delete it, then start the server again.")
    return key


def _write_key(path: Path) -> None:
    """Write a new key, visible whole or not at all, for its owner alone.

    Raises:
        FileExistsError: there is one.
    """
    if path.exists():
        raise FileExistsError(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".key-{os.getpid()}-{secrets.token_hex(4)}")
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        os.write(descriptor, f"{secrets.token_urlsafe(_KEY_BYTES)}\n".encode())
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    try:
        os.link(part, path)  # of two that begin at once, one wins
    finally:
        part.unlink()
