"""A wire to a server that counts the requests that pass, and can be cut."""

import re
import socket
import threading
from contextlib import suppress

_REQUEST = re.compile(rb"(GET|HEAD|PUT|POST|DELETE) (\S+) HTTP/1\.1\r\n")


class Relay:
    """Passes connections on to a port of this machine; `requests` are those that passed."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"http://127.0.0.1:{self._listener.getsockname()[1]}"
        self.requests: list[str] = []
        self.is_cut = False
        self._n_before_cut: int | None = None
        self._open: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def cut_after(self, n_requests: int) -> None:
        """Let this many requests pass and half of the next; then nothing until `mend`."""
        self._n_before_cut = n_requests

    def mend(self) -> None:
        """Let everything pass again."""
        self.is_cut, self._n_before_cut = False, None

    def take(self) -> list[str]:
        """Requests since last asked, as `METHOD path`."""
        taken, self.requests = self.requests, []
        return taken

    def close(self) -> None:
        """Take no more connections, and end those that are there."""
        for held in (self._listener, *self._open):
            with suppress(OSError):
                held.shutdown(socket.SHUT_RDWR)
            held.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                if self.is_cut:
                    client.close()
                    continue
                server = socket.create_connection(("127.0.0.1", self._port))
                self._open += [client, server]
                for source, target in ((client, server), (server, client)):
                    threading.Thread(target=self._pass_on, args=(source, target), daemon=True).start()

    def _pass_on(self, source: socket.socket, target: socket.socket) -> None:
        with suppress(OSError):
            while (data := source.recv(2**16)) and not self.is_cut:
                self._count(data)
                if self.is_cut:
                    target.sendall(data[: len(data) // 2])
                    break
                target.sendall(data)
        for held in (source, target):
            with suppress(OSError):
                held.shutdown(socket.SHUT_RDWR)

    def _count(self, data: bytes) -> None:
        for method, path in _REQUEST.findall(data):
            if self._n_before_cut == 0:
                self.is_cut = True
                return
            if self._n_before_cut:
                self._n_before_cut -= 1
            self.requests.append(f"{method.decode()} {path.decode()}")
