"""A Modbus TCP server on loopback in its own thread, in front of any register map; or the same without a port."""

import asyncio
import contextlib
import logging
import struct
import threading
from collections.abc import Callable
from typing import Protocol

from fast.hardware.virtual.modbus_pdu import RegisterMap, reply_to_pdu
from fast.models.errors import DeviceError, UsageError

logger = logging.getLogger(__name__)

HIGHEST_PORT = 65535
_HEADER = struct.Struct(">HHHB")  # transaction, protocol (0), bytes that follow, unit
_LONGEST_PDU = 253
_START_TIME_OUT_S = 10.0


class Asker(Protocol):
    """Who gets the answer to a request."""

    def send(self, reply: bytes) -> None:
        """Take the whole frame of an answer."""


class _Connection(asyncio.Protocol):
    """One client: cuts frames out of the stream and answers them in order."""

    def __init__(self, owner: "ModbusServerThread") -> None:
        self.idle_since_s: float | None = None
        self.n_requests = self.n_requests_seen = 0
        self.transport: asyncio.Transport | None = None
        self._owner = owner
        self._received = b""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Take the client, or hang up when all connections are in use."""
        if isinstance(transport, asyncio.Transport):
            self.transport = transport
            if not self._owner.admit(self):
                transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the client, which has gone."""
        self._owner.dismiss(self)

    def data_received(self, data: bytes) -> None:
        """Answer every complete request; what is no Modbus ends the connection, as the standard asks."""
        self._received += data
        while len(self._received) >= _HEADER.size:
            transaction, protocol, length, unit = _HEADER.unpack_from(self._received)
            if protocol != 0 or not 2 <= length <= _LONGEST_PDU + 1:
                self._hang_up()
                return
            end = _HEADER.size - 1 + length
            if len(self._received) < end:
                return
            pdu, self._received = self._received[_HEADER.size : end], self._received[end:]
            self.n_requests += 1
            self._owner.handle(self, transaction, unit, pdu)

    def send(self, reply: bytes) -> None:
        """Send an answer unless the client has gone meanwhile."""
        if self.transport is not None and not self.transport.is_closing():
            self.transport.write(reply)

    def _hang_up(self) -> None:
        self._received = b""
        if self.transport is not None:
            self.transport.close()


class ModbusServerThread:
    """Serves one `RegisterMap` on loopback until `stop`.

    `most_connections`: further clients are accepted and hung up at once (None: no limit). Named faults:
    `is_silent` (requests are swallowed, the client times out), `n_to_swallow` (so are the next few), `n_to_leave` (the
    next few are carried out and not answered), `delay_s` (late answers, real time).
    """

    def __init__(
        self,
        name: str,
        registers: RegisterMap,
        most_connections: int | None = None,
    ) -> None:
        self.name = name
        self.host = "127.0.0.1"
        self.port = 0
        self._wanted_port: int | None = 0
        self.is_silent = False
        self.n_to_swallow = 0
        self.n_to_leave = 0
        self.delay_s = 0.0
        self.registers = registers
        self.most_connections = most_connections
        self._connections: set[_Connection] = set()
        self._loop: asyncio.AbstractEventLoop | None = None  # while the thread runs
        self._thread = threading.Thread(target=self._serve, name=f"modbus-{name}", daemon=True)
        self._is_up = threading.Event()
        self._failure: BaseException | None = None
        self._stopping = asyncio.Event()

    def start(self, port: int | None = 0) -> None:
        """Listen; `port` 0 takes a free one, which is then in `self.port`. None: only this process can ask (`handle`).

        Raises:
            UsageError: no such port.
            DeviceError: the port is taken.
        """
        if not 0 <= (port or 0) <= HIGHEST_PORT:
            raise UsageError(
                f"The virtual {self.name} cannot listen on port {port}; ports are 0 (any free one) to {HIGHEST_PORT}."
            )
        self._wanted_port = port
        self._thread.start()
        if not self._is_up.wait(_START_TIME_OUT_S) or self._failure is not None:
            raise DeviceError(
                f"The virtual {self.name} cannot listen on {self.host}:{port}; choose another port."
            ) from self._failure

    def stop(self) -> None:
        """Close every connection and the listener, end the thread. Safe to call twice."""
        self._call(self._stopping.set)
        if self._thread.is_alive():
            self._thread.join(_START_TIME_OUT_S)

    @property
    def is_running(self) -> bool:
        """Whether it is on the network."""
        return self._thread.is_alive()

    @property
    def n_connections(self) -> int:
        """Clients connected now."""
        return len(self._connections)

    def drop_all(self) -> None:
        """Reset every connection, as a device does that loses its power."""
        self._drop(tuple(self._connections))

    def drop_idle(self, now_s: float, limit_s: float) -> None:
        """Hang up on clients that asked nothing for `limit_s` of the caller's clock."""
        idle = []
        for connection in tuple(self._connections):
            if connection.n_requests != connection.n_requests_seen or connection.idle_since_s is None:
                connection.n_requests_seen, connection.idle_since_s = connection.n_requests, now_s
            elif now_s - connection.idle_since_s >= limit_s:
                idle.append(connection)
        self._drop(tuple(idle))

    def admit(self, connection: _Connection) -> bool:
        """Take a connection if there is one left. Runs in the server's thread."""
        if self.most_connections is not None and len(self._connections) >= self.most_connections:
            logger.info("the virtual %s refuses a connection: %d are in use", self.name, self.most_connections)
            return False
        self._connections.add(connection)
        return True

    def dismiss(self, connection: _Connection) -> None:
        """Forget a connection. Runs in the server's thread."""
        self._connections.discard(connection)

    def handle(self, connection: Asker, transaction: int, unit: int, pdu: bytes) -> None:
        """Answer one request, after the injected faults. Runs in the thread of the server, or of who asks in memory."""
        if self.is_silent:
            return
        if self.n_to_swallow > 0:
            self.n_to_swallow -= 1
            return
        reply = reply_to_pdu(self.registers, pdu)
        if self.n_to_leave > 0:
            self.n_to_leave -= 1
            return
        frame = _HEADER.pack(transaction, 0, len(reply) + 1, unit) + reply
        if self.delay_s:
            asyncio.get_running_loop().call_later(self.delay_s, connection.send, frame)
        else:
            connection.send(frame)

    def _drop(self, connections: tuple[_Connection, ...]) -> None:
        for connection in connections:
            self._connections.discard(connection)
            if connection.transport is not None:
                self._call(connection.transport.abort)

    def _call(self, function: Callable[[], None]) -> None:
        """Have the server's thread do something, if it runs."""
        loop = self._loop
        if loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop closed meanwhile
                loop.call_soon_threadsafe(function)

    def _serve(self) -> None:
        try:
            asyncio.run(self._listen())
        except OSError as error:
            self._failure = error
        finally:
            self._is_up.set()

    async def _listen(self) -> None:
        self._loop = asyncio.get_running_loop()
        server = None
        if self._wanted_port is not None:
            server = await self._loop.create_server(lambda: _Connection(self), self.host, self._wanted_port)
            self.port = server.sockets[0].getsockname()[1]
        self._is_up.set()
        await self._stopping.wait()
        if server is not None:
            server.close()
        for connection in tuple(self._connections):
            if connection.transport is not None:
                connection.transport.abort()
        for _ in range(3):
            await asyncio.sleep(0)  # lets closed transports run their callbacks before the loop ends
