"""Labs side by side: what each of them measured of the same fingers on the same objects, from the lake."""

from collections import Counter, defaultdict
from dataclasses import dataclass
from typing import Any

from fast.lake.store import Lake
from fast.models.errors import UsageError
from fast.models.traces.round_robin import Measurement, RoundRobin, compare_labs
from fast.tasks.campaign.state import tuples

NO_NAME = "(no name)"  # of grasps whose lab gave itself none
_GRASPS = f"""
    SELECT coalesce(lab, '{NO_NAME}') AS lab, tool_id, design_id, object_id, setup_id, peak_force_n FROM grasps
    WHERE status = 'ok' AND request_id IS NULL ORDER BY grasp_id
"""
_THETAS = f"""
    SELECT c.calibration_id, c.campaign_id, coalesce(l.labs, '') AS labs,
        young_modulus_q05_mpa, young_modulus_median_mpa, young_modulus_q95_mpa,
        friction_q05, friction_median, friction_q95
    FROM calibrations AS c LEFT JOIN (
        SELECT campaign_id, string_agg(DISTINCT coalesce(lab, '{NO_NAME}'), ', ' ORDER BY coalesce(lab, '{NO_NAME}'))
            AS labs FROM grasps GROUP BY campaign_id
    ) AS l USING (campaign_id)
    WHERE c.status = 'ok'
    QUALIFY row_number() OVER (PARTITION BY c.campaign_id ORDER BY c.sequence DESC, c.created_at DESC) = 1
    ORDER BY c.campaign_id NULLS LAST
"""
_NAMED = """
    SELECT campaign_id, round, coalesce(effect, answer) AS named, probability, closed_fraction FROM gap_findings
    WHERE kind = 'named' AND gap_id IN (
        SELECT gap_id FROM gap_findings QUALIFY row_number() OVER (
            PARTITION BY campaign_id ORDER BY sequence DESC, created_at DESC, gap_id) = 1)
    ORDER BY campaign_id NULLS LAST, round, place
"""


@dataclass(frozen=True)
class LabsSideBySide:
    """What labs measured alike, and what was fitted to each campaign and to all of the lake.

    n_travelled, n_printed: fingers that are one tool in several labs, and designs that each lab printed. n_left_out:
    grasps at other settings. thetas: newest calibration of each campaign. named: what the newest searches named.
    """

    compared: RoundRobin
    n_travelled: int
    n_printed: int
    n_left_out: int
    thetas: tuple[dict[str, Any], ...]
    named: tuple[dict[str, Any], ...]


def read_labs(lake: Lake) -> LabsSideBySide:
    """Compare the labs of a lake, at the grasp setup of most of their grasps.

    Raises:
        UsageError: no two labs measured the same finger on the same object.
    """
    rows = list(tuples(lake, _GRASPS))
    counts = Counter(sorted(row[4] for row in rows))
    usual = counts.most_common(1)[0][0] if rows else ""
    used = [row for row in rows if row[4] == usual]
    labs_of_tool: dict[str, set[str]] = defaultdict(set)
    for lab, tool_id, *_ in used:
        labs_of_tool[tool_id].add(lab)
    travelled = {tool_id for tool_id, labs in labs_of_tool.items() if len(labs) > 1}
    compared = compare_labs(
        Measurement(lab, tool_id if tool_id in travelled else design_id, object_id, force_n)
        for lab, tool_id, design_id, object_id, _, force_n in used
    )
    if compared is None:
        names = sorted({row[0] for row in rows})
        raise UsageError(
            f"the lake {lake.address} has no finger that two labs measured on the same object with the same setup "
            f"(labs with grasps: {', '.join(names) or 'none'}); bring the other lab's data with `fast lake import DIR "
            "--lab NAME`."
        )
    fingers = {finger for finger, _ in compared.means_n}
    return LabsSideBySide(
        compared=compared,
        n_travelled=len(fingers & travelled),
        n_printed=len(fingers - travelled),
        n_left_out=len(rows) - len(used),
        thetas=tuple(lake.query(_THETAS).to_pylist()),
        named=tuple(lake.query(_NAMED).to_pylist()),
    )
