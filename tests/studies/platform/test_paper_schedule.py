"""The study of the paper's schedule: its config, and how it reckons from samples."""

import pytest

from fast.tasks.campaign.config import load_config
from tests.studies.platform.paper_run import Sample
from tests.studies.platform.paper_schedule import alive_s, eta_ratios, rows_of, tenths, whole, write_config


def sample(part: int, wall_s: float, n_rows: int, left_s: float | None = None, **more: bool) -> Sample:
    return Sample(
        part=part,
        wall_s=wall_s,
        n_grasps=n_rows // 4,
        n_simulations=n_rows - n_rows // 4,
        n_fits=0,
        process_cpu_s=wall_s / 2,
        server_cpu_s=1.0,
        rss_mb=500.0 + n_rows / 10,
        left_s=left_s,
        **more,
    )


@pytest.fixture
def samples() -> list[Sample]:
    """Ten rows a second, killed once after 500 of 1,000 rows, and 10 s to start again."""
    first = [sample(0, float(s), 10 * s, 120.0 - s) for s in range(1, 51)]
    second = [sample(1, 10.0 + s, 500 + 10 * s, 55.0 - s) for s in range(1, 51)]
    return [*first, *second, sample(1, 65.0, 1000, 0.0, is_reporting=True, is_end=True)]


def test_it_has_the_whole_schedule_and_nothing_that_needs_physics(tmp_path):
    config = load_config(write_config(tmp_path))
    assert rows_of(config) == (11_880, 34_560)
    assert not config.gap.active
    assert not config.night.active
    assert (tmp_path / "world.toml").exists()


def test_time_between_parts_does_not_count(samples):
    assert alive_s(samples)[49:51] == [50.0, 61.0]
    assert alive_s(samples)[-1] == 115.0


def test_time_left_is_compared_with_the_time_until_the_report(samples):
    ratios = eta_ratios(samples)
    assert ratios[5] is None  # the first tenth
    assert ratios[49] == pytest.approx(70.0 / 65.0)
    assert ratios[50] == pytest.approx(54.0 / 54.0)


def test_cost_by_tenth_and_in_all(samples):
    found = tenths(samples)
    assert [row["tenth"] for row in found] == list(range(1, 11))
    assert [row["cpu_ms_per_row"] for row in found] == pytest.approx([50.0] * 10)
    of_all = whole(samples)
    assert (of_all["parts"], of_all["grasps"] + of_all["simulations"]) == (2, 1000)
    assert of_all["largest_rss_mb"] == 600.0
    assert of_all["process_cpu_min"] == pytest.approx((25.0 + 32.5) / 60)
