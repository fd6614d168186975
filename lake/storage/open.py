"""The storage at an address: a folder, or a prefix of an object store."""

import re
from pathlib import Path

from fast.lake.storage.base import Storage
from fast.lake.storage.folder import FolderStorage
from fast.models.errors import UsageError

# A path takes one of the two slashes away, and --lake is a path wherever it may be a folder.
_OBJECT_STORE = re.compile(r"s3:/{1,2}(?P<bucket>[^/]+)/*(?P<prefix>.*)")
_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")


def storage_at(address: Path | str) -> Storage:
    """Return the storage at what a person gives as --lake: a folder, or `s3://bucket/prefix`.

    Raises:
        UsageError: it is the address of something else, or no address.
    """
    if not isinstance(address, str | Path):
        raise UsageError(f"the address of a lake is {address!r}; give a folder or s3://BUCKET/PREFIX.")
    found = _OBJECT_STORE.fullmatch(str(address))
    if found is None and _ADDRESS.match(str(address)):
        raise UsageError(f"{address} is no lake: give a folder or s3://BUCKET/PREFIX with --lake.")
    if found is None:
        return FolderStorage(Path(address))
    from fast.lake.storage.object_store import ObjectStorage  # a tenth of a second that a folder does not need

    return ObjectStorage(found["bucket"], found["prefix"].strip("/"))
