import dataclasses

import numpy as np
import pytest

from fast.flows.report.campaign.facts import (
    Tool,
    average_objects,
    choose_versions,
    count_objects_won,
    find_best_tool,
    find_first_batch,
    measure_agreement,
)
from fast.flows.report.campaign.reference import compare_with_reference
from fast.models.traces.quality import ratio_of_means

TOOL = Tool(
    label="B01T0", batch=1, slot=0, kind="random", tool_id="x/B01T0", design_id="D", status="printed", reason="",
    quality_n=10.0, half_width_n=0.1, work_j=0.2, n_objects=36, n_grasps=108, n_failed=0, is_complete=True,
)  # fmt: skip


def tool(label: str, quality_n: float, **changes) -> Tool:
    changes = {"batch": int(label[1:3]), "slot": int(label[4]), "label": label, "quality_n": quality_n, **changes}
    return dataclasses.replace(TOOL, **changes)


def test_best_tool_must_be_measured_on_every_object():
    tools = [tool("B01T0", 10), tool("B01T1", 50, is_complete=False, n_objects=3), tool("B02T0", 12, kind="guided")]
    assert find_best_tool(tools).label == "B02T0"
    assert find_best_tool([tools[1]]) is None


def test_first_batch_is_the_first_random_one():
    tools = [tool("B03T0", 9), tool("B02T0", 8), tool("B01T0", 7, kind="guided"), tool("B02T1", 6, is_complete=False)]
    assert [t.label for t in find_first_batch(tools)] == ["B02T0"]
    assert find_first_batch([]) == []


def test_a_reference_finger_is_no_tool_of_the_campaign():
    reference = tool("B01T0", 30.0, half_width_n=0.6, reference="fin-ray")
    others = [tool("B01T1", 9), tool("B02T0", 54.0, kind="guided", half_width_n=0.9)]
    tools = [reference, *others]
    assert find_best_tool(tools).label == "B02T0"
    assert [t.label for t in find_first_batch(tools)] == ["B01T1"]
    assert find_best_tool([reference]) is reference
    found = compare_with_reference(tools, find_best_tool(tools))
    assert found.times == "1.80 times the reference finger [1.75, 1.85]"
    assert found.ratio == ratio_of_means(54.0, 0.9, 30.0, 0.6)
    assert "The reference finger is fin-ray (B01T0, 30.0\N{NO-BREAK SPACE}N)" in found.sentence


def test_two_prints_of_the_reference_count_by_their_mean():
    prints = [tool("B01T0", 28.0, half_width_n=0.6, reference="fin-ray"),
              tool("B02T0", 32.0, half_width_n=0.8, reference="fin-ray")]  # fmt: skip
    found = compare_with_reference(prints, tool("B02T1", 60.0, half_width_n=1.0))
    assert found.ratio == ratio_of_means(60.0, 1.0, 30.0, 0.5)


def test_without_repeats_the_ratio_has_no_interval():
    best = tool("B02T0", 20.0, half_width_n=None)
    found = compare_with_reference([best, tool("B01T0", 10.0, half_width_n=None, reference="fin-ray")], best)
    assert found.times == "2.00 times the reference finger"
    assert "its interval is not known: it needs repeats of both tools" in found.sentence
    assert compare_with_reference([best], best) is None
    assert compare_with_reference([best, tool("B01T0", 10.0, is_complete=False, reference="fin-ray")], best) is None


def test_objects_won_counts_only_shared_objects():
    peaks = {(2, 0): {0: 5.0, 1: 1.0, 2: 9.0}, (1, 0): {0: 4.0, 1: 2.0}, (1, 1): {0: 3.0, 1: 4.0, 2: 1.0}}
    rows = [
        {"batch": b, "slot": s, "object_id": o, "peak_force_n": n}
        for (b, s), by in peaks.items()
        for o, n in by.items()
    ]
    assert count_objects_won(rows, tool("B02T0", 5), [tool("B01T0", 3), tool("B01T1", 3)]) == (1, 2)


def test_agreement_of_known_numbers():
    pairs = [{"simulated_n": s, "measured_n": m} for s, m in ((1.0, 2.0), (2.0, 4.0), (3.0, 9.0))]
    found = measure_agreement(pairs)
    assert found.bias_n == pytest.approx(-3.0)
    assert found.rmse_n == pytest.approx(np.sqrt((1 + 4 + 36) / 3))
    assert found.pearson == pytest.approx(np.corrcoef([1, 2, 3], [2, 4, 9])[0, 1])
    assert found.spearman == pytest.approx(1.0)
    assert np.isnan(measure_agreement(pairs[:2]).pearson)


def test_design_pairs_average_over_objects():
    forces = ((1, 0, 1, 3), (1, 0, 3, 5), (2, 0, 7, 8))
    found = average_objects([dict(zip(("batch", "slot", "simulated_n", "measured_n"), f, strict=True)) for f in forces])
    assert found == [
        {"batch": 1, "simulated_n": 2, "measured_n": 4},
        {"batch": 2, "simulated_n": 7, "measured_n": 8},
    ]


def test_only_production_versions_are_compared_where_there_are_any():
    rows = [{"version_id": v, "tier": t} for v, t in (("s", "screening"), ("a", "production"), ("b", "production"))]
    assert choose_versions(rows, ["s", "a", "b"]) == ["a", "b"]
    assert choose_versions(rows[:1], ["s", "a", "b"]) == ["s"]
    assert choose_versions([*rows, {"version_id": "c", "tier": "production"}], ["s", "a", "b", "c"]) == ["a", "c"]
    assert choose_versions([], ["a"]) == []


def test_the_version_in_use_is_compared_with_the_oldest():
    rows = [{"version_id": v, "tier": "production"} for v in "abc"]
    assert choose_versions(rows, ["a", "b", "c"], in_use="b") == ["a", "b"]
    assert choose_versions(rows, ["a", "b", "c"], in_use="a") == ["a"]
    assert choose_versions(rows, ["a", "b", "c"], in_use="d") == ["a", "c"]
