"""Requests to an S3-compatible object store, and what its refusals mean in one sentence.

Address and credentials come from the environment, as for every S3 program: `AWS_ENDPOINT_URL`, `AWS_ACCESS_KEY_ID`,
`AWS_SECRET_ACCESS_KEY`, `AWS_SESSION_TOKEN`, `AWS_REGION`, `AWS_PROFILE`, or the role of the machine.
"""

import os
import re

from pyarrow.fs import FileInfo, FileSelector, FileType, S3FileSystem, resolve_s3_region

from fast.models.errors import FastError, LakeError, UsageError

_CONNECT_TIMEOUT_S = 5.0
_REQUEST_TIMEOUT_S = 60.0  # of a silent connection
_DENIED = frozenset(
    {
        "ACCESS_DENIED",
        "EXPIRED_TOKEN",
        "INVALID_ACCESS_KEY_ID",
        "INVALID_CLIENT_TOKEN_ID",
        "MISSING_AUTHENTICATION_TOKEN",
        "SIGNATURE_DOES_NOT_MATCH",
        "UNRECOGNIZED_CLIENT",
    }
)
_GONE = frozenset({"NO_SUCH_KEY", "RESOURCE_NOT_FOUND"})
_SILENT = frozenset({"NETWORK_CONNECTION", "REQUEST_TIMEOUT", "SERVICE_UNAVAILABLE"})


class Connection:
    """Requests to one bucket; paths are `bucket/key`. Connects when first asked, and again in a forked process.

    Each method raises OSError for what the store refuses, FileNotFoundError where there is no such object.
    """

    def __init__(self, bucket: str) -> None:
        self._bucket = bucket
        self._files: S3FileSystem | None = None
        self._pid = 0

    @staticmethod
    def endpoint() -> str | None:
        """Return the address of the server; None for Amazon's own."""
        return os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or None

    def get(self, path: str) -> bytes:
        """Get all of an object."""
        try:
            with self.files.open_input_stream(path) as stream:
                return bytes(stream.read())
        except OSError as error:
            if _code(str(error)) in _GONE:  # it went after it was opened; pyarrow then tells no kind of error
                raise FileNotFoundError(path) from error
            raise

    def put(self, path: str, data: bytes) -> None:
        """Write an object, visible whole when this returns, or not at all.

        All data are given at once: closing a stream of which only a part was written would publish that part.
        """
        with self.files.open_output_stream(path) as stream:
            stream.write(data)

    def has(self, path: str) -> bool:
        """Return whether there is such an object."""
        return bool(self.files.get_file_info(path).type == FileType.File)

    def has_bucket(self) -> bool:
        """Return True; raise an error where there is no such bucket, of which a listing is merely empty."""
        if self.files.get_file_info(self._bucket).type == FileType.NotFound:
            raise FileNotFoundError(self._bucket)
        return True

    def list(self, folder: str) -> list[FileInfo]:
        """List objects and folders right below a prefix; a request for each thousand."""
        return list(self.files.get_file_info(FileSelector(folder, allow_not_found=True)))

    def copy(self, path: str, target: str) -> None:
        """Copy an object within the store."""
        self.files.copy_file(path, target)

    def delete(self, path: str) -> None:
        """Delete an object."""
        self.files.delete_file(path)

    @property
    def files(self) -> S3FileSystem:
        """The store as a file system of pyarrow."""
        if self._files is None or self._pid != os.getpid():
            endpoint = self.endpoint()
            region = os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION")
            self._files = S3FileSystem(
                endpoint_override=endpoint,
                region=region or ("us-east-1" if endpoint else resolve_s3_region(self._bucket)),
                connect_timeout=_CONNECT_TIMEOUT_S,
                request_timeout=_REQUEST_TIMEOUT_S,
                # A small object is one request then, with its content.
                allow_delayed_open=True,
            )
            self._pid = os.getpid()
        return self._files


def refusal(address: str, failing: str, error: OSError) -> FastError:
    """Make the sentence for a request that failed; `failing` says what could not be done and what that means."""
    text = str(error).splitlines()[0]
    code = _code(text)
    failed = f"{address} {failing} "
    if code in _DENIED:
        return UsageError(f"{failed}({_denied()}): correct {_credentials()}, then run the same command again.")
    if code == "NO_SUCH_BUCKET" or isinstance(error, FileNotFoundError):
        return UsageError(f"{failed}(there is no such bucket): make it, or give another --lake.")
    if code in _SILENT:
        server = Connection.endpoint() or "the server"
        return LakeError(
            f"{failed}({server} does not answer): start it or correct AWS_ENDPOINT_URL, then run the same command "
            "again, which duplicates nothing."
        )
    return LakeError(f"{failed}({text}): correct this, then run the same command again, which duplicates nothing.")


def _code(text: str) -> str | None:
    found = re.search(r"AWS Error (\w+)", text)
    return found[1] if found else None


def _denied() -> str:
    named = os.environ.get("AWS_ACCESS_KEY_ID") or os.environ.get("AWS_PROFILE")
    return "access denied" if named else "access denied; AWS_ACCESS_KEY_ID is not set"


def _credentials() -> str:
    return "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or the permissions of this key"
