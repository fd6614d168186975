from fast.flows.challenge.hidden.panel_file import PANEL, read_small
from tests.studies.gap.doubts import Doubted, count_doubts


def test_alarms_are_counted_by_what_is_visible_at_least() -> None:
    seen = [Doubted("single", "edges", visible, 40.0, 1.0, visible > 0.03) for visible in (0.005, 0.015, 0.025, 0.05)]
    rows = count_doubts([Doubted("null", "", 0.0, 3.0, 0.8, is_alarm=False), *seen])
    assert [(row["visible"], row["alarms"], row["of"]) for row in rows] == [
        (0.0, 0, 1),
        (0.01, 1, 3),
        (0.02, 1, 2),
        (0.04, 1, 1),
        (0.1, 0, 0),
    ]


def test_the_panel_for_development_is_whole() -> None:
    panels, bank = read_small(PANEL)
    assert len(panels.bases) == 4
    assert len(panels.grasp_laws) == 16
    assert bank.centre_steps_n.shape == (9, 7, 120)
