"""Flags on the lake's grasps that went wrong: found anew from the stored features, kept where they changed."""

from typing import Any

import numpy as np
import pyarrow as pa

from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import AnomalyFlagRow
from fast.models.traces.anomalies import TURNED, Labels, find_anomalies
from fast.models.traces.batch import TraceFeatures
from fast.models.traces.flags import Anomaly
from fast.models.traces.names import FEATURES

_FEATURES = f"""
    SELECT f.grasp_id, f.campaign_id, f.setup_id, f.tool_id, f.object_id, o.orientation, profile_n,
        {", ".join(FEATURES)}
    FROM feature_summary AS f LEFT JOIN objects AS o USING (object_id)
    WHERE $campaign IS NULL OR f.campaign_id = $campaign
    ORDER BY ALL
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
        rows = [AnomalyFlagRow.of(ids[anomaly.place], anomaly) for anomaly in _found(group)]
        found |= {row.flag_id: row for row in rows}
    looked_at = set(grasps["grasp_id"].to_pylist())
    known = {row["flag_id"]: row for row in lake.query(_FLAGS).to_pylist() if row["grasp_id"] in looked_at}
    gone = [AnomalyFlagRow.taken_back(row["grasp_id"], row["kind"]) for key, row in known.items() if key not in found]
    new = [row for key, row in found.items() if key not in known or not _is_same(row, known[key])]
    if new or gone:
        lake.append([*new, *gone], current_provenance())
    return lake.query(_SHOWN, {"campaign": campaign_id}).to_pylist()


def _groups(grasps: pa.Table) -> list[pa.Table]:
    """Grasps of each campaign and setup."""
    keys = list(zip(grasps["campaign_id"].to_pylist(), grasps["setup_id"].to_pylist(), strict=True))
    places: dict[tuple[str, str], list[int]] = {}
    for place, key in enumerate(keys):
        places.setdefault(key, []).append(place)
    return [grasps.take(chosen) for chosen in places.values()]


def _found(grasps: pa.Table) -> list[Anomaly]:
    values = [grasps[name].to_numpy(zero_copy_only=False).astype(float) for name in FEATURES]
    features = TraceFeatures(np.column_stack(values), np.array(grasps["profile_n"].to_pylist(), dtype=float))
    numbers = np.unique(grasps["tool_id"].to_pylist(), return_inverse=True)[1]
    is_turned = np.array([orientation == TURNED for orientation in grasps["orientation"].to_pylist()])
    return find_anomalies(features, Labels(numbers, grasps["object_id"].to_numpy(), is_turned))


def _is_same(row: AnomalyFlagRow, stored: dict[str, Any]) -> bool:
    return all(stored[name] == getattr(row, name) for name in ("p_value", "compared", "shortfall", "reason"))
