"""Made-up measurements of tools, lots and cells, sound and with planted slips; what is asked about them.

A print has 0.05 mm more than drawn, give or take 0.1 mm, and each wall 0.06 mm of its own; durometers repeat to 2 Shore
A. A modulus scatters by 30 % about Gent's formula. Readings are those that a search's own effects would give.
"""

import numpy as np

from fast.models.design.measured import LENGTHS_MM, Wall, find_hardness_questions, find_wall_questions
from fast.models.gap.ask.person import find_reading_questions, list_measurements
from fast.models.material import (
    MODULI_MPA,
    QUANTITIES,
    MaterialLot,
    MaterialMeasurement,
    find_lot_questions,
    modulus_of_hardness_mpa,
)

N_TOOLS = 6
WALLS = ("front wall", "back wall", "ribs")
_Found = dict[str, list[bool | None]]


def measure_facts(n: int) -> _Found:
    """Whether each planted slip was asked about, by kind, in n made-up labs; None where it could not be seen."""
    found: _Found = {}
    for seed in range(n):
        rng = np.random.default_rng(2000 + seed)
        for name, asked in (*_walls(rng), *_hardness(rng), *_lots(rng), *_readings(rng)):
            found.setdefault(name, []).append(asked)
    return found


def _walls(rng: np.random.Generator) -> list[tuple[str, bool | None]]:
    drawn = {f"B01T{t}": {wall: float(rng.uniform(2.0, 3.0)) for wall in WALLS} for t in range(N_TOOLS)}
    more_mm = rng.normal(0.05, 0.1)
    sound = {
        tool: {wall: round(mm + more_mm + rng.normal(0.0, 0.06), 2) for wall, mm in walls.items()}
        for tool, walls in drawn.items()
    }

    def ask(told: dict[str, dict[str, float]], words: str = "") -> bool:
        walls = [Wall(tool, wall, mm, drawn[tool][wall]) for tool, of in told.items() for wall, mm in of.items()]
        return any(words in question.sentence for question in find_wall_questions(walls, drawn))

    def change(factor: float, digits: int) -> dict[str, dict[str, float]]:
        return {tool: {wall: round(mm * factor, digits) for wall, mm in of.items()} for tool, of in sound.items()}

    one = f"B01T{int(rng.integers(N_TOOLS))}"
    other = max((tool for tool in drawn if tool != one), key=lambda tool: _apart(drawn[one], drawn[tool]))
    is_turned = abs(drawn[one]["front wall"] - drawn[one]["back wall"]) > 4 * 0.06
    turned = {**sound[one], "front wall": sound[one]["back wall"], "back wall": sound[one]["front wall"]}
    return [
        ("walls: nothing", ask(sound)),
        ("walls: nothing, one tool", ask({one: sound[one]})),
        ("walls: all in cm", ask(change(0.1, 3), "cm")),
        ("walls: all in inch", ask(change(1 / LENGTHS_MM["inch"], 3), "inch")),
        (
            "walls: a decimal point",
            ask({**sound, one: {**sound[one], "ribs": round(10 * sound[one]["ribs"], 1)}}, "decimal"),
        ),
        (
            "walls: copied from the sheet",
            ask({t: {w: round(mm, 2) for w, mm in of.items()} for t, of in drawn.items()}, "copied"),
        ),
        (
            "walls: a tool told twice",
            ask({**sound, one: sound[other]}) if _apart(drawn[one], drawn[other]) > 0.24 else None,
        ),
        ("walls: exchanged tools", ask({**sound, one: sound[other], other: sound[one]}, "exchanged")),
        ("walls: exchanged front and back", ask({**sound, one: turned}, "exchanged") if is_turned else None),
    ]


def _apart(a: dict[str, float], b: dict[str, float]) -> float:
    return float(np.linalg.norm([a[wall] - b[wall] for wall in WALLS]))


def _hardness(rng: np.random.Generator) -> list[tuple[str, bool | None]]:
    lot = float(rng.uniform(28.0, 85.0))
    sound = {f"B01T{t}": float(round(lot + rng.normal(0.0, 2.0))) for t in range(N_TOOLS)}
    known = float(round(lot + rng.normal(0.0, 2.0)))

    def ask(told: dict[str, float], words: str = "") -> bool:
        return any(words in q.sentence for q in find_hardness_questions(told, [], known, None))

    shore_00 = {tool: float(round(_shore_00(value))) for tool, value in sound.items()}
    shore_d = {tool: value - 50.0 for tool, value in sound.items()}
    return [
        ("hardness: nothing", ask(sound)),
        ("hardness: Shore 00", ask(shore_00, "Shore 00") if shore_00["B01T0"] - lot > 20 else None),
        ("hardness: Shore D", ask(shore_d, "Shore D") if min(shore_d.values()) > 20 else None),
        ("hardness: a decimal point", ask({**sound, "B01T1": sound["B01T1"] / 10}, "decimal")),
    ]


def _shore_00(shore_a: float) -> float:
    """Shore 00 hardness that `shore_a_of_shore_00` takes to this Shore A."""
    from fast.models.design.measured import shore_a_of_shore_00

    scale = np.linspace(0.0, 99.5, 400)
    return float(np.interp(shore_a, [shore_a_of_shore_00(one) for one in scale], scale))


