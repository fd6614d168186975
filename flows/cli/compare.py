"""`fast compare`: the scientist's strategies side by side, at the same budget, on the same worlds."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from flows.cli.common import AsJson, show, table_text, tell

if TYPE_CHECKING:
    from flows.compare.race import Course
    from models.surrogate.observations import ObservationSet

AT_LEAST_ONE = Number(gte=1)
_COLUMNS = ("strategy", "last_batch_n", "last_batch_sd_n", "best_n", "final_regret_n", "mean_regret_n",
            "reached_97_percent", "rounds_to_97_percent", "cpu_s")  # fmt: skip


def compare(
    *,
    races: Annotated[int, Parameter(help="How many landscapes, one seed each.", validator=AT_LEAST_ONE)] = 20,
    strategies: Annotated[str | None, Parameter(help="Names separated by `;`; default: all.")] = None,
    emulate: Annotated[
        Path | None, Parameter(help="Lake whose simulated designs are emulated, instead of synthetic landscapes.")
    ] = None,
    rounds: Annotated[int, Parameter(help="Rounds of ten measured tools.", validator=AT_LEAST_ONE)] = 8,
    results: Annotated[
        Path | None, Parameter(help="JSON-lines file of the races; what is in it is not run again.")
    ] = None,
    figure: Annotated[Path | None, Parameter(help="Picture to draw, e.g. compare.png.")] = None,
    workers: Annotated[int, Parameter(help="Worker processes.", validator=AT_LEAST_ONE)] = 2,
    json: AsJson = False,
) -> None:
    """Race the scientist's strategies on worlds that answer at once, with the paper's schedule and paired seeds."""
    from flows.compare.race import RaceSchedule
    from flows.compare.strategies import REFERENCE
    from flows.compare.study import Entry, run_study
    from flows.compare.verdict import paired_rows, summary_rows

    names = _names(strategies)
    data = _simulated(emulate) if emulate else None
    schedule = RaceSchedule(rounds=rounds)
    entries = [Entry(name, seed, schedule, data) for seed in range(races) for name in names]
    courses = run_study(entries, results, workers, tell)
    summary, paired = summary_rows(courses), paired_rows(courses, REFERENCE)
    text = f"{table_text(summary, list(_COLUMNS))}\n\nagainst `{REFERENCE}` on the same seeds (positive: better)\n\n"
    show({"strategies": summary, "paired": paired}, text + table_text(paired), json)
    if figure is not None:
        _draw(courses, figure)


def _names(text: str | None) -> list[str]:
    """Names of strategies from `a;b`.

    Raises:
        UsageError: there is no such strategy.
    """
    from flows.compare.strategies import STRATEGIES, STRATEGY_BY_NAME
    from models.errors import UsageError
    from models.validation import closest

    if text is None:
        return [strategy.name for strategy in STRATEGIES]
    names = [name.strip() for name in text.split(";")]
    for name in names:
        if name not in STRATEGY_BY_NAME:
            raise UsageError(f"There is no strategy `{name}`; {closest(name, list(STRATEGY_BY_NAME))}")
    return names


def _simulated(lake: Path) -> "ObservationSet":
    """Mean simulated peak of every design that a lake has on as many objects as any other.

    Raises:
        UsageError: no lake, or fewer than 30 such designs.
    """
    import numpy as np

    from lake.store import Lake
    from models.design_space import to_unit
    from models.errors import UsageError
    from models.records import Design
    from models.surrogate.observations import SIM, ObservationSet

    sql = """
        WITH means AS (
            SELECT design_id, version_id, setup_id, avg(peak_force_n) AS mean_n, count(*) AS n_objects
            FROM simulations WHERE status = 'ok' GROUP BY ALL
        ), wanted AS (SELECT version_id, setup_id, n_objects FROM means GROUP BY ALL ORDER BY count(*) DESC LIMIT 1)
        SELECT d.* EXCLUDE (design_id), mean_n
        FROM means SEMI JOIN wanted USING (version_id, setup_id, n_objects) JOIN designs AS d USING (design_id)"""
    rows = Lake.open(lake).query(sql).to_pylist()
    least = 30
    if len(rows) < least:
        raise UsageError(f"{lake} has {len(rows)} completely simulated designs, {least} are needed; simulate more.")
    names = Design.model_fields
    x = to_unit([Design(**{name: row[name] for name in names}) for row in rows])
    y = np.array([row["mean_n"] for row in rows])
    return ObservationSet(x, np.full(len(y), SIM), y, np.zeros(len(y)))


def _draw(courses: "list[Course]", path: Path) -> None:
    from flows.compare.figure import races_figure
    from flows.compare.strategies import REFERENCE
    from flows.report.style import figure_style

    path.parent.mkdir(parents=True, exist_ok=True)
    with figure_style():
        races_figure(courses, REFERENCE).savefig(path, dpi=160)
    tell(f"{path} drawn")
