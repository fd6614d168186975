"""How well the object of a grasp is recognised from its force trace, by tools that the classifier has never seen."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fast.models.design.space import PARAMETERS, numbered_design
from fast.models.errors import UsageError
from fast.models.objects.catalogue import OBJECTS, get_object
from tests.studies.benchmarks.base import Options, Rows, Tables, timed
from tests.studies.traces.world_grasps import N_REPEATS, N_TOOLS, bench_world, measure_world, solve_world

if TYPE_CHECKING:
    from fast.models.traces.identification.classifier import Beliefs, Fit

GRASPS_SEEN = ((1, 1), (1, 3), (2, 1), (3, 1), (5, 1), (3, 3))  # tools and repeats of each
TOOLS_LEARNT = (2, 4, 6, 12)
N_CONFUSED = 12
N_PERMUTATIONS = 5000
_PIXELS_PER_INCH = 150


def measure_identification(options: Options) -> Tables:
    """Accuracy on a world's grasps of all objects, unseen tools; --figure draws the confusion matrix."""
    from fast.models.traces.identification.classifier import beliefs_of_unseen
    from fast.models.traces.identification.inputs import INPUTS, inputs_of

    world = bench_world()
    objects = options.objects or tuple(range(len(OBJECTS)))
    grasps = solve_world(world, range(options.designs or N_TOOLS), objects, options)
    measured = measure_world(world, [g for g in grasps if g.tool in _complete_tools(grasps, len(objects))])
    if not measured.traces:
        raise UsageError("no tool has grasped all objects yet; give more time, or --results to continue.")
    inputs, tool, object_id = inputs_of(measured.traces), measured.tool, measured.object_id
    options.tell(f"{len(inputs)} traces of {len(np.unique(tool))} tools")
    beliefs, cpu_s = timed(lambda: beliefs_of_unseen(inputs, object_id, tool))
    if options.figure is not None:
        _draw(options.figure, beliefs, object_id)
    counts = {"tools": len(np.unique(tool)), "objects": len(objects), "repeats": N_REPEATS, "traces": len(inputs)}
    solved_s = sum(grasp.cpu_s for grasp in grasps)
    return {
        "data": [counts | {"solving_cpu_s": solved_s, "learning_cpu_s": cpu_s}],
        "accuracy": _accuracy(beliefs, object_id, tool),
        "classifiers": _classifiers(inputs, object_id, tool, INPUTS, options),
        "tools learnt from": _tools_learnt(inputs, object_id, tool),
        "grasps seen": _grasps_seen(beliefs, object_id, tool),
        "confused most": _confused(beliefs, object_id),
        "sides": _sides(beliefs, object_id),
        "tools": _tools(beliefs, object_id, tool),
        "parameters": _parameters(beliefs, object_id, tool),
    }


def _complete_tools(grasps: Iterable[Any], n_objects: int) -> set[int]:
    tools = [grasp.tool for grasp in grasps]
    return {tool for tool in tools if tools.count(tool) == n_objects}


def _accuracy(beliefs: "Beliefs", object_id: np.ndarray, tool: np.ndarray) -> Rows:
    """Top-1 and top-3 of objects, classes, orientations and sides; chance is that of the most frequent answer."""
    from fast.models.traces.identification.classifier import truth_of
    from tests.studies.traces.recognition import top_share

    rows: Rows = []
    for name, truth in truth_of(object_id).items():
        first, third = (top_share(getattr(beliefs, name), truth, tool, k) for k in (1, 3))
        chance = float(np.bincount(truth).max() / len(truth))
        bounds = {"lower": first.lower, "upper": first.upper}
        rows.append({"of": name, "chance": chance, "top_1": first.mean, **bounds, "top_3": third.mean})
    return rows


