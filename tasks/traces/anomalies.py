"""Flags on the lake's grasps that went wrong: found anew from the stored features, kept where they changed."""

from typing import Any

import numpy as np
import pyarrow as pa

from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import AnomalyFlagRow
from fast.models.traces.anomalies import TURNED, Labels, find_anomalies
from fast.models.traces.batch import TraceFeatures, features_of_samples
from fast.models.traces.flags import Anomaly
from fast.models.traces.names import FEATURES, N_PROFILE

_FEATURES = f"""
    SELECT f.grasp_id, f.campaign_id, f.setup_id, f.tool_id, f.design_id, f.object_id, o.orientation, profile_n,
        {", ".join(FEATURES)}
    FROM feature_summary AS f LEFT JOIN objects AS o USING (object_id)
    WHERE $campaign IS NULL OR f.campaign_id = $campaign
    ORDER BY ALL
"""
# The newest simulation of each design on each object, by whichever version: what is wrong everywhere cancels out.
_SIMULATED = """
    SELECT s.design_id, s.object_id, arg_max(t.lift_mm, s.sequence) AS lift_mm,
        arg_max(t.force_n, s.sequence) AS force_n
    FROM simulations AS s JOIN sim_traces AS t USING (simulation_id)
    WHERE s.status = 'ok' AND s.setup_id = $setup AND s.design_id IN (SELECT unnest($designs)) GROUP BY ALL
"""
_FLAGS = "SELECT f.* FROM anomaly_flags AS f JOIN feature_summary AS g USING (grasp_id) WHERE f.is_flagged"
_SHOWN = "SELECT * FROM anomalies WHERE $campaign IS NULL OR campaign_id = $campaign ORDER BY p_value, grasp_id, kind"


def update_anomalies(lake: Lake, campaign_id: str | None = None) -> list[dict[str, Any]]:
    """Look at all grasps with features of a campaign or the whole lake; rows of the view `anomalies`, surest first.

    Grasps are compared with those of their own campaign and setup. Only flags that are new, changed or no longer stand
    are written.
    """
    grasps = lake.query(_FEATURES, {"campaign": campaign_id})
    found: dict[str, AnomalyFlagRow] = {}
    for group in _groups(grasps):
        ids = group["grasp_id"].to_pylist()
        rows = [AnomalyFlagRow.of(ids[anomaly.place], anomaly) for anomaly in _found(lake, group)]
        found |= {row.flag_id: row for row in rows}
    looked_at = set(grasps["grasp_id"].to_pylist())
    known = {row["flag_id"]: row for row in lake.query(_FLAGS).to_pylist() if row["grasp_id"] in looked_at}
    gone = [AnomalyFlagRow.taken_back(row["grasp_id"], row["kind"]) for key, row in known.items() if key not in found]
    new = [row for key, row in found.items() if key not in known or not _is_same(row, known[key])]
    if new or gone:
        lake.append([*new, *gone], current_provenance())
    return lake.query(_SHOWN, {"campaign": campaign_id}).to_pylist()


def _groups(grasps: pa.Table) -> list[pa.Table]:
    """Group grasps by campaign and setup."""
    keys = list(zip(grasps["campaign_id"].to_pylist(), grasps["setup_id"].to_pylist(), strict=True))
    places: dict[tuple[str, str], list[int]] = {}
    for place, key in enumerate(keys):
        places.setdefault(key, []).append(place)
    return [grasps.take(chosen) for chosen in places.values()]


def _found(lake: Lake, grasps: pa.Table) -> list[Anomaly]:
    values = [grasps[name].to_numpy(zero_copy_only=False).astype(float) for name in FEATURES]
    features = TraceFeatures(np.column_stack(values), np.array(grasps["profile_n"].to_pylist(), dtype=float))
    numbers = np.unique(grasps["tool_id"].to_pylist(), return_inverse=True)[1]
    is_turned = np.array([orientation == TURNED for orientation in grasps["orientation"].to_pylist()])
    labels = Labels(numbers, grasps["object_id"].to_numpy(), is_turned)
    return find_anomalies(features, labels, _simulated(lake, grasps))


def _simulated(lake: Lake, grasps: pa.Table) -> TraceFeatures:
    """Return features of what the lake simulated of each grasp's design on its object; NaN where nothing is."""
    cells = list(zip(grasps["design_id"].to_pylist(), grasps["object_id"].to_pylist(), strict=True))
    known = {"setup": grasps["setup_id"][0].as_py(), "designs": sorted({design_id for design_id, _ in cells})}
    found = lake.query(_SIMULATED, known).to_pylist()
    values, profile_n = np.full((len(cells), len(FEATURES)), np.nan), np.zeros((len(cells), N_PROFILE))
    if found:
        lifts, forces = ([np.array(row[name], dtype=float) for row in found] for name in ("lift_mm", "force_n"))
        offsets = np.cumsum([0, *map(len, lifts)])
        features = features_of_samples(np.concatenate(lifts), np.concatenate(forces), offsets)
        place = {(row["design_id"], row["object_id"]): number for number, row in enumerate(found)}
        rows = [number for number, cell in enumerate(cells) if cell in place]
        of = [place[cells[number]] for number in rows]
        values[rows], profile_n[rows] = features.values[of], features.profile_n[of]
    return TraceFeatures(values, profile_n)


def _is_same(row: AnomalyFlagRow, stored: dict[str, Any]) -> bool:
    return all(stored[name] == getattr(row, name) for name in ("p_value", "compared", "shortfall", "reason"))
