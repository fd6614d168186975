"""First rows of the challenge: methods that answer the same worlds, each from their folders alone.

Worlds are made of the public panel from a public seed, so that anybody can repeat the table. `--results FOLDER/x.jsonl`
keeps worlds and answers in the folder, and goes on from there.
"""

import csv
import json
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fast.flows.challenge.answers import LIFT_MM
from fast.flows.challenge.grade import grade_answers, make_tables
from fast.flows.challenge.make import make_challenge
from fast.flows.challenge.manifest import Manifest
from fast.flows.challenge.world_folder import GivenWorld, read_world
from tests.studies.benchmarks.base import Options, Rows, Tables
from tests.studies.challenge.entrants import learned
from tests.studies.challenge.entrants.common import Fitted, Line, Opinion, draw_lines
from tests.studies.challenge.entrants.evidence import Evidence
from tests.studies.challenge.entrants.lisdd import answer_lisdd

SEED = "first rows of the challenge"
N_WORLDS = 60
COLUMNS = {
    "false alarms where nothing is hidden": "false alarms",
    "alarm, a listed cause of 2 % or more": "alarm, listed, 2 %",
    "alarm, a cause that is not listed of 2 % or more": "alarm, not listed, 2 %",
    "“nothing” said at 4 % or more": "“nothing” at 4 %",
    "“nothing” said at 10 % or more": "“nothing” at 10 %",
    "family right, given an alarm": "family right",
    "wrong family for a cause that is not listed": "wrong family",
    "Brier score of the stated probability": "Brier score",
    "gap closed of what can be closed, median": "gap closed",
    "CPU seconds a world": "CPU s",
}

Method = Callable[[Fitted], Opinion]
Foretell = Callable[[Fitted], np.ndarray]
LEARNED: Mapping[str, tuple[Callable[[Fitted], float], Foretell]] = {
    "Gaussian-process discrepancy": (learned.weigh_process, learned.foretell_process),
    "boosted trees": (learned.score_trees, learned.foretell_trees),
    "PySINDy on what is left": (learned.score_sparse, learned.foretell_sparse),
}


def measure_challenge(options: Options) -> Tables:
    """How methods fare in the challenge: FAST's evidence, a Gaussian process, trees, PySINDy, LISDD, always none."""
    with TemporaryDirectory() as temporary:
        root = Path(temporary) if options.results is None else options.results.parent
        folder = root / "worlds"
        if not folder.exists():
            make_challenge(SEED, folder, options.worlds or N_WORLDS, progress=options.tell)
        paths = answer_worlds(folder, root, options.tell)
        graded = {name: make_tables(grade_answers(path, folder)[1]) for name, path in paths.items()}
    rows = [_summarise(name, tables["figures"]) for name, tables in graded.items()]
    figures = [{"entrant": name} | row for name, tables in graded.items() for row in tables["figures"]]
    if options.figure is not None:
        draw_rows(figures, options.figure)
    return {"entrants": rows, "figures": figures}


