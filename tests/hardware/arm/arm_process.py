"""A virtual arm in a process of its own, since the client library holds Python's lock while it connects.

`python arm_process.py HOST SPEED_UP`: prints the bench file's settings as a line of JSON, then takes commands, a line
each: `inject FAULT`, `clear FAULT`, `protective on|off`, `power on|off`, `safeguard on|off`, `pause`, `slider SHARE`,
`state`; answers each with a line.
"""

import json
import sys

from fast.hardware.virtual.arm.controller import VirtualArm
from fast.hardware.virtual.arm.server import ArmServer
from fast.hardware.virtual.world.file import Sensor, World
from tests.hardware.arm.bench_contract import TOOLS
from tests.hardware.station.test_station import physics


def main() -> None:
    arm = VirtualArm(World(seed=7, sensor=Sensor(rate_hz=125, noise_sd_n=0.05)), TOOLS, physics)
    server = ArmServer(arm, sys.argv[1], float(sys.argv[2]))
    server.start()
    say(server.arm.settings(server.host, server.script_port).model_dump(mode="json"))
    for line in sys.stdin:
        verb, *words = line.split()
        with arm.lock:
            if verb == "inject":
                arm.world.inject(words[0])
            elif verb == "clear":
                arm.world.clear(words[0])
            elif verb == "protective":
                arm.is_protective_stopped = words == ["on"]
            elif verb == "power":
                arm.is_powered_off = words == ["off"]
            elif verb == "safeguard":
                arm.is_safeguard_open = words == ["on"]
            elif verb == "pause":
                arm.is_paused = True
            elif verb == "slider":
                arm.speed_share = float(words[0])
            pose = arm.values()["actual_TCP_pose"]
            tool = arm.world.tool.tool_id if arm.world.tool else None
            say({"tool": tool, "docked": sorted(arm.world.docked), "z_mm": round(1000 * pose[2], 3)})
    server.stop()


def say(line: object) -> None:
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