def _classifiers(
    inputs: np.ndarray, object_id: np.ndarray, tool: np.ndarray, names: tuple[str, ...], options: Options
) -> Rows:
    """Other classifiers and other inputs, in the same folds."""
    from fast.models.traces.identification.classifier import beliefs_of_unseen, fit_trees
    from fast.models.traces.names import FEATURES
    from tests.studies.traces.recognition import top_share

    in_lift = np.array([not name.startswith("closing_") or name in FEATURES for name in names])
    is_feature = np.array([name in FEATURES for name in names])
    cases: list[tuple[str, str, Fit, np.ndarray]] = [
        ("extremely random trees", "all", fit_trees, inputs),
        ("extremely random trees", "without the closing", fit_trees, inputs[:, in_lift]),
        ("extremely random trees", "features alone", fit_trees, inputs[:, is_feature]),
        ("logistic regression", "all", _fit_logistic, inputs),
        ("gradient boosting", "all", _fit_boosting, inputs),
    ]
    rows: Rows = []
    for classifier, of, fit, chosen in cases:
        found, cpu_s = timed(lambda fit=fit, chosen=chosen: beliefs_of_unseen(chosen, object_id, tool, fit))  # type: ignore[misc]
        first, third = (top_share(found.objects, object_id, tool, k).mean for k in (1, 3))
        rows.append({"classifier": classifier, "inputs": of, "top_1": first, "top_3": third, "cpu_s": cpu_s})
        options.tell(f"{classifier}, {of}: {first:.3f} recognised, {third:.3f} among the first three")
    return rows


