"""The table of three shapes counts what is asked, each with its bound."""

import pytest

from fast.flows.challenge.hidden.worlds import Group, Hidden, WorldKey
from tests.studies.gap.answers import Answer, Closing, Said
from tests.studies.gap.oracle import AtBest
from tests.studies.gap.shapes import ShapeOutcome, make_tables


def outcome(
    group: Group,
    number: int,
    said: str,
    *effects: str,
    hidden: tuple[str, ...] = (),
    visible: float = 0.05,
    left_out: bool = False,
    probability: float = 0.8,
    closing: Closing | None = None,
) -> ShapeOutcome:
    """An answer to a world that hides so much of these effects."""
    key = WorldKey(
        group=group,
        number=number,
        seed=number,
        base="base-0",
        young_modulus_mpa=9.0,
        effects=tuple(Hidden(effect=name, visible_strength=visible, spread_strength=visible) for name in hidden),
    )
    kind = {"none": "none", "unknown": "unknown"}.get(said, "effect")
    first = Said(kind=kind, effects=effects, probability=probability, possible=effects)  # type: ignore[arg-type]
    return ShapeOutcome(
        shape=(7, 5),
        key=key,
        answer=Answer(code="", rounds=(first,), closing=closing, cpu_s=0.5),
        left_out=left_out,
        twin_n=None if closing is None else 0.4,
        bound=0.9 if hidden else 0.0,
        seen_size=0.03,
        rehearsed=(None, 0.5, 0.9, 1.0, None),
        at_best=AtBest(names=0.95, is_wrong=0.05, brier=0.04) if group != "pair" and not left_out else None,
    )


@pytest.fixture(scope="module")
def rows() -> dict[str, dict[str, object]]:
    outcomes = [
        *(outcome("null", number, "none") for number in range(9)),
        outcome("null", 9, "unknown"),
        outcome(
            "single",
            0,
            "effect",
            "load_cell_lag",
            hidden=("load_cell_lag",),
            closing=Closing(before_n=1.4, after_n=0.6),
        ),
        outcome("single", 1, "effect", "tool_weight", hidden=("load_cell_lag",)),
        outcome("single", 2, "none", hidden=("load_cell_lag",), visible=0.12),
        outcome("single", 0, "effect", "tool_weight", hidden=("load_cell_lag",), left_out=True),
        outcome("unlisted", 0, "unknown", hidden=("pulling_hose",)),
        outcome("unlisted", 1, "effect", "load_cell_offset", hidden=("pulling_hose",)),
        outcome("pair", 0, "effect", "load_cell_lag", hidden=("load_cell_lag", "tool_weight")),
    ]
    return {str(row["figure"]): row for row in make_tables(outcomes)["figures"]}


@pytest.mark.parametrize(
    ("figure", "seen", "worlds"),
    [
        ("false alarms", 1, 10),
        ("alarm, catalogued, visible 2 %", 2, 3),
        ("alarm, in no catalogue, visible 2%", 2, 2),
        ("the same with left-out effects, 4%", 3, 3),
        ("“none” said at 10 % or more", 1, 1),
        ("family right, given an alarm", 1, 2),
        ("wrong family, in no catalogue", 1, 2),
        ("wrong family, left out of the catalogue", 1, 1),
        ("two effects, both families", 0, 1),
        ("what could still hide: larger ones that are seen", 4, 5),
    ],
)
def test_figures_are_counts(rows: dict[str, dict[str, object]], figure: str, seen: int, worlds: int) -> None:
    assert (rows[figure]["seen"], rows[figure]["worlds"]) == (seen, worlds)


def test_alarms_have_the_bound_of_the_same_worlds(rows: dict[str, dict[str, object]]) -> None:
    assert rows["alarm, catalogued, visible 2 %"]["bound"] == pytest.approx(0.9)
    assert rows["“none” said at 10 % or more"]["bound"] == pytest.approx(0.1)


def test_names_and_probabilities_have_the_bound_of_an_oracle(rows: dict[str, dict[str, object]]) -> None:
    assert rows["family right, given an alarm"]["bound"] == pytest.approx(0.95)
    assert rows["wrong family, in no catalogue"]["bound"] == pytest.approx(0.05)
    assert rows["Brier score"]["bound"] == pytest.approx(0.04)
    assert "bound" not in rows["two effects, both families"]
    assert "bound" not in rows["wrong family, left out of the catalogue"]


def test_what_can_be_closed_is_told_apart_from_what_nobody_can(rows: dict[str, dict[str, object]]) -> None:
    """Of 1.4 N, 0.4 N are those of the world with nothing hidden; 0.8 N of the other 1.0 N are closed."""
    assert rows["gap closed of what can be closed, median"]["value"] == pytest.approx(0.8)
    assert rows["the size that was stated, %"]["value"] == pytest.approx(3.0)


def test_shapes_stand_beside_each_other() -> None:
    outcomes = [outcome("null", 0, "none"), outcome("null", 0, "unknown").model_copy(update={"shape": (8, 6)})]
    (row,) = (row for row in make_tables(outcomes)["table"] if row["figure"] == "false alarms")
    assert row["7 x 5"].startswith("0 of 1 [")
    assert row["8 x 6"].startswith("1 of 1 [")
