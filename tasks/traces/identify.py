"""Which object a grasp of the lake was of, told from its trace by what other tools' grasps look like."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from fast.lake.store import Lake
from fast.models.errors import UsageError
from fast.models.ids import seed_from
from fast.models.objects.catalogue import FIRST_OWN_ID, OBJECTS, get_object
from fast.models.records import Trace
from fast.models.traces.identification.classifier import (
    CLASSES,
    MEANINGS,
    N_FOLDS,
    ORIENTATIONS,
    SIDES,
    Beliefs,
    beliefs_of_unseen,
    rank_of_truth,
    train,
)
from fast.models.traces.identification.inputs import inputs_of

MOST_GRASPS = 5000  # to learn from: 140 of each object
N_SHOWN = 3
_OWN = "own object"

_GRASP = """
    SELECT s.grasp_id, s.tool_id, s.object_id, s.object_name, s.setup_id, s.is_valid, f.feature_id IS NOT NULL AS lifts
    FROM grasp_summary AS s LEFT JOIN trace_features AS f USING (grasp_id) WHERE s.grasp_id = $grasp
"""
_KNOWN = "SELECT grasp_id, tool_id, object_id FROM feature_summary WHERE setup_id = $setup ORDER BY grasp_id"
_SAMPLES = """
    SELECT grasp_id, time_s, lift_mm, force_n FROM grasp_traces
    WHERE grasp_id IN (SELECT unnest($ids)) ORDER BY grasp_id
"""


class Likeliest(NamedTuple):
    """What is believed of the object, most probable first; `n_grasps` of it were looked at together."""

    n_grasps: int
    objects: list[tuple[str, float]]
    classes: list[tuple[str, float]]
    orientations: list[tuple[str, float]]
    sides: list[tuple[str, float]]


class Identification(NamedTuple):
    """Answers from one grasp and from all repeats of its tool on its object, and what they were learnt from.

    `recorded` is the object that the lake says it was. `accuracy` is the share of the other tools' grasps whose object
    was recognised without their own tool, None with a single other tool.
    """

    grasp_id: str
    recorded: str
    n_tools: int
    n_learnt: int
    accuracy: float | None
    alone: Likeliest
    together: Likeliest


def identify(lake: Lake, grasp_id: str) -> Identification:
    """Identify the object of a grasp with features, learning from the grasps of all other tools with the same setup.

    Raises:
        UsageError: there is no such grasp, it has no features, or other tools met fewer than two objects.
    """
    grasp = _grasp(lake, grasp_id)
    known = lake.query(_KNOWN, {"setup": grasp["setup_id"]}).to_pylist()
    others = _chosen([row for row in known if row["tool_id"] != grasp["tool_id"]], grasp_id)
    if len({row["object_id"] for row in others}) < 2:
        raise UsageError(
            f"other tools than {grasp['tool_id']} have grasped fewer than 2 objects with features, and nothing can be "
            "told apart from them; measure more tools, then `fast features`."
        )
    same = [row for row in known if (row["tool_id"], row["object_id"]) == (grasp["tool_id"], grasp["object_id"])]
    own = sorted({row["object_id"] for row in others if row["object_id"] >= FIRST_OWN_ID})
    column = {object_id: len(OBJECTS) + place for place, object_id in enumerate(own)}
    inputs, object_id = _inputs(lake, others), np.array([column.get(r["object_id"], r["object_id"]) for r in others])
    tool = np.unique([row["tool_id"] for row in others], return_inverse=True)[1]
    beliefs = train(inputs, object_id).beliefs(_inputs(lake, same))
    place = [row["grasp_id"] for row in same].index(grasp_id)
    return Identification(
        grasp_id,
        grasp["object_name"],
        len(np.unique(tool)),
        len(others),
        _accuracy(inputs, object_id, tool),
        _find_likeliest(Beliefs(beliefs.objects[[place]]), 1, own),
        _find_likeliest(beliefs.combined(), len(same), own),
    )


def _grasp(lake: Lake, grasp_id: str) -> dict[str, Any]:
    found: list[dict[str, Any]] = lake.query(_GRASP, {"grasp": grasp_id}).to_pylist()
    if not found:
        raise UsageError(f"grasp `{grasp_id}` is not in this lake; list them with `fast sql 'FROM grasp_summary'`.")
    if not found[0]["is_valid"] or not found[0]["lifts"]:
        raise UsageError(f"grasp `{grasp_id}` has no features: it failed, was superseded or lifts less than 3 mm.")
    return found[0]


def _chosen(rows: list[dict[str, Any]], grasp_id: str) -> list[dict[str, Any]]:
    """Choose at most `MOST_GRASPS` of the rows, in order."""
    if len(rows) <= MOST_GRASPS:
        return rows
    rng = np.random.default_rng(seed_from(0, "identify", grasp_id))
    return [rows[place] for place in np.sort(rng.choice(len(rows), MOST_GRASPS, replace=False))]


def _inputs(lake: Lake, rows: list[dict[str, Any]]) -> np.ndarray:
    """Return inputs of the classifier for the grasps of these rows, which are in the order of their ids."""
    samples = lake.query(_SAMPLES, {"ids": [row["grasp_id"] for row in rows]}).to_pylist()
    return inputs_of([Trace(*(np.array(s[name]) for name in ("time_s", "lift_mm", "force_n"))) for s in samples])


def _accuracy(inputs: np.ndarray, object_id: np.ndarray, tool: np.ndarray) -> float | None:
    if len(np.unique(tool)) < 2:
        return None
    beliefs = beliefs_of_unseen(inputs, object_id, tool, n_folds=N_FOLDS)
    return float((rank_of_truth(beliefs.objects, object_id) == 1).mean())


def _find_likeliest(beliefs: Beliefs, n_grasps: int, own: Sequence[int]) -> Likeliest:
    sides = [f"{name}: {MEANINGS[name]}" for name in SIDES]
    names = [obj.name for obj in (*OBJECTS, *map(get_object, own))]
    return Likeliest(
        n_grasps,
        _best(beliefs.objects[0], names),
        _best(beliefs.classes[0], (*CLASSES, _OWN)),
        _best(beliefs.orientations[0], (*ORIENTATIONS, _OWN)),
        _best(beliefs.sides[0], (*sides, _OWN)),
    )


def _best(probabilities: np.ndarray, names: Any) -> list[tuple[str, float]]:
    order = np.argsort(-probabilities, kind="stable")[:N_SHOWN]
    return [(names[place], round(float(probabilities[place]), 4)) for place in order if probabilities[place] > 0]
