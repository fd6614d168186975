"""`fast compare`: the scientist's strategies side by side, at the same budget, on the same worlds."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

from flows.cli.common import AsJson, show, table_text, tell

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from models.scientist.surrogate.observations import ObservationSet

AT_LEAST_ONE = Number(gte=1)
WIDTH = 100  # columns of text
Rows = list[dict[str, Any]]
_COLUMNS = ("strategy", "last_batch_n", "last_batch_sd_n", "best_n", "final_regret_n", "mean_regret_n",
            "reached_97_percent", "rounds_to_97_percent", "cpu_s")  # fmt: skip


def compare(
    config: Annotated[
        Path | None, Parameter(help="Campaign config: whole campaigns on its virtual bench instead of landscapes.")
    ] = None,
    *,
    races: Annotated[
        int | None,
        Parameter(help="Landscapes (20) or seeds of a config (2).", validator=AT_LEAST_ONE),
    ] = None,
    strategies: Annotated[str | None, Parameter(help="Names separated by `;`; default: the paper's four.")] = None,
    emulate: Annotated[
        Path | None, Parameter(help="Lake whose simulated designs are emulated, instead of synthetic landscapes.")
    ] = None,
    rounds: Annotated[
        int | None, Parameter(help="Rounds of ten measured tools (8) on a landscape.", validator=AT_LEAST_ONE)
    ] = None,
    results: Annotated[
        Path | None, Parameter(help="JSON-lines file of the runs; what is in it is not run again.")
    ] = None,
    lakes: Annotated[
        Path | None,
        Parameter(help="Folder (compare-data) of the lakes of campaigns; may be continued."),
    ] = None,
    figure: Annotated[Path | None, Parameter(help="Picture to draw, e.g. compare.png.")] = None,
    workers: Annotated[
        int | None,
        Parameter(help="Landscapes (2) or campaigns (1) that run side by side.", validator=AT_LEAST_ONE),
    ] = None,
    json: AsJson = False,
) -> None:
    """Compare the scientist's strategies with paired seeds: on landscapes that answer at once, or as whole campaigns.

    Landscapes have the paper's schedule. Campaigns have that of their config, the same number of measured tools for
    each strategy, and the same first designs.
    """
    if config is not None:
        _refuse({"emulate": emulate, "rounds": rounds, "results": results}, "CONFIG")
        _compare_campaigns(config, races or 2, strategies, lakes or Path("compare-data"), workers or 1, figure, json)
        return
    _refuse({"lakes": lakes}, "landscapes")
    data = _simulated(emulate) if emulate else None
    _compare_on_landscapes(races or 20, _names(strategies), data, rounds or 8, results, figure, workers or 2, json)


def _compare_on_landscapes(
    races: int,
    names: list[str],
    data: "ObservationSet | None",
    rounds: int,
    results: Path | None,
    figure: Path | None,
    workers: int,
    json: bool,
) -> None:
    from flows.scientist.landscape_run import RunSchedule
    from flows.scientist.landscape_study import PlannedRun, run_planned
    from flows.scientist.landscape_table import paired_rows, summary_rows
    from flows.scientist.strategies import REFERENCE

    schedule = RunSchedule(rounds=rounds)
    plan = [PlannedRun(name, seed, schedule, data) for seed in range(races) for name in names]
    runs = run_planned(plan, results, workers, tell)
    _show(summary_rows(runs), paired_rows(runs, REFERENCE), _COLUMNS, json)
    if figure is not None:
        from flows.scientist.landscape_table import runs_figure

        _draw(lambda: runs_figure(runs, REFERENCE), figure)


def _compare_campaigns(
    config: Path, seeds: int, strategies: str | None, lakes: Path, workers: int, figure: Path | None, json: bool
) -> None:
    from flows.scientist.campaign_runs import PlannedCampaign, run_campaigns
    from flows.scientist.campaign_table import COLUMNS, campaign_rows, campaigns_figure, paired_campaign_rows
    from flows.scientist.strategies import REFERENCE, STRATEGIES
    from tasks.campaign.config import load_config, relative_to
    from tasks.campaign.setup import read_world

    names = _names(strategies)
    loaded = load_config(config)
    world = read_world(relative_to(config, loaded.bench.world))
    plan = [
        PlannedCampaign(STRATEGIES[name], loaded.seed + seed, loaded, world, lakes)
        for seed in range(seeds)
        for name in names
    ]
    runs = run_campaigns(plan, tell, workers)
    _show(campaign_rows(runs), paired_campaign_rows(runs, REFERENCE), COLUMNS, json, map(asdict, runs))
    if figure is not None:
        _draw(lambda: campaigns_figure(runs, REFERENCE), figure)


def _refuse(options: dict[str, object], beside: str) -> None:
    """Refuse options that do not belong to what is compared.

    Raises:
        UsageError: naming the first of them that was given.
    """
    from models.errors import UsageError

    for name, value in options.items():
        if value is not None:
            raise UsageError(f"--{name} says nothing about {beside}; leave it out.")


def _show(
    summary: Rows, paired: Rows, columns: Sequence[str], as_json: bool, campaigns: Iterable[dict[str, Any]] = ()
) -> None:
    from flows.scientist.strategies import REFERENCE

    table = table_text(summary, list(columns), WIDTH)
    text = f"{table}\n\nagainst `{REFERENCE}` on the same seeds (positive: better)\n\n"
    tables = {"strategies": summary, "paired": paired, "campaigns": list(campaigns)}
    show({name: rows for name, rows in tables.items() if rows}, text + table_text(paired, width=WIDTH), as_json)


def _names(text: str | None) -> list[str]:
    """Names of strategies from `a;b`.

    Raises:
        UsageError: there is no such strategy.
    """
    from flows.scientist.strategies import STRATEGIES
    from models.errors import UsageError
    from models.validation import closest

    if text is None:
        return list(STRATEGIES)
    names = [name.strip() for name in text.split(";")]
    for name in names:
        if name not in STRATEGIES:
            raise UsageError(f"There is no strategy `{name}`; {closest(name, list(STRATEGIES))}")
    return names


def _simulated(lake: Path) -> "ObservationSet":
    """Mean simulated peak of every design that a lake has on as many objects as any other.

    Raises:
        UsageError: no lake, or fewer than 30 such designs.
    """
    import numpy as np

    from lake.store import Lake
    from models.design.space import to_unit
    from models.errors import UsageError
    from models.records import Design
    from models.scientist.surrogate.observations import SIM, ObservationSet

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


def _draw(make: "Callable[[], Figure]", path: Path) -> None:
    from flows.report.style import figure_style

    path.parent.mkdir(parents=True, exist_ok=True)
    with figure_style():
        make().savefig(path, dpi=160)
    tell(f"{path} drawn")
