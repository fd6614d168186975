"""Check-up of the load cell: identity, faults, zero, noise, rate, filter. Only reads; nothing is tared.

The filter cannot be read over Modbus, but it shows: with a slow one the instrument repeats its readings.
"""

import statistics
from collections.abc import Sequence

from fast.hardware.checkup.findings import Findings
from fast.hardware.clock import Clock
from fast.hardware.laumas.codec import Reading
from fast.hardware.laumas.driver import LaumasTransmitter
from fast.hardware.laumas.source import WeightSource
from fast.models.errors import DeviceError
from fast.models.units import force_n_from_kg, spell_share

WEIGH_S = 2.0
SLOWEST_FILTER = 1  # of those fit for a lift: 3 (425 ms) smears 2 mm of it, 4 twice that
MOST_NOISE_N = 0.5
MOST_GROSS_SHARE = 0.4  # of full scale, with head and tool hanging free
LEAST_GROSS_N = -1.0
MOST_DRIFT_N = 0.3  # between the halves of the readings
FRESH_SHARE = 0.4  # of the readings; fewer that differ mean a slow refresh
LEAST_RATE_SHARE, MOST_RATE_SHARE = 0.5, 1.5  # of the readings that the bench file expects in a second
FEWEST_READINGS = 2
JUDGED_COUNTS = 1.0  # noise in counts below which equal readings prove nothing


def check_load_cell(
    findings: Findings,
    transmitter: WeightSource,
    clock: Clock,
    rate_hz: float,
    filter_setting: int,
    full_scale_kg: float,
    is_tool_on_head: bool,
) -> None:
    """Look at a transmitter; the caller closes it.

    Raises:
        DeviceError: it does not answer, falls silent, or its scale cannot be used.
    """
    transmitter.connect()
    readings = _readings(transmitter, clock, rate_hz)
    faults = sorted({reading.fault for reading in readings if reading.fault})
    identity = f"identity {transmitter.identity}" if isinstance(transmitter, LaumasTransmitter) else transmitter.mode
    findings.judge(
        "load cell",
        not faults,
        ", ".join(faults) or f"{identity}; division {transmitter.resolution_n:.4f} N",
        "check the cell's cable and what hangs on it",
    )
    if faults:
        return
    gross_n = [reading.gross * transmitter.newton_per_unit for reading in readings]
    check_zero(findings, gross_n, force_n_from_kg(full_scale_kg), is_tool_on_head)
    _check_noise(findings, gross_n, transmitter.resolution_n)
    _check_rate(findings, len(readings) / WEIGH_S, rate_hz)
    _check_filter(findings, gross_n, transmitter.resolution_n, filter_setting)


def _readings(transmitter: WeightSource, clock: Clock, rate_hz: float) -> list[Reading]:
    """Take readings of `WEIGH_S` at the rate of the bench file, or as fast as they come."""
    readings: list[Reading] = []
    next_s = clock.now_s()
    until_s = next_s + WEIGH_S
    while next_s < until_s:
        next_s = max(next_s + 1.0 / rate_hz, clock.now_s())
        clock.sleep(next_s - clock.now_s())
        readings += transmitter.read_new()
    if len(readings) < FEWEST_READINGS:
        raise DeviceError(
            f"The weight transmitter gave {len(readings)} readings in {WEIGH_S:g} s, at least {FEWEST_READINGS} are "
            "needed; check its cable and restart it."
        )
    return readings


def check_zero(findings: Findings, gross_n: Sequence[float], full_scale_n: float, is_tool_on_head: bool) -> None:
    """Look at readings of a second or more: what hangs on the cell weighs what it can, and stays the same."""
    mean_n = statistics.fmean(gross_n)
    half = len(gross_n) // 2
    drift_n = statistics.fmean(gross_n[half:]) - statistics.fmean(gross_n[:half])
    most_n = MOST_GROSS_SHARE * full_scale_n
    hanging = "head and tool" if is_tool_on_head else "the head"
    fix = None
    if mean_n < LEAST_GROSS_N:
        fix = "the head pulls it negative: swap the signal wires, or set the zero again with nothing hanging (keypad)"
    elif mean_n > most_n:
        fix = f"more than {most_n:.0f} N with {hanging} hanging free: look what lies on it, then set the zero (keypad)"
    elif abs(drift_n) > MOST_DRIFT_N:
        fix = f"it moved by {drift_n:.2f} N in a second: wait ten minutes after power-up, let the head hang still"
    findings.add("load-cell zero", f"{mean_n:.2f} N gross with {hanging} hanging", fix)


def _check_noise(findings: Findings, gross_n: list[float], resolution_n: float) -> None:
    sd_n = statistics.pstdev(gross_n)
    fix = None
    if sd_n == 0:
        fix = "a live cell is never this quiet: restart the transmitter, check the cable, choose a finer division"
    elif sd_n > MOST_NOISE_N:
        fix = f"at most {MOST_NOISE_N:g} N: look for what shakes the frame; ground the cable's shield at one end only"
    findings.add("load-cell noise", f"{sd_n:.3f} N, {sd_n / resolution_n:.1f} divisions", fix)


def _check_rate(findings: Findings, found_hz: float, rate_hz: float) -> None:
    findings.judge(
        "load-cell rate",
        LEAST_RATE_SHARE * rate_hz <= found_hz <= MOST_RATE_SHARE * rate_hz,
        f"{found_hz:.0f} readings a second, the bench file says {rate_hz:g}",
        "set rate and baud rate on the keypad, or make `force_rate_hz` what comes: strings of a burst are timed by it",
    )


def _check_filter(findings: Findings, gross_n: list[float], resolution_n: float, filter_setting: int) -> None:
    n_fresh = sum(now != before for before, now in zip(gross_n, gross_n[1:], strict=False))
    share = n_fresh / (len(gross_n) - 1)
    seen = f"the bench file says {filter_setting}; {spell_share(share)} of the readings are fresh"
    is_judged = statistics.pstdev(gross_n) >= JUDGED_COUNTS * resolution_n
    fix = None
    if filter_setting > SLOWEST_FILTER:
        fix = "set filter 0 or 1 on the keypad and `transmitter_filter` to it: slower ones flatten the peak"
    elif is_judged and share < FRESH_SHARE:
        fix = "the instrument refreshes slower: set filter 0 or 1 on the keypad, or lower `force_rate_hz` to its rate"
    findings.add("load-cell filter", seen, fix)