def _fit_boosting(inputs: np.ndarray, object_id: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    from sklearn.ensemble import HistGradientBoostingClassifier

    return _fitted(HistGradientBoostingClassifier(max_iter=40, max_leaf_nodes=8, max_features=0.3), inputs, object_id)


def _fit_logistic(inputs: np.ndarray, object_id: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    from sklearn.impute import SimpleImputer
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import FunctionTransformer, StandardScaler

    model = make_pipeline(
        SimpleImputer(keep_empty_features=True),
        FunctionTransformer(np.arcsinh),
        StandardScaler(),
        LogisticRegression(C=0.3, max_iter=1000),
    )
    return _fitted(model, inputs, object_id)


def _fitted(model: Any, inputs: np.ndarray, object_id: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    from fast.models.traces.identification.classifier import Identifier

    identifier = Identifier(model.fit(inputs, object_id))
    return lambda unseen: identifier.beliefs(unseen).objects


def _tools_learnt(inputs: np.ndarray, object_id: np.ndarray, tool: np.ndarray) -> Rows:
    """Top-1 and top-3 of one grasp against the number of tools that the classifier learnt from."""
    from fast.models.traces.identification.classifier import folds_of
    from tests.studies.traces.recognition import beliefs_from_tools, top_share

    most = min(len(np.unique(tool[learnt])) for learnt, _ in folds_of(tool))
    rows: Rows = []
    for n_tools in [n for n in TOOLS_LEARNT if n < most] + [most]:
        beliefs = beliefs_from_tools(inputs, object_id, tool, n_tools)
        first, third = (top_share(beliefs.objects, object_id, tool, k) for k in (1, 3))
        bounds = {"lower": first.lower, "upper": first.upper}
        rows.append({"n_tools": n_tools, "top_1": first.mean, **bounds, "top_3": third.mean})
    return rows


def _grasps_seen(beliefs: "Beliefs", object_id: np.ndarray, tool: np.ndarray) -> Rows:
    from tests.studies.traces.recognition import by_grasps_seen

    n_tools = len(np.unique(tool))
    sizes = [size for size in GRASPS_SEEN if size[0] <= n_tools]
    return [by_grasps_seen(beliefs, object_id, tool, *size)._asdict() for size in sizes]


def _confused(beliefs: "Beliefs", object_id: np.ndarray) -> Rows:
    """The pairs of objects that are most often taken for one another."""
    from tests.studies.traces.recognition import confusion

    counts = confusion(beliefs, object_id)
    both = np.triu(counts + counts.T, 1)
    rows: Rows = []
    for place in np.argsort(both, axis=None)[::-1][:N_CONFUSED]:
        one, other = divmod(int(place), len(OBJECTS))
        if not both[one, other]:
            break
        share = both[one, other] / (counts[one].sum() + counts[other].sum())
        rows.append({"object": get_object(one).name, "taken for": get_object(other).name, "share": float(share)})
    return rows


def _sides(beliefs: "Beliefs", object_id: np.ndarray) -> Rows:
    """Precision and recall of the flags for the four kinds of sides."""
    from fast.models.traces.identification.classifier import SIDES, SIDES_OF_OBJECTS

    found, truth = beliefs.sides.argmax(axis=1), SIDES_OF_OBJECTS[object_id]
    rows: Rows = []
    for number, name in enumerate(SIDES):
        hits = int(((found == number) & (truth == number)).sum())
        rows.append(
            {
                "sides": name,
                "objects": int((SIDES_OF_OBJECTS == number).sum()),
                "precision": hits / max(int((found == number).sum()), 1),
                "recall": hits / max(int((truth == number).sum()), 1),
            }
        )
    return rows


def _shares_of_tools(beliefs: "Beliefs", object_id: np.ndarray, tool: np.ndarray) -> dict[int, float]:
    is_right = beliefs.objects.argmax(axis=1) == object_id
    return {int(one): float(is_right[tool == one].mean()) for one in np.unique(tool)}


def _tools(beliefs: "Beliefs", object_id: np.ndarray, tool: np.ndarray) -> Rows:
    """Tools by how often they recognise the object, with their designs."""
    shares = _shares_of_tools(beliefs, object_id, tool)
    ranked = sorted(shares, key=shares.__getitem__, reverse=True)
    return [{"tool": one, "top_1": shares[one], **_parameters_of(one)} for one in ranked]


def _parameters(beliefs: "Beliefs", object_id: np.ndarray, tool: np.ndarray) -> Rows:
    """Rank correlation of each design parameter with the accuracy of a tool, and its permutation p-value."""
    from scipy.stats import rankdata

    shares = _shares_of_tools(beliefs, object_id, tool)
    ranks = _standardised(rankdata(list(shares.values())))
    rng = np.random.default_rng(0)
    shuffled = np.array([rng.permutation(ranks) for _ in range(N_PERMUTATIONS)])
    rows: Rows = []
    for name in PARAMETERS:
        own = _standardised(rankdata([_parameters_of(one)[name] for one in shares]))
        correlation = float(own @ ranks)
        p = (1 + int((np.abs(shuffled @ own) >= abs(correlation)).sum())) / (1 + N_PERMUTATIONS)
        rows.append({"parameter": name, "rank_correlation": correlation, "p_value": p})
    return sorted(rows, key=lambda row: float(row["p_value"]))


def _parameters_of(number: int) -> dict[str, float]:
    design = numbered_design(number)
    return {name: getattr(design, name) for name in PARAMETERS}


def _standardised(values: np.ndarray) -> np.ndarray:
    """Less their mean, of length 1: products of two are correlations."""
    centred = values - values.mean()
    return np.asarray(centred / max(float(np.linalg.norm(centred)), 1e-12))


def _draw(path: Path, beliefs: "Beliefs", object_id: np.ndarray) -> None:
    """Confusion matrix in shares of the true object, objects in the order of the catalogue."""
    from fast.flows.report.style import figure_style, new_figure
    from tests.studies.traces.recognition import confusion

    counts = confusion(beliefs, object_id)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    names = [f"{obj.name} {obj.object_id}" for obj in OBJECTS]
    path.parent.mkdir(parents=True, exist_ok=True)
    with figure_style():
        figure = new_figure(8.0, 7.2)
        axis = figure.subplots()
        image = axis.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0)
        axis.set_xticks(range(len(OBJECTS)), [str(obj.object_id) for obj in OBJECTS], fontsize=6)
        axis.set_yticks(range(len(OBJECTS)), names, fontsize=6)
        axis.set(xlabel="recognised as", ylabel="object")
        figure.colorbar(image, ax=axis, label="share of the grasps of the object", shrink=0.8)
        figure.savefig(path, dpi=_PIXELS_PER_INCH)
