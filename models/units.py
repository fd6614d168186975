"""Unit conversions. Inside FAST everything is mm, N, MPa, s; only the edges convert.

The suffix of a name is its unit; `UNIT_OF_SUFFIX` is what the lake writes into field metadata.
"""

from collections.abc import Sequence

STANDARD_GRAVITY_M_PER_S2 = 9.80665  # CGPM 1901, exact

UNIT_OF_SUFFIX = {
    "_mm_per_s": "mm/s",
    "_mm_per_n": "mm/N",
    "_n_per_mm": "N/mm",
    "_mm2": "mm2",
    "_mm3": "mm3",
    "_mm": "mm",
    "_deg": "deg",
    "_kpa": "kPa",
    "_mpa": "MPa",
    "_psi": "psi",
    "_hz": "Hz",
    "_kg": "kg",
    "_n": "N",
    "_j": "J",
    "_s": "s",
    "_g": "g",
}


def unit_of(name: str) -> str | None:
    """Return the unit of a name by its suffix (`force_n` -> `N`), or None for a pure number or text."""
    if name.startswith("n_"):
        return None
    for suffix, unit in UNIT_OF_SUFFIX.items():
        if name.endswith(suffix):
            return unit
    return None


def spell_name(name: str, with_unit: bool = False) -> str:
    """Spell a name in words, its unit left out (`rib_angle_deg` -> `rib angle`) or in brackets behind it."""
    unit = unit_of(name)
    suffix = next((suffix for suffix in UNIT_OF_SUFFIX if unit and name.endswith(suffix)), "")
    return name.removesuffix(suffix).replace("_", " ") + (f" ({unit})" if unit and with_unit else "")


def spell_minutes(minutes: float) -> str:
    """Spell whole minutes, one at least; the same for a number and for it with one decimal, as findings keep it."""
    return f"{max(int(round(minutes, 1) + 0.5), 1)} min"


def spell_share(share: float, digits: int = 0) -> str:
    """Spell a share as a person reads it, with the space that the SI asks for (0.26 -> `26 %`)."""
    return f"{100.0 * share:z.{digits}f} %"


def spell_list(words: Sequence[str]) -> str:
    """Spell a list: `a`, `a and b`, `a, b and c`."""
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def spell_chance(chance: float) -> str:
    """Spell a probability as a person reads it; what was rehearsed a number of times is never said to be sure."""
    if 0.005 <= chance <= 0.995:
        return spell_share(chance)
    return "less than 1 %" if chance < 0.5 else "more than 99 %"


def spell_count(n: int, noun: str) -> str:
    """Spell a number of things: `1 tool`, `3 tools`."""
    return f"{n} {noun}{'' if n == 1 else 's'}"


def spell_number(value: float, digits: int = 2) -> str:
    """Spell a number of so many digits, large ones without an exponent (127.4 -> `130`, 0.0312 -> `0.031`)."""
    rounded = float(f"{value:.{digits}g}")
    return typeset(rounded, ".0f" if abs(rounded) >= 10.0**digits else f"z.{digits}g")


def typeset(value: float, form: str) -> str:
    """Typeset a number by a format, for people: with the minus sign of figures. What programs read keeps `-`."""
    return format(value, form).replace("-", "\u2212")


def force_n_from_kg(mass_kg: float) -> float:
    """Return the force of a mass under standard gravity: load cells are read in kg."""
    return mass_kg * STANDARD_GRAVITY_M_PER_S2


def work_j_from_n_mm(work_n_mm: float) -> float:
    """Return the area under a force-displacement curve in N mm, as J."""
    return work_n_mm * 1e-3
