"""What a bench can do otherwise than in ordinary grasps: one knob turned, everything else as usual."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from fast.models.records import GraspSetup, Placement


@dataclass(frozen=True)
class Setting:
    """A setup and a placement, usually with one knob turned. `words`: what is done otherwise.

    `is_timing`: the simulator is quasi-static, so that what was simulated serves at this setting too.
    """

    setup: GraspSetup
    placement: Placement = Placement()
    is_timing: bool = True
    words: str = field(default="", compare=False)

    @staticmethod
    def of(base: GraspSetup, setup: GraspSetup, placement: Placement) -> "Setting":
        """Return the setting of a grasp that was made."""
        is_timing = setup.timed_as(base) == base and placement == Placement()
        return Setting(setup, placement, is_timing)


_LIFT_SPEEDS_MM_PER_S = (1.0, 2.0, 10.0, 20.0)
_CLOSING_SPEEDS_MM_PER_S = (5.0, 40.0)
_DWELLS_S = (10.0, 30.0)
_PRESSURE_SHARES = (2.0 / 3.0, 4.0 / 3.0)
_USUAL_PSI = 30.0
_GAPS_MM = (-4.0, 4.0, 8.0)  # added to the closed gap
_TIPS_MM = (-4.0, 4.0)
_OFFSETS: Mapping[str, Sequence[float]] = {"offset_x_mm": (3.0,), "offset_y_mm": (5.0,), "yaw_deg": (15.0,)}
_WORDS = {
    "offset_x_mm": "with the object {:g} mm off the middle in the closing direction",
    "offset_y_mm": "with the object {:g} mm off the middle across the fingers",
    "yaw_deg": "with the object turned by {:g} degrees",
}


def list_settings(base: GraspSetup) -> tuple[Setting, ...]:
    """List settings with one knob turned, whether or not a bench has it."""
    return (*_list_timings(base), *_list_strokes(base), *_list_placements(base))


def _list_timings(base: GraspSetup) -> list[Setting]:
    found = []
    for speed in _LIFT_SPEEDS_MM_PER_S:
        if speed != base.lift_speed_mm_per_s:
            words = f"lifted at {speed:g} mm/s instead of {base.lift_speed_mm_per_s:g}"
            found.append(Setting(_turn(base, lift_speed_mm_per_s=speed), words=words))
    for speed in _CLOSING_SPEEDS_MM_PER_S:
        if speed != base.close_speed_mm_per_s:
            words = f"closed at {speed:g} mm/s instead of {base.close_speed_mm_per_s:g}"
            found.append(Setting(_turn(base, close_speed_mm_per_s=speed), words=words))
    for dwell_s in _DWELLS_S:
        words = f"held closed for {base.dwell_s + dwell_s:g} s before the lift"
        found.append(Setting(_turn(base, dwell_s=base.dwell_s + dwell_s), words=words))
    usual_psi = base.supply_pressure_psi or _USUAL_PSI
    for share in _PRESSURE_SHARES:
        words = f"closed with {share * usual_psi:.0f} psi instead of {usual_psi:g}"
        found.append(Setting(_turn(base, supply_pressure_psi=round(share * usual_psi)), words=words))
    return found


def _list_strokes(base: GraspSetup) -> list[Setting]:
    found = []
    for wider_mm in _GAPS_MM:
        gap_mm = base.closed_gap_mm + wider_mm
        words = f"closed to {gap_mm:g} mm instead of {base.closed_gap_mm:g}"
        found.append(Setting(_turn(base, closed_gap_mm=gap_mm), is_timing=False, words=words))
    for deeper_mm in _TIPS_MM:
        words = f"with the tips {abs(deeper_mm):g} mm {'deeper' if deeper_mm > 0 else 'higher'}"
        setup = _turn(base, tip_below_mm=base.tip_below_mm + deeper_mm)
        found.append(Setting(setup, is_timing=False, words=words))
    return found


def _list_placements(base: GraspSetup) -> list[Setting]:
    return [
        Setting(base, Placement(**{name: value}), is_timing=False, words=_WORDS[name].format(value))
        for name, values in _OFFSETS.items()
        for value in values
    ]


def _turn(base: GraspSetup, **values: float) -> GraspSetup:
    return base.model_copy(update=values)
