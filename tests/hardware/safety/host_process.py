"""A host in a process of its own, for the scenario tests: python host_process.py ADDRESSES_JSON SPEED_UP MAY_VENT.

It measures tool 3 on the virtual bench of another process and prints a line of JSON per grasp and one at the end.
"""

import json
import sys

from fast.hardware.bench import BenchSettings, open_real_bench
from fast.hardware.clock import ScaledClock
from fast.models.errors import FastError
from tests.hardware.safety.scenario_bench import SETUP, TOOLS

OBJECTS = (35,)  # close to home


def main() -> int:
    """Exit status 0 done, 1 refused or failed with a sentence on stderr."""
    addresses, speed_up, may_vent = json.loads(sys.argv[1]), float(sys.argv[2]), sys.argv[3] == "vent"
    settings = BenchSettings(**addresses, modbus_time_out_s=5.0, stale_after_s=0.0, pressure_time_out_s=40.0)
    try:
        with open_real_bench(settings, TOOLS, ScaledClock(speed_up), may_vent) as bench:
            bench.station.measure_tool(3, [(object_id, 0) for object_id in OBJECTS], SETUP, tell, lambda: False)
    except FastError as error:
        sys.stderr.write(f"{type(error).__name__}: {error}\n")
        return 1
    say({"done": True})
    return 0


def tell(grasp) -> None:
    """One grasp as a line."""
    peak_n = float(grasp.trace.force_n.max()) if len(grasp.trace.force_n) else 0.0
    say({"object": grasp.object_id, "status": grasp.status, "peak_n": peak_n})


def say(line) -> None:
    """A line of JSON, at once."""
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
