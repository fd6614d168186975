"""What was measured of a lot of printing material: a value for each quantity, its scatter, its source; what is strange.

A modulus is compared with the hardness of the lot by Gent's formula, a friction with that of soft prints on plastics,
the scatter of single tests with their mean, and all of it with the other lots of the lake.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from fast.models.design.measured import find_hardness_questions
from fast.models.question import Question, Slip, apart_of_log, ask_of, slips_of_factor
from fast.models.records import Record

LAYER_EXCESS = "layer_modulus_excess"  # modulus of a bar printed upright over that of a flat one, less 1
# Unit of each quantity, and the range in which a value is believed: for modulus and friction that of the simulator.
QUANTITIES: dict[str, tuple[str, float, float]] = {
    "young_modulus": ("MPa", 0.5, 200.0),
    "static_friction": ("1", 0.02, 2.0),
    "dynamic_friction": ("1", 0.02, 2.0),
    "hardness": ("Shore A", 10.0, 100.0),
    LAYER_EXCESS: ("1", -0.9, 2.0),
}
TABLE_3 = "none"  # asks for the priors of the paper's Table 3, so no lot may have this name

MODULI_MPA = {
    "psi": 6.894757e-3, "ksi": 6.894757, "Pa": 1e-6, "kPa": 1e-3, "GPa": 1e3, "bar": 0.1, "kgf/cm2": 0.0980665,
    "kgf/mm2": 9.80665, "N/cm2": 0.01,
}  # fmt: skip
_MODULUS_LN_SD = 0.45  # about Gent's formula: secant or initial slope, elastomers that are not rubbers
_FRICTIONS = (0.55, 0.55)  # median, and standard deviation of the logarithm, of soft prints on plastics
_FAR_SD = 3.0
_LEAST_SHARE, _MOST_SHARE = 1e-3, 0.6  # of a mean that the scatter of single tests has
_LEAST_COPIED = 3


class MaterialMeasurement(Record):
    """One quantity of a lot: mean of `n` tests, and the standard deviation of single tests in the same unit."""

    value: float
    unit: str
    sd: float | None = Field(default=None, gt=0)
    n: int | None = Field(default=None, ge=1)
    method: str = Field(min_length=1)
    source: str = Field(min_length=1)
    sure: bool = Field(default=False, description="it is so, however strange it looks")


class MaterialLot(Record):
    """What is known of a lot of material; a quantity that nobody measured is None."""

    young_modulus: MaterialMeasurement | None = None
    static_friction: MaterialMeasurement | None = None
    dynamic_friction: MaterialMeasurement | None = None
    hardness: MaterialMeasurement | None = None
    layer_modulus_excess: MaterialMeasurement | None = None

    @field_validator(*QUANTITIES)
    @classmethod
    def _check_value(cls, measured: MaterialMeasurement | None, info: ValidationInfo) -> MaterialMeasurement | None:
        if measured is None:
            return None
        unit = QUANTITIES[str(info.field_name)][0]
        if measured.unit != unit:
            raise ValueError(f'the unit is "{measured.unit}", it must be "{unit}"; convert value and sd')
        return measured

    @model_validator(mode="after")
    def _check_ranges(self) -> Self:
        for question in find_lot_questions("", self, list(self.measured), {}, None):
            if question.kind == "impossible":
                raise ValueError(question.sentence)
        return self

    @property
    def measured(self) -> dict[str, MaterialMeasurement]:
        """The quantities that were measured, by name."""
        return {name: found for name in QUANTITIES if (found := getattr(self, name)) is not None}


def modulus_of_hardness_mpa(hardness_shore_a: float) -> float:
    """Compute Young's modulus of a rubber by its Shore A hardness S (Gent 1958, Rubber Chem. Technol. 31, 896), MPa.

        E = 0.0981 (56 + 7.62336 S) / (0.137505 (254 - 2.54 S))

    The durometer's spring force over its depth, as of a flat punch of the tip's mean radius on an incompressible
    half-space. Good to some ten per cent for 20 to 80; too rough for a prior, enough to catch a slip of the pen.
    """
    return 0.0981 * (56.0 + 7.62336 * hardness_shore_a) / (0.137505 * (254.0 - 2.54 * hardness_shore_a))


def find_lot_questions(
    name: str, lot: MaterialLot, new: Sequence[str], others: Mapping[str, MaterialLot], tools_shore_a: float | None
) -> list[Question]:
    """Ask about new quantities of a lot; `others`: lots of the lake, `tools_shore_a`: of its printed tools."""
    found: list[Question] = []
    for number, quantity in enumerate(new):
        measured = lot.measured[quantity]
        place = f"lot {name}, {quantity}" if name else quantity
        if quantity == "young_modulus":
            hardness = lot.hardness.value if lot.hardness is not None else tools_shore_a
            found += _ask_modulus(place, measured.value, number, hardness)
        elif quantity == "hardness":
            of_tools = [] if tools_shore_a is None else [tools_shore_a]
            asked = find_hardness_questions({"": measured.value}, of_tools, None, None)
            found += [_place(question, place, number) for question in asked]
        elif quantity == LAYER_EXCESS:
            found += _ask_excess(place, measured.value, number)
        else:
            found += _ask_friction(place, measured.value, number)
        found += _ask_scatter(place, measured, number)
    return found + _find_copies(name, lot, new, others)


def _ask_modulus(place: str, value: float, number: int, hardness: float | None) -> list[Question]:
    _, lowest, highest = QUANTITIES["young_modulus"]
    is_possible = lowest <= value <= highest
    slips = [slip for slip in slips_of_factor(value, MODULI_MPA) if lowest <= slip.meant <= highest]
    if hardness is None:
        return (
            []
            if is_possible
            else [_forbid(place, f"{value:g} MPa", number, slips, (8.0, 4.0), (lowest, highest, "MPa"))]
        )
    expected = modulus_of_hardness_mpa(hardness)
    if is_possible and abs(math.log(value / expected)) < _FAR_SD * _MODULUS_LN_SD:
        return []
    told = f"{value:g} MPa, {hardness:g} Shore A are about {expected:.3g} MPa"
    if not is_possible:
        return [_forbid(place, told, number, slips, (expected, _MODULUS_LN_SD), (lowest, highest, "MPa"))]
    return [ask_of(place, told, number, slips, apart_of_log(expected, _MODULUS_LN_SD), "MPa")]


def _ask_friction(place: str, value: float, number: int) -> list[Question]:
    _, lowest, highest = QUANTITIES["static_friction"]
    middle, sd = _FRICTIONS
    slips = [*slips_of_factor(value, {}), Slip("unit", "per cent", value / 100)]
    if not lowest <= value <= highest:
        return [_forbid(place, f"{value:g}", number, slips, _FRICTIONS, (lowest, highest, ""))]
    if abs(math.log(value / middle)) < _FAR_SD * sd:
        return []
    return [
        ask_of(place, f"{value:g}, soft prints have {middle:g} or so", number, slips, apart_of_log(*_FRICTIONS), "")
    ]


def _ask_excess(place: str, value: float, number: int) -> list[Question]:
    """Ask about a reading of the kind that a gap search asks for as `tensile_bar`."""
    from fast.models.gap.ask.person import find_reading_questions

    return [_place(question, place, number) for question in find_reading_questions("tensile_bar", value)]


def _place(question: Question, place: str, number: int) -> Question:
    return question._replace(sentence=f"{place}: {question.sentence.partition(': ')[2]}", numbers=(number,))


def _ask_scatter(place: str, measured: MaterialMeasurement, number: int) -> list[Question]:
    """Ask about a scatter of single tests in another unit than their mean, or with a slip of its decimal point."""
    if measured.sd is None or measured.value == 0.0:
        return []
    share = measured.sd / abs(measured.value)
    if _LEAST_SHARE <= share <= _MOST_SHARE:
        return []
    told = f"{measured.value:g} with sd {measured.sd:g}, {100 * share:.3g} % of it"
    slips = [Slip("unit", "sd in per cent", measured.sd * abs(measured.value) / 100), *slips_of_factor(measured.sd, {})]
    return [ask_of(place, told, number, slips, apart_of_log(0.1 * abs(measured.value), 0.6), "")]


def _forbid(
    place: str,
    told: str,
    number: int,
    slips: Sequence[Slip],
    expected: tuple[float, float],
    limits: tuple[float, float, str],
) -> Question:
    lowest, highest, unit = limits
    question = ask_of(place, told, number, slips, apart_of_log(*expected), unit)
    text = f"{question.sentence} (it is {lowest:g} to {highest:g} {unit}".rstrip() + ")"
    return question._replace(kind="impossible", sentence=text)


def _find_copies(name: str, lot: MaterialLot, new: Sequence[str], others: Mapping[str, MaterialLot]) -> list[Question]:
    """Find numbers of another lot to the last digit, with another source: copied, or told under two names."""
    for other, theirs in others.items():
        same = [
            number
            for number, quantity in enumerate(new)
            if (found := theirs.measured.get(quantity)) is not None
            and (found.value, found.sd) == (lot.measured[quantity].value, lot.measured[quantity].sd)
            and found.source != lot.measured[quantity].source
        ]
        if other != name and len(same) >= _LEAST_COPIED:
            return [Question("copied", f"lot {name} has {len(same)} numbers of lot {other}, copied?", tuple(same))]
    return []
