"""Check-up of the gantry: port, controller, settings, limit switches. Nothing moves.

A controller at rest gets a soft reset, which keeps its position and drops a half line that an earlier host may have
left: sent on its own, the end of that line could complete a move. One that is not at rest is not touched.
"""

from fast.hardware.checkup.findings import Findings
from fast.hardware.checkup.ports import check_serial_port
from fast.hardware.clock import Clock
from fast.hardware.grbl.messages import Feedback, Setting, StatusReport
from fast.hardware.grbl.profile import MACHINE_SETTINGS, GrblProfile
from fast.hardware.grbl.session import BOOT_POLL_S, BOOT_WAIT_S, REPLY_TIMEOUT_S, GrblSession
from fast.hardware.wire.serial import Transport

_DOING = "looking at the gantry"
_SETTINGS = "gantry settings"


def check_gantry(findings: Findings, transport: Transport, clock: Clock, profile: GrblProfile) -> None:
    """Look at the controller at the other end of `transport`.

    Raises:
        DeviceError: the port cannot be opened, or the controller falls silent.
    """
    findings.add("gantry port", check_serial_port(transport.name))
    session = GrblSession(transport, clock, profile)
    session.link.open()
    try:
        report = _wake_up(session)
        if report is None:
            said = f" (it said `{session.link.unknown}`)" if session.link.unknown else ""
            fix = "check its power, the port and its version; if an alarm has made it deaf, press its reset button"
            findings.add("gantry", f"nothing on {transport.name} answers as GRBL 1.1{said}", fix)
        elif report.state not in ("Idle", "Alarm"):
            fix = "wait until it is at rest, or press the emergency stop"
            if not report.is_moving:
                fix = "it stays so by itself: end the program that has left it so, then press its reset button"
            findings.add("gantry", f"it is in state {report.state} and was not touched", fix)
        else:
            session.reset(_DOING)
            _check_controller(findings, session, report)
            _check_settings(findings, session, profile)
    finally:
        session.close()


def _wake_up(session: GrblSession) -> StatusReport | None:
    """Wait for the bootloader of a board that restarts when its port is opened, then ask."""
    epoch, until_s = session.link.epoch, session.clock.now_s() + BOOT_WAIT_S
    while session.link.epoch == epoch and session.clock.now_s() < until_s:
        session.clock.sleep(BOOT_POLL_S)
    return session.link.request_report(REPLY_TIMEOUT_S)


def _check_controller(findings: Findings, session: GrblSession, report: StatusReport) -> None:
    session.command("", _DOING)
    build = [message for message in session.query("$I", _DOING) if isinstance(message, Feedback)]
    session.build = tuple([f"{message.kind}:{message.text}" for message in build])
    state = "not homed" if report.state == "Alarm" else "at rest"
    findings.add("gantry", f"GRBL {', '.join(message.text for message in build)}; {state}")
    closed = ", ".join(letter for letter in report.pins or "" if letter in "XYZ")
    findings.judge(
        "limit switches",
        not closed,
        f"{closed or 'none'} closed",
        "free the axis by hand with the power off; if it is free, check the switch's wires and $5",
    )


def _check_settings(findings: Findings, session: GrblSession, profile: GrblProfile) -> None:
    found = {m.number: m.value for m in session.query("$$", _DOING) if isinstance(m, Setting)}
    corrections = profile.corrections(found, session.build)
    if not corrections:
        findings.add(_SETTINGS, f"{len(found)} read, none that matters differs from the profile")
        return
    lines = [f"      {line or '(none)':<16} {text}" for text, line in corrections]
    numbers = [line.partition("=")[0] for _, line in corrections if line]
    built = ", ".join(number for number in numbers if int(number[1:]) in MACHINE_SETTINGS)
    first = (
        f"a machine that is built another way keeps {built}, since a longer travel than it has lifts the soft limit: "
        "write what it has into `[gantry_settings]` of the bench file. Else "
    )
    findings.add(
        _SETTINGS,
        f"{len(corrections)} of {len(found)} differ from the profile",
        f"{first if built else ''}send these lines one at a time, each after the `ok` of the one before (a setting "
        "that one side lacks means another firmware), then check again:\n" + "\n".join(lines),
    )
