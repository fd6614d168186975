"""What a whole batch says on the wire, kept in tests/data/wire/batch.txt: `python -m tests.hardware.wire.golden_batch`.

Two tools and two objects on the virtual bench, three grasps, from the connection to the check for lost steps, in
lockstep and with fixed seeds, so that every byte is the same on every machine. The command writes the file anew, for
when the drivers or the cell are meant to say something else; the difference shows in review.

A line is one exchange: device, what the host sent, `->`, what it heard. GRBL is text, a slash its end of a line. Modbus
is hexadecimal: function code, address and values; of what was read the values alone. `x3` behind a line says that it
came three times in a row.
"""

from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from unittest.mock import patch

from fast.hardware.bench import _memory_wires, open_virtual_bench
from fast.hardware.virtual.world.file import Sensor, World
from fast.hardware.wire.log import WireEntry
from fast.hardware.wire.log_files import GANTRY, LOAD_CELL, PLC
from tests.hardware.safety.scenario_bench import SETUP, TOOLS, physics

FILE = Path(__file__).parents[2] / "data" / "wire" / "batch.txt"
COMMAND = "python -m tests.hardware.wire.golden_batch"
WORLD = World(seed=7, sensor=Sensor(noise_sd_n=0.12, rate_hz=10))
PLANS = {0: [(30, 0), (7, 0)], 3: [(30, 0)]}  # object and repeat, by the tool's slot
CONTEXT_LINES = 3
HEAD_BYTES = 7  # of a Modbus frame: number of the exchange, protocol, length, unit
READS, WRITE_REGISTERS = (1, 2, 3, 4), 16  # function codes


def say_batch() -> list[str]:
    """Every exchange of the batch, a line each."""
    wires = []

    def remember(*args):
        wires.append(_memory_wires(*args))
        return wires[0]

    with (
        patch("fast.hardware.bench._memory_wires", remember),
        open_virtual_bench(WORLD, TOOLS, physics, wires="memory") as bench,
    ):
        for slot, plan in PLANS.items():
            bench.measure_tool(slot, plan, SETUP, lambda _: None, lambda: False)
        bench.check_position()
    logs = {GANTRY: wires[0].gantry.log, PLC: wires[0].plc.log, LOAD_CELL: wires[0].transmitter_wire.log}
    pieces = sorted((entry.time_s, device, entry) for device, log in logs.items() for entry in log.entries())
    return list(fold(_exchanges((device, entry) for _, device, entry in pieces)))


def _exchanges(pieces: Iterable[tuple[str, WireEntry]]) -> Iterator[str]:
    """Pieces of a device up to the next that the host sends are one exchange."""
    open_lines: dict[str, list[str]] = {}
    for device, entry in pieces:
        if entry.direction == "note":
            continue
        if entry.direction == "sent" and device in open_lines:
            yield " ".join(open_lines.pop(device))
        words = open_lines.setdefault(device, [f"{device:9}"])
        if entry.direction == "received" and "->" not in words:
            words.append("->")
        words.append(_text(device, entry))
    for words in open_lines.values():
        yield " ".join(words)


def _text(device: str, entry: WireEntry) -> str:
    if device == GANTRY:
        lines = entry.data.decode("latin-1").replace("\r", "").split("\n")
        return repr(" / ".join(filter(None, lines)))[1:-1] or "(empty line)"
    code, values = entry.data[HEAD_BYTES], entry.data[HEAD_BYTES + 1 :]
    if entry.direction == "received" and code in READS:
        return values[1:].hex(" ", -2)  # without the number of bytes
    if entry.direction == "sent" and code == WRITE_REGISTERS:
        values = values[:4] + values[5:]  # here, too
    return f"{code:02x} {values.hex(' ', -2)}"


def fold(lines: Iterable[str]) -> Iterator[str]:
    """Each line once, with the number of times that it came in a row."""
    for line, same in groupby(lines):
        n = sum(1 for _ in same)
        yield line if n == 1 else f"{line} x{n}"


def find_difference(kept: list[str], said: list[str]) -> str:
    """The first exchange that differs, with what was said before it; empty where none does."""
    pairs = zip([*kept, None], [*said, None], strict=False)
    at = next((n for n, (one, other) in enumerate(pairs) if one != other), None)
    if at is None:
        return ""
    before = [f"{n + 1:6}   {kept[n]}" for n in range(max(0, at - CONTEXT_LINES), at)]
    lines = [("-", kept[at : at + CONTEXT_LINES]), ("+", said[at : at + CONTEXT_LINES])]
    after = [
        f"{at + n + 1:6} {mark} {line}" for mark, part in lines for n, line in enumerate(part or ["(nothing more)"])
    ]
    return "\n".join([f"exchange {at + 1} of {len(kept)} differs (- kept, + said now):", *before, *after])


def main() -> None:
    FILE.write_text("\n".join(say_batch()) + "\n", encoding="ascii")


if __name__ == "__main__":
    main()