def _lots(rng: np.random.Generator) -> list[tuple[str, bool | None]]:
    shore_a = float(round(rng.uniform(30.0, 85.0)))
    modulus_mpa = modulus_of_hardness_mpa(shore_a) * float(np.exp(rng.normal(0.0, 0.3)))
    friction = float(np.clip(np.exp(rng.normal(np.log(0.55), 0.4)), 0.15, 1.6))
    sound = {"young_modulus": modulus_mpa, "hardness": shore_a, "static_friction": friction}

    def ask(changed: dict[str, float], words: str = "", sd: float = 0.12) -> bool:
        values = {name: float(f"{value:.3g}") for name, value in {**sound, **changed}.items()}
        try:
            lot = _lot(values, sd, "own bars")
        except ValueError as error:
            return words in str(error)
        return any(words in q.sentence for q in find_lot_questions("L7", lot, list(lot.measured), {}, None))

    copied = _lot({name: float(f"{value:.3g}") for name, value in sound.items()}, 0.12, "the maker")
    mine = _lot({name: float(f"{value:.3g}") for name, value in sound.items()}, 0.12, "own bars")
    rows: list[tuple[str, bool | None]] = [("lot: nothing", ask({}))]
    for unit in ("psi", "kPa", "Pa", "bar", "kgf/mm2", "ksi"):
        rows.append((f"lot: modulus in {unit}", ask({"young_modulus": modulus_mpa / MODULI_MPA[unit]}, unit)))
    return [
        *rows,
        ("lot: a decimal point in the modulus", ask({"young_modulus": 10 * modulus_mpa}, "decimal")),
        ("lot: friction in per cent", ask({"static_friction": 100 * friction}, "per cent")),
        ("lot: a decimal point in the friction", ask({"static_friction": friction / 10}, "decimal")),
        ("lot: sd in per cent", ask({}, "per cent", sd=12.0) if modulus_mpa < 15.0 else None),
        (
            "lot: numbers of another lot",
            bool(find_lot_questions("L8", mine, list(mine.measured), {"L7": copied}, None)),
        ),
    ]


def _lot(values: dict[str, float], sd_share: float, source: str) -> MaterialLot:
    """A lot; the sd of the modulus is a share of it, or if above 1 that many per cent told as MPa."""
    found = {}
    for name, value in values.items():
        sd = None if name != "young_modulus" else sd_share * value if sd_share < 1 else sd_share
        found[name] = MaterialMeasurement(
            value=value, unit=QUANTITIES[name][0], sd=sd, n=5, method="measured", source=source
        )
    return MaterialLot(**found)


def _readings(rng: np.random.Generator) -> list[tuple[str, bool | None]]:
    sound: dict[str, float] = {}
    for effect, one in list_measurements():
        spec = next(p for p in effect.parameters if p.name == one.parameter)
        value = rng.normal(spec.prior_median, spec.prior_sd) if rng.random() < 0.7 else 0.0
        sound[one.kind] = float(f"{np.clip(value, spec.lower, spec.upper) + rng.normal(0.0, one.sd):.3g}")
    sound |= {kind: max(sound[kind], 0.0) for kind in ("photograph", "jaw_push", "post_push")}

    def ask(kind: str, value: float, words: str = "", known: tuple[float, float] | None = None) -> bool:
        return any(words in question.sentence for question in find_reading_questions(kind, value, known))

    more_mm, of_tools = sound["walls"], (sound["walls"] + rng.normal(0.0, 0.03), 0.055)
    jaw = max(sound["jaw_push"], 0.005)
    return [
        ("reading: nothing, any of seven", any(ask(kind, value) for kind, value in sound.items())),
        ("reading: nothing, walls beside measured tools", ask("walls", more_mm, known=of_tools)),
        ("reading: the whole wall", ask("walls", 2.5 + more_mm, "the whole wall")),
        ("reading: walls in um", ask("walls", 1000 * (more_mm or 0.05), "um")),
        (
            "reading: a decimal point, beside measured tools",
            ask("walls", 10 * more_mm, known=of_tools) if 9 * abs(more_mm) > 0.3 else None,
        ),
        ("reading: the whole weight, N", ask("dead_weight", 9.81 + sound["dead_weight"], "the whole reading")),
        (
            "reading: the whole weight, kg",
            ask("dead_weight", 1.0 + sound["dead_weight"] / 9.81, "the whole reading in kg"),
        ),
        ("reading: the ratio of moduli itself", ask("tensile_bar", 1.0 + sound["tensile_bar"], "the ratio itself")),
        ("reading: the excess in per cent", ask("tensile_bar", 100 * (abs(sound["tensile_bar"]) + 0.03), "per cent")),
        ("reading: the way of the jaw at 20 N", ask("jaw_push", 20 * jaw, "the way at 20 N") if jaw > 0.01 else None),
        ("reading: stiffness in place of compliance", ask("jaw_push", 1 / jaw, "N/mm")),
    ]