def answer_worlds(folder: Path, root: Path, tell: Callable[[str], None]) -> dict[str, Path]:
    """Let every method answer every world; returns the files of answers by entrant."""
    manifest = Manifest.read(folder)
    methods = _prepare(read_world(folder, next(iter(manifest.worlds))), tell)
    answers: dict[str, list[dict[str, object]]] = {name: [] for name in methods}
    forces: dict[str, list[tuple[object, ...]]] = {name: [] for name in methods}
    for world_name in manifest.worlds:
        world = read_world(folder, world_name)
        started = time.process_time()
        fitted = Fitted.of(world)
        shared_s = time.process_time() - started
        for name, method in methods.items():
            started = time.process_time()
            said = method(fitted)
            cpu_s = shared_s + time.process_time() - started
            answers[name].append(_tell_answer(world_name, said, cpu_s))
            forces[name] += _list_forces(world_name, world, said.forces_n)
        tell(f"{world_name} answered")
    paths = {}
    for name in methods:
        stem = name.replace(" ", "-").replace("'", "").lower()
        paths[name] = root / f"{stem}.json"
        with (root / f"{stem}.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(("world", "grasp_id", "lift_mm", "force_n"))
            writer.writerows(forces[name])
        content = {"entrant": name, "challenge": manifest.challenge, "forces": f"{stem}.csv", "answers": answers[name]}
        paths[name].write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    return paths


def _prepare(first: GivenWorld, tell: Callable[[str], None]) -> dict[str, Method]:
    """The methods, those that need lines with lines of the first world's panel."""
    lines = draw_lines(first, [score for score, _ in LEARNED.values()])
    tell(f"lines of {len(lines)} scores: {', '.join(f'{line.score:.3g}' for line in lines)}")
    evidence = Evidence.rehearse(first)
    least = evidence.rehearsal.thresholds
    tell(f"lines of the evidence: {least.nats:.0f} nats, {least.omnibus:.2f}")
    methods: dict[str, Method] = {"FAST's evidence": evidence.answer, "LISDD": answer_lisdd}
    for (name, (score, foretell)), line in zip(LEARNED.items(), lines, strict=True):
        methods[name] = _judge_by(score, foretell, line)
    return methods | {"always none": lambda fitted: Opinion(False, 0.5, fitted.foretell_with())}


def _judge_by(score: Callable[[Fitted], float], foretell: Foretell, line: Line) -> Method:
    def answer(fitted: Fitted) -> Opinion:
        missing, probability = line.judge(score(fitted))
        return Opinion(missing, probability, fitted.foretell(foretell(fitted) if missing else 0.0))

    return answer


def _tell_answer(world: str, said: Opinion, cpu_s: float) -> dict[str, object]:
    return {
        "world": world,
        "missing": bool(said.missing),
        "probability": round(said.probability, 4),
        "effect": said.effect,
        "cpu_s": round(cpu_s, 3),
    }


def _list_forces(name: str, world: GivenWorld, forces_n: np.ndarray) -> list[tuple[object, ...]]:
    return [
        (name, grasp_id, lift_mm, round(force_n, 3))
        for grasp_id, row in zip(world.asked.grasp_ids, forces_n.tolist(), strict=True)
        for lift_mm, force_n in zip(LIFT_MM.tolist(), row, strict=True)
    ]


def _summarise(name: str, figures: Sequence[Mapping[str, object]]) -> dict[str, object]:
    """A row of the table: counts as k of n, other figures with their intervals."""
    row: dict[str, object] = {"entrant": name}
    for figure in figures:
        if (column := COLUMNS.get(str(figure["figure"]))) is not None:
            row[column] = _tell_figure(figure)
    return row


def _tell_figure(figure: Mapping[str, object]) -> str:
    if figure["value"] is None:
        return "-"
    if "seen" in figure:
        return f"{figure['seen']} of {figure['worlds']}"
    return f"{figure['value']} [{figure['low95']}, {figure['high95']}]"


def draw_rows(figures: Rows, path: Path) -> None:
    """Draw alarms and false alarms of every entrant, with their intervals."""
    from matplotlib.figure import Figure

    shown = list(COLUMNS)[:3]
    entrants = list(dict.fromkeys(str(row["entrant"]) for row in figures))
    drawing = Figure(figsize=(8.0, 0.4 * len(entrants) + 1.2), layout="constrained")
    axes = drawing.subplots(1, len(shown), sharey=True)
    titles = (
        "nothing is hidden\n(left is good)",
        "a listed cause, 2 % or more\n(right is good)",
        "another cause, 2 % or more\n(right is good)",
    )
    for ax, name, title in zip(axes, shown, titles, strict=True):
        for place, entrant in enumerate(entrants):
            row = next(one for one in figures if one["entrant"] == entrant and one["figure"] == name)
            if row["value"] is not None:
                ax.plot([row["low95"], row["high95"]], [place, place], color="0.6", lw=3, solid_capstyle="butt")
                ax.plot(row["value"], place, "o", color="tab:blue")
        ax.set(title=title, xlim=(-0.03, 1.03))
        ax.title.set_fontsize(9)
        ax.grid(axis="x", alpha=0.3)
    axes[0].set_yticks(range(len(entrants)), entrants)
    axes[0].invert_yaxis()
    drawing.supxlabel("share of worlds with an alarm; bars: 95 % intervals", fontsize=9)
    drawing.savefig(path, dpi=150)
