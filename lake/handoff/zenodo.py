"""Upload of a deposit to Zenodo, or to another archive that runs its software (InvenioRDM's deposit interface).

Source: developers.zenodo.org, "Depositions". A draft is made. A person looks at it and publishes it on the page, since
what is published there cannot be taken back.
"""

import json
import os
import urllib.error
import urllib.parse
import urllib.request
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from fast.models.errors import FastError, UsageError

TOKEN_VARIABLE = "FAST_ZENODO_TOKEN"
ADDRESS_VARIABLE = "FAST_ZENODO_URL"
ZENODO = "https://zenodo.org"
_TIME_OUT_S = 60.0  # without any answer; a large file may take longer as a whole


def read_access() -> tuple[str, str]:
    """Read address and token of the archive, from the environment.

    Raises:
        UsageError: there is no token, or the address is none.
    """
    address = os.environ.get(ADDRESS_VARIABLE, ZENODO).rstrip("/")
    token = os.environ.get(TOKEN_VARIABLE, "").strip()
    if not token:
        raise UsageError(
            f"{TOKEN_VARIABLE} is not set; make a token with the scope `deposit:write` on {address}, under "
            "Applications of your account, and set it."
        )
    parts = urllib.parse.urlsplit(address)
    if parts.scheme != "https" and (parts.scheme, parts.hostname) != ("http", "127.0.0.1"):
        raise UsageError(f"{ADDRESS_VARIABLE} is `{address}`, and a token is only sent to https://; correct it.")
    return address, token


def upload_deposit(deposit: Path, access: tuple[str, str]) -> str:
    """Upload a deposit that `publish` wrote, as a draft: README.md, and all files in one zip. Returns its page.

    Raises:
        FastError: the archive did not take it; the draft that was begun is deleted.
    """
    address, token = access
    with _told_in_a_sentence(address):
        draft = _ask(f"{address}/api/deposit/depositions", token, "POST", {})
    try:
        with _told_in_a_sentence(address), TemporaryDirectory(prefix="fast-zenodo-") as folder:
            for file in (deposit / "README.md", _pack(deposit, Path(folder))):
                _send(f"{draft['links']['bucket']}/{file.name}", token, file)
            _ask(draft["links"]["self"], token, "PUT", {"metadata": _read_metadata(deposit)})
    except FastError:
        with _told_in_a_sentence(address):
            _ask(draft["links"]["self"], token, "DELETE")
        raise
    return str(draft["links"]["html"])


def _pack(deposit: Path, folder: Path) -> Path:
    packed = folder / f"{deposit.name}.zip"
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(file for file in deposit.rglob("*") if file.is_file()):
            archive.write(file, file.relative_to(deposit))
    return packed


def _read_metadata(deposit: Path) -> dict[str, Any]:
    """Read what the archive asks of a data set, from the deposit's own description."""
    package = json.loads((deposit / "datapackage.json").read_text(encoding="utf-8"))
    return {
        "upload_type": "dataset",
        "title": package["title"],
        "description": f"<p>{package['description']}</p>",
        "creators": [{"name": person["title"]} for person in package["contributors"]],
        "license": package["licenses"][0]["name"].lower(),
        "access_right": "open",
        "keywords": ["soft robotics", "gripper", "pull-off force"],
    }


def _send(url: str, token: str, file: Path) -> None:
    with file.open("rb") as content:
        headers = {"Content-Type": "application/octet-stream", "Content-Length": str(file.stat().st_size)}
        request = urllib.request.Request(url, content, {**headers, **_bearer(token)}, method="PUT")
        with urllib.request.urlopen(request, timeout=_TIME_OUT_S):
            pass


def _ask(url: str, token: str, method: str, body: Any = None) -> Any:
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data, {"Content-Type": "application/json", **_bearer(token)}, method=method)
    with urllib.request.urlopen(request, timeout=_TIME_OUT_S) as answer:
        content = answer.read()
    return json.loads(content) if content else None


def _bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


@contextmanager
def _told_in_a_sentence(address: str) -> Iterator[None]:
    """Turn what goes wrong between here and the archive into one sentence."""
    again = "nothing was published and the data are untouched: try again later, or upload the folder by hand."
    try:
        yield
    except urllib.error.HTTPError as error:
        said = f"{error.code} {error.reason}"
        if error.code in (401, 403):
            raise UsageError(
                f"{address} refused the token ({said}); nothing was published: check {TOKEN_VARIABLE} and that its "
                "scope is `deposit:write`."
            ) from error
        raise FastError(f"{address} did not take the deposit ({said}); {again}") from error
    except OSError as error:
        raise FastError(f"{address} cannot be reached ({getattr(error, 'reason', error)}); {again}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise FastError(f"{address} answered what no archive of this kind answers; {again}") from error
