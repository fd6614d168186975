"""Check-up of a whole bench: every device is looked at, also when others do not answer. Nothing moves."""

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

from fast.hardware.bench import Bench, BenchSettings, wires_to
from fast.hardware.checkup.findings import Finding, Findings
from fast.hardware.checkup.gantry import check_gantry
from fast.hardware.checkup.load_cell import WEIGH_S, check_load_cell, check_zero
from fast.hardware.checkup.plc import HeadState, check_inputs, check_outputs, check_plc
from fast.hardware.checkup.ports import check_address, check_serial_port
from fast.hardware.clock import Clock, RealClock
from fast.hardware.wire.log_files import WireFiles

LIGHTEST_KG, HEAVIEST_KG = 0.05, 5.0  # of a tool with its adaptor


def check_bench(settings: BenchSettings, clock: Clock | None = None, log_folder: Path | None = None) -> list[Finding]:
    """Look at every device of a bench.

    Args:
        settings: of the bench.
        clock: time for all waits; real time by default.
        log_folder: where the wire logs go; None keeps them in memory.
    """
    used, findings = clock or RealClock(), Findings()
    wires = wires_to(settings, used)
    head = HeadState(is_tool_on_head=False, full_slots=frozenset())
    with ExitStack() as stack:
        if log_folder is not None:
            wires.write_to(stack.enter_context(WireFiles(log_folder)))
        stack.callback(wires.plc.close)
        stack.callback(wires.transmitter.close)
        with findings.section("gantry"):
            check_gantry(findings, wires.gantry, used, settings.gantry_profile)
        with findings.section("PLC"):
            address = check_address(settings.plc_host, settings.plc_port, settings.modbus_time_out_s)
            findings.add("PLC address", address)
            head = check_plc(findings, wires.plc, used, settings.supply_pressure_psi)
        with findings.section("load cell"):
            findings.add("load-cell address", _check_transmitter_address(settings))
            check_load_cell(
                findings,
                wires.transmitter,
                used,
                settings.force_rate_hz,
                settings.transmitter_filter,
                settings.full_scale_kg,
                head.is_tool_on_head,
            )
        check_tool_masses(findings, settings.tool_mass_kg, head.full_slots, settings.layout.n_slots)
    return findings.found


def check_open_bench(bench: Bench) -> list[Finding]:
    """Look at what the sensors of an open bench tell; settings, noise, rate and watchdog need `check_bench`."""
    findings = Findings()
    check_outputs(findings, bench.plc)
    head, _ = check_inputs(findings, bench.plc, bench.settings.supply_pressure_psi)
    bench.force.read_new()  # what came before is not of now
    gross_n: list[float] = []
    for _ in range(int(WEIGH_S * bench.force.rate_hz)):
        bench.clock.sleep(1.0 / bench.force.rate_hz)
        gross_n += [reading.gross_n for reading in bench.force.read_new()]
    check_zero(findings, gross_n, bench.force.full_scale_n, head.is_tool_on_head)
    return findings.found


def check_tool_masses(
    findings: Findings, mass_kg: Mapping[int, float], full_slots: frozenset[int], n_slots: int
) -> None:
    """Check that every tool in the dock has been weighed: its mass proves that it is the right one."""
    wrong = [f"slot {slot}: {mass:g} kg" for slot, mass in sorted(mass_kg.items())
             if not (0 <= slot < n_slots and LIGHTEST_KG <= mass <= HEAVIEST_KG)]  # fmt: skip
    unweighed = sorted(full_slots - mass_kg.keys())
    if wrong:
        fix = f"slots are 0 to {n_slots - 1}, masses in kg, {LIGHTEST_KG:g} to {HEAVIEST_KG:g}; correct [tool_mass_kg]"
        findings.add("tool masses", ", ".join(wrong), fix)
    elif unweighed:
        slots = ", ".join(map(str, unweighed))
        fix = "weigh each with its adaptor to 1 g and add it under [tool_mass_kg] of the bench file, e.g. `0 = 0.412`"
        findings.add("tool masses", f"the tools in slots {slots} were not weighed, only estimated", fix)
    else:
        findings.add("tool masses", f"{len(mass_kg)} weighed" if mass_kg else "no tools in the dock")


def _check_transmitter_address(settings: BenchSettings) -> str:
    if settings.transmitter_serial_port is not None:
        return check_serial_port(settings.transmitter_serial_port)
    return check_address(settings.transmitter_host, settings.transmitter_port, settings.modbus_time_out_s)
