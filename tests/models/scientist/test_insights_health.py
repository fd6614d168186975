"""Rules of the health cards: the limits between colours, and a next step wherever one is not green."""

import pytest

from fast.models.scientist.insights.health import HealthFacts, health_cards, worst_of

GOOD = HealthFacts(
    campaign_id="demo", n_tools=20, repeats_share=0.1, drift=0.01, drift_tool="demo/B01T0", object_share=0.1,
    object_name="cube (30)", n_objects=36, off_mm=0.03, n_walls_measured=20, n_grasps=2000, n_failed=3,
)  # fmt: skip


def test_all_is_green_and_nothing_is_to_do() -> None:
    cards = health_cards(GOOD)
    assert {card.name for card in cards} == {"repeats", "drift", "objects", "prints", "failed grasps"}
    assert worst_of(cards) == "green"
    assert not any(card.next_step for card in cards)


@pytest.mark.parametrize(
    ("name", "change", "tone", "words"),
    [
        ("repeats", {"repeats_share": 0.3}, "yellow", "uncertain by 30 %"),
        ("repeats", {"repeats_share": 0.6}, "red", "uncertain by 60 %"),
        ("drift", {"drift": -0.07}, "yellow", "holds 7 % less than at first"),
        ("drift", {"drift": 0.2}, "red", "holds 20 % more than at first"),
        ("objects", {"object_share": 0.4}, "yellow", "Cube (30) has a part in 40 %"),
        ("objects", {"object_share": 0.4, "n_objects": 4}, "green", "one of 4 objects"),
        ("prints", {"off_mm": 0.15}, "yellow", "0.15 mm off their drawing"),
        (
            "prints",
            {"off_mm": 0.25, "n_walls_measured": 1},
            "red",
            "0.25 mm off their drawing in the median (prints measured: 1)",
        ),
        ("failed grasps", {"n_failed": 100}, "yellow", "100 of 2000 grasps failed"),
        ("failed grasps", {"n_failed": 300}, "red", "300 of 2000 grasps failed"),
    ],
)
def test_rules(name, change, tone, words) -> None:
    cards = health_cards(GOOD.model_copy(update=change))
    (card,) = [card for card in cards if card.name == name]
    assert (card.tone, bool(card.next_step)) == (tone, tone != "green")
    assert words in card.sentence
    assert worst_of(cards) == tone
    assert cards[0].tone == tone


def test_what_is_not_known_is_not_said() -> None:
    assert health_cards(HealthFacts(campaign_id="demo")) == ()
    few = GOOD.model_copy(update={"n_tools": 3})
    assert "repeats" not in {card.name for card in health_cards(few)}
