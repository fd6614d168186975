"""pyclickplc's server for `test_pyclickplc.py`, run by the Python of an environment that has it.

Prints its port, then carries out one JSON command per line: `["set", address, value]` or `["get", address]`.
"""

import asyncio
import json
import sys

from pyclickplc.server import ClickServer, MemoryDataProvider


async def main():
    provider = MemoryDataProvider()
    server = ClickServer(provider, host="127.0.0.1", port=0)
    await server.start()
    print(server._server.transport.sockets[0].getsockname()[1], flush=True)  # noqa: T201 - read by the test
    while line := await asyncio.to_thread(sys.stdin.readline):
        verb, address, *value = json.loads(line)
        answer = provider.get(address) if verb == "get" else provider.set(address, *value)
        print(json.dumps(answer), flush=True)  # noqa: T201
    await server.stop()


asyncio.run(main())
