"""Check-up of the PLC: scan, other hosts, emergency stop, air, head and dock sensors, heartbeat and watchdog.

It reads, and sends one heartbeat. While that lasts, two seconds, the ladder enables the motors, which move nothing by
themselves. No heartbeat is sent while another host is alive (it would be confused), or while the air supply is asked
for (the ladder would open it).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

from fast.hardware.checkup.findings import Findings
from fast.hardware.click import tags
from fast.hardware.click.codec import parse_address
from fast.hardware.click.driver import SCAN_REMEDY, ClickPlc
from fast.hardware.clock import Clock
from fast.hardware.wire.modbus import ModbusLink

HIGHEST_COUNT = 30_000  # of the heartbeat
LOOK_S = 0.7  # longer than a heartbeat: another host shows
ECHO_S = 0.5
WATCHDOG_MARGIN_S = 1.5
POLL_S = 0.02
MOST_PRESSURE_PSI = 120.0
OPEN_PSI = 3.0
CLOSED_SHARE = 28.0 / 30.0
_ENABLE_FIX = (
    f"it must come on with a heartbeat and fall {tags.HOST_TIME_OUT_S:g} s after the last: check the rungs of "
    "docs/how-to/set-up-a-bench.md"
)


@dataclass(frozen=True)
class HeadState:
    """What the sensors tell: whether a tool is on the head, and which dock slots are full."""

    is_tool_on_head: bool
    full_slots: frozenset[int]


def check_plc(findings: Findings, link: ModbusLink, clock: Clock, supply_pressure_psi: float) -> HeadState:
    """Look at the PLC behind `link`.

    Raises:
        DeviceError: it does not answer.
    """
    plc = ClickPlc(link, clock)
    link.connect()
    is_scanning, is_other_host = _check_scan(findings, plc, clock)
    head, is_estop_ok = check_inputs(findings, plc, supply_pressure_psi)
    if is_scanning:
        if is_other_host:
            note = f"{tags.HEARTBEAT_REGISTER} is counting: another host drives this bench"
            findings.add("heartbeat", note, "end it, then check again")
        else:
            _check_heartbeat(findings, plc, link, clock, is_estop_ok)
    return head


def check_inputs(findings: Findings, plc: ClickPlc, supply_pressure_psi: float) -> tuple[HeadState, bool]:
    """Look at what the sensors tell; also whether the emergency stop is released."""
    inputs = plc.read_bits(tags.FIRST_INPUT, tags.N_INPUTS)
    is_closed, is_open, is_present, is_pressure_ok, is_estop_ok, _ = inputs
    findings.judge(
        "emergency stop",
        is_estop_ok,
        "released" if is_estop_ok else f"pressed ({tags.ESTOP_OK_INPUT} is off)",
        "release it and acknowledge at the panel",
    )
    _check_air(findings, plc, is_pressure_ok, supply_pressure_psi)
    is_main_ok = plc.read_bit(tags.SUPPLY_OK_INPUT)
    findings.judge("air main", is_main_ok, f"{tags.SUPPLY_OK_INPUT} is {'on' if is_main_ok else 'off'}",
                   "open the main's valve, look at compressor and regulator")  # fmt: skip
    _check_lock(findings, is_closed, is_open, is_present)
    slots = frozenset(n for n, full in enumerate(plc.read_bits(tags.FIRST_DOCK_INPUT, tags.N_DOCK_SLOTS)) if full)
    findings.add("dock", f"tools in slots {', '.join(map(str, sorted(slots)))}" if slots else "no tools")
    return HeadState(is_present, slots), is_estop_ok


def check_outputs(findings: Findings, plc: ClickPlc) -> None:
    """Look at what the ladder makes of a host that beats: motors enabled, of each valve one coil of two on."""
    is_on = plc.read_bit(tags.MOTOR_ENABLE_OUTPUT)
    findings.judge("motor enable", is_on, f"{tags.MOTOR_ENABLE_OUTPUT} is {'on' if is_on else 'off'}", _ENABLE_FIX)
    for one, other in ((tags.LOCK_OUTPUT, tags.UNLOCK_OUTPUT), (tags.GRIP_OUTPUT, tags.VENT_OUTPUT)):
        are_on = plc.read_bit(one), plc.read_bit(other)
        seen = f"{one} is {'on' if are_on[0] else 'off'}, {other} is {'on' if are_on[1] else 'off'}"
        fix = "one of them must be on: load the ladder of docs/how-to/set-up-a-bench.md, check its addresses"
        findings.judge(f"coils {one}, {other}", are_on[0] != are_on[1], seen, fix)


def _check_scan(findings: Findings, plc: ClickPlc, clock: Clock) -> tuple[bool, bool]:
    scans, beat = plc.read_int(tags.SCAN_COUNTER_REGISTER), plc.read_int(tags.HEARTBEAT_REGISTER)
    clock.sleep(LOOK_S)
    is_scanning = plc.read_int(tags.SCAN_COUNTER_REGISTER) != scans
    findings.judge(
        "PLC scan",
        is_scanning,
        f"{tags.SCAN_COUNTER_REGISTER} counts" if is_scanning else f"{tags.SCAN_COUNTER_REGISTER} stands still",
        SCAN_REMEDY,
    )
    return is_scanning, plc.read_int(tags.HEARTBEAT_REGISTER) != beat


def _check_air(findings: Findings, plc: ClickPlc, is_switch_on: bool, supply_pressure_psi: float) -> None:
    """Check that pressure and its switch agree with the gripper valve; the supply stays as it is."""
    psi, is_gripping = float(plc.read_many(tags.PRESSURE_REGISTER, 1)[0]), plc.read_bit(tags.GRIP_OUTPUT)
    seen = f"{psi:.1f} psi, switch {'on' if is_switch_on else 'off'}, gripper {'closed' if is_gripping else 'open'}"
    if not math.isfinite(psi) or not -1.0 <= psi <= MOST_PRESSURE_PSI:
        fix = f"check the wires of the pressure sensor and the scaling of {tags.PRESSURE_REGISTER} in the ladder"
    elif is_gripping and (psi < CLOSED_SHARE * supply_pressure_psi or not is_switch_on):
        fix = "look for a leak and at the air main, then take out what hangs in the gripper and open it"
    elif not is_gripping and (psi > OPEN_PSI or is_switch_on):
        fix = "an open gripper must be without pressure: check the vent port of the valve, the sensor and the switch"
    else:
        fix = None
    findings.add("air pressure", seen, fix)


def _check_lock(findings: Findings, is_closed: bool, is_open: bool, is_present: bool) -> None:
    state = "closed" if is_closed else "open"
    tool = "with a tool" if is_present else "without a tool"
    if is_closed == is_open:
        both = f"{tags.LOCK_CLOSED_INPUT} and {tags.LOCK_OPEN_INPUT} are both {'on' if is_open else 'off'}"
        findings.add("tool lock", both, "the lock is half way, without air, or a sensor is off its place")
    elif is_present and is_open:
        findings.add("tool lock", "open under a tool", "hold the tool, then close the lock at the panel")
    elif is_closed and not is_present:
        findings.add("tool lock", "closed without a tool", "no tool could be seated: open the lock at the panel")
    else:
        findings.add("tool lock", f"{state}, {tool}")


def _check_heartbeat(findings: Findings, plc: ClickPlc, link: ModbusLink, clock: Clock, is_estop_ok: bool) -> None:
    """Send one beat: it must be echoed, and two seconds later the ladder must let go of the motors."""
    if plc.read_bit(tags.SUPPLY_REQUEST):
        fix = "`fast gantry park --real BENCH.toml` closes it"
        findings.add("heartbeat", f"not tried: {tags.SUPPLY_REQUEST} still asks for air", fix)
        return
    beat = max((plc.read_int(tags.HEARTBEAT_REGISTER) + 1) % HIGHEST_COUNT, 1)
    link.write_registers(parse_address(tags.HEARTBEAT_REGISTER).wire, [beat])
    sent_s = clock.now_s()
    echo = tags.HEARTBEAT_ECHO_REGISTER
    is_echoed = _wait(clock, ECHO_S, lambda: plc.read_int(echo) == beat)
    wrong = f"{echo} does not follow {tags.HEARTBEAT_REGISTER}"
    findings.judge(
        "heartbeat", is_echoed, "echoed" if is_echoed else wrong, "load the ladder of docs/how-to/set-up-a-bench.md"
    )
    if is_echoed and is_estop_ok:
        _check_watchdog(findings, plc, clock, sent_s)


def _check_watchdog(findings: Findings, plc: ClickPlc, clock: Clock, sent_s: float) -> None:
    output, limit_s = tags.MOTOR_ENABLE_OUTPUT, tags.HOST_TIME_OUT_S
    if not _wait(clock, ECHO_S, lambda: plc.read_bit(output)):
        findings.add("host watchdog", f"{output} stays off", _ENABLE_FIX)
        return
    is_let_go = _wait(clock, limit_s + WATCHDOG_MARGIN_S, lambda: not plc.read_bit(output))
    after_s = clock.now_s() - sent_s
    seen = f"{output} {'fell' if is_let_go else 'is still on'} {after_s:.1f} s after the last heartbeat"
    findings.judge("host watchdog", is_let_go and after_s > limit_s / 2, seen, _ENABLE_FIX)


def _wait(clock: Clock, longest_s: float, condition: Callable[[], bool]) -> bool:
    until_s = clock.now_s() + longest_s
    while not condition():
        if clock.now_s() >= until_s:
            return False
        clock.sleep(POLL_S)
    return True
