"""What machines call their columns and units, in the languages of those who build and use them.

Sources: column names in the public manuals and example exports of Instron Bluehill Universal, ZwickRoell testXpert,
Shimadzu TRAPEZIUM X, MTS TestSuite and Mark-10 MESURgauge, and the plain words of each language.
"""

from typing import Literal

Quantity = Literal["time", "lift", "force"]

# Scale to s, mm and N, by a unit's usual spellings in lower case; spellings whose case matters are in _EXACT.
UNITS: dict[Quantity, dict[str, float]] = {
    "time": {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "sek": 1.0, "ms": 1e-3, "msec": 1e-3,
             "min": 60.0, "秒": 1.0},
    "lift": {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "cm": 10.0, "m": 1000.0, "in": 25.4, "inch": 25.4,
             "inches": 25.4, "毫米": 1.0},
    "force": {"n": 1.0, "newton": 1.0, "newtons": 1.0, "cn": 1e-2, "dan": 10.0, "kn": 1000.0, "gf": 9.80665e-3,
              "kgf": 9.80665, "kp": 9.80665, "lbf": 4.4482216152605, "lb": 4.4482216152605, "ozf": 0.27801385095378},
}  # fmt: skip
USUAL_UNITS: dict[Quantity, str] = {
    "time": "s, ms, min",
    "lift": "mm, um, cm, m, in",
    "force": "N, mN, cN, kN, gf, kgf, lbf",
}
_EXACT = {"mN": 1e-3, "MN": 1e6}
WORDS: dict[Quantity, tuple[str, ...]] = {
    "time": ("time", "zeit", "prüfzeit", "temps", "tempo", "tiempo", "tijd", "время", "時間", "时间", "시간"),
    "lift": ("extension", "displacement", "crosshead", "travel", "position", "stroke", "lift", "weg", "traversenweg",
             "standardweg", "verformung", "déplacement", "deplacement", "course", "allongement", "spostamento", "corsa",
             "desplazamiento", "carrera", "extensión", "extensao", "deslocamento", "verplaatsing", "перемещение",
             "変位", "ストローク", "位移", "변위"),
    "force": ("load", "force", "kraft", "standardkraft", "prüfkraft", "last", "charge", "effort", "forza", "carico",
              "fuerza", "carga", "força", "forca", "kracht", "сила", "нагрузка", "試験力", "荷重", "力", "하중"),
}  # fmt: skip


def scale_of(quantity: Quantity, unit: str) -> float | None:
    """Factor to s, mm or N; None for what is no unit of this quantity."""
    bare = unit.strip().strip("()[]<>").strip().rstrip(".")
    if quantity == "force" and bare in _EXACT:
        return _EXACT[bare]
    return UNITS[quantity].get(bare.lower())


def quantity_of_unit(unit: str) -> Quantity | None:
    """What a unit measures."""
    return next((quantity for quantity in UNITS if scale_of(quantity, unit) is not None), None)


def quantity_of_name(name: str) -> Quantity | None:
    """What a column's name says that it holds; `None` for names of other things, such as `Strain`."""
    plain = name.strip().lower()
    for quantity, words in WORDS.items():
        if any(plain == word or plain.startswith((f"{word} ", f"{word}_", f"{word}-")) for word in words):
            return quantity
    found = [quantity for quantity, words in WORDS.items() if any(word in plain for word in words if len(word) > 3)]
    return found[0] if len(set(found)) == 1 else None


def split_unit(name: str) -> tuple[str, str | None]:
    """`Load (N)`, `Kraft [N]`, `Force/N`, `Force_N` as name and unit; the unit is None where there is none."""
    plain = name.strip()
    for opening, closing in (("(", ")"), ("[", "]"), ("<", ">")):
        if plain.endswith(closing) and opening in plain:
            before, _, unit = plain[: -len(closing)].rpartition(opening)
            if quantity_of_unit(unit):
                return before.strip(), unit.strip()
    for mark in ("/", ",", "_", " in ", " "):
        before, found, unit = plain.rpartition(mark)
        if found and before and quantity_of_unit(unit) and quantity_of_name(before):
            return before.strip(), unit.strip()
    return plain, None
