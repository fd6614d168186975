"""What machines call their columns and units, in the languages of those who build and use them.

The words are the plain ones of each language. What stands in files of known programs was read in the public pages that
`docs/reference/configuration.md` names.
"""

import re
import unicodedata
from typing import Literal

Quantity = Literal["time", "lift", "force"]

# Scale to s, mm and N, by a unit's usual spellings in lower case; spellings whose case matters are in _EXACT.
UNITS: dict[Quantity, dict[str, float]] = {
    "time": {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "sek": 1.0, "sekunden": 1.0,
             "secondes": 1.0, "secondi": 1.0, "segundos": 1.0, "秒": 1.0, "ms": 1e-3, "msec": 1e-3, "min": 60.0,
             "minutes": 60.0, "分": 60.0, "h": 3600.0, "hh:mm:ss": 1.0, "с": 1.0, "сек": 1.0, "мс": 1e-3, "мин": 60.0},
    "lift": {"mm": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "cm": 10.0, "m": 1000.0, "in": 25.4, "inch": 25.4,
             "inches": 25.4, '"': 25.4, "毫米": 1.0, "ミリ": 1.0, "мм": 1.0, "см": 10.0, "мкм": 1e-3},
    "force": {"n": 1.0, "newton": 1.0, "newtons": 1.0, "牛": 1.0, "牛顿": 1.0, "cn": 1e-2, "dan": 10.0, "kn": 1000.0,
              "g": 9.80665e-3, "gf": 9.80665e-3, "kg": 9.80665, "kgf": 9.80665, "kp": 9.80665,
              "lbf": 4.4482216152605, "lb": 4.4482216152605, "lbs": 4.4482216152605, "ozf": 0.27801385095378,
              "н": 1.0, "кн": 1000.0, "кгс": 9.80665, "гс": 9.80665e-3},
}  # fmt: skip
USUAL_UNITS: dict[Quantity, str] = {
    "time": "s, ms, min",
    "lift": "mm, um, cm, m, in",
    "force": "N, mN, cN, kN, gf, kgf, lbf",
}
_EXACT = {"mN": 1e-3, "MN": 1e6}
WORDS: dict[Quantity, tuple[str, ...]] = {
    "time": ("time", "elapsed", "timestamp", "datetime", "zeit", "temps", "tempo", "tiempo", "tijd", "czas", "zaman",
             "время", "時間", "时间", "시간"),
    "lift": ("extension", "displacement", "crosshead", "travel", "position", "stroke", "lift", "deformation",
             "deflection", "elongation", "weg", "verformung", "traverse", "déplacement", "deplacement", "course",
             "allongement", "spostamento", "corsa", "allungamento", "desplazamiento", "carrera", "extensión",
             "extensao", "extensão", "deslocamento", "verplaatsing", "uzama", "deplasman", "перемещение", "変位",
             "ストローク", "伸び", "位移", "行程", "伸长", "변위"),
    "force": ("load", "force", "kraft", "last", "charge", "effort", "forza", "carico", "fuerza", "carga", "força",
              "forca", "kracht", "siła", "kuvvet", "сила", "нагрузка", "試験力", "荷重", "試驗力", "力", "负荷", "载荷",
              "负载", "하중"),
}  # fmt: skip
# The last part of compound words: Standardkraft, Traversenweg, Prüfzeit.
_ENDINGS: dict[str, Quantity] = {"kraft": "force", "weg": "lift", "zeit": "time"}
# Whole names: symbols, and LabVIEW's first column, which is the time unless the head says otherwise.
_NAMES: dict[str, Quantity] = {"t": "time", "X_Value": "time", "F": "force"}
# Words of a column that keeps the largest value so far; another column of the same quantity goes before it.
_HELD = re.compile(r"peak|max|hold|spitze|höchst|crête|picco|pico|ピーク|峰值|最大", re.IGNORECASE)
# Words that say that a column holds something else, whatever else stands in its name.
_OTHERS = re.compile(
    r"strain|stress|rate|speed|modul|energy|dehnung|spannung|geschwindigkeit|contrainte|vitesse|rapport|"
    r"応力|ひずみ|应力|应变|速度|cycle|count",
    re.IGNORECASE,
)


def scale_of(quantity: Quantity, unit: str) -> float | None:
    """Return the factor to s, mm or N; None for what is no unit of this quantity."""
    bare = unicodedata.normalize("NFKC", unit).strip().strip("()[]<>{}").strip().rstrip(".")
    if quantity == "force" and bare in _EXACT:
        return _EXACT[bare]
    return UNITS[quantity].get(bare.lower())


def quantity_of_unit(unit: str) -> Quantity | None:
    """Return what a unit measures."""
    return next((quantity for quantity in UNITS if scale_of(quantity, unit) is not None), None)


def quantity_of_name(name: str) -> Quantity | None:
    """Return what a column's name says that it holds; `None` for names of other things, such as `Strain`."""
    plain = unicodedata.normalize("NFKC", name).strip().lower()
    if name.strip() in _NAMES:
        return _NAMES[name.strip()]
    if _OTHERS.search(plain):
        return None
    parts = [part for part in re.split(r"[\W\d_]+", plain) if part]
    found: list[Quantity] = []
    for quantity, words in WORDS.items():
        is_named = any(part in words or (_is_compact(part) and any(word in part for word in words)) for part in parts)
        if is_named or any(part.endswith(end) and _ENDINGS[end] == quantity for part in parts for end in _ENDINGS):
            found.append(quantity)
    return found[0] if found else None


def is_held(name: str) -> bool:
    """Return whether a column's name says that it keeps the largest value so far."""
    return _HELD.search(unicodedata.normalize("NFKC", name)) is not None


def _is_compact(part: str) -> bool:
    """Return whether words stand side by side without spaces, as in Japanese and Chinese."""
    return any(ord(letter) > 0x2E80 for letter in part)


def holds_word(text: str) -> bool:
    """Return whether a word of another alphabet for a column stands in a text."""
    plain = text.lower()
    return any(len(word) > 1 and ord(word[0]) > 0x3FF and word in plain for words in WORDS.values() for word in words)


def split_unit(name: str) -> tuple[str, str | None]:
    """Split `Load (N)`, `Kraft [N]`, `Force/N`, `Force_N` into name and unit; the unit is None where there is none."""
    plain = name.strip()
    for opening, closing in (("(", ")"), ("[", "]"), ("<", ">"), ("{", "}")):
        if plain.endswith(closing) and opening in plain:
            before, _, unit = plain[: -len(closing)].rpartition(opening)
            if quantity_of_unit(unit):
                return before.strip(), unit.strip()
    for mark in ("/", ",", "_", " in ", ":", " "):
        before, found, unit = plain.rpartition(mark)
        if found and before and quantity_of_unit(unit) and quantity_of_name(before):
            return before.strip(" ,:"), unit.strip()
    return plain, None
