"""`fast compare`: the scientist's strategies side by side, at the same budget, on the same worlds."""

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

from fast.flows.cli.common import AsJson, show, table_text, tell

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AT_LEAST_ONE = Number(gte=1)
BANK = Path(__file__).resolve().parents[2] / "docs" / "benchmarks" / "landscapes.json"
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
        Parameter(help="Seeds: of each landscape (20) or of a config (2).", validator=AT_LEAST_ONE),
    ] = None,
    strategies: Annotated[str | None, Parameter(help="Names separated by `;`; default: all.")] = None,
    bank: Annotated[
        Path | None, Parameter(help="Stored designs that landscapes are made of (docs/benchmarks/landscapes.json).")
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
        _refuse({"bank": bank, "rounds": rounds, "results": results}, "CONFIG")
        _compare_campaigns(config, races or 2, strategies, lakes or Path("compare-data"), workers or 1, figure, json)
        return
    _refuse({"lakes": lakes}, "landscapes")
    _compare_on_landscapes(bank or BANK, races or 20, strategies, rounds or 8, results, figure, workers or 2, json)


def _compare_on_landscapes(
    bank: Path,
    seeds: int,
    strategies: str | None,
    rounds: int,
    results: Path | None,
    figure: Path | None,
    workers: int,
    json: bool,
) -> None:
    from fast.flows.scientist.landscape_run import RunSchedule
    from fast.flows.scientist.landscape_study import plan_runs, run_planned, with_discovery
    from fast.flows.scientist.landscape_table import landscape_rows, paired_rows, summary_rows
    from fast.flows.scientist.strategies import LANDSCAPE_STRATEGIES, MEASURED_ONLY, NOT_DRAWN, REFERENCE

    names = _names(strategies, list(LANDSCAPE_STRATEGIES))
    plan = plan_runs(bank, seeds, names, RunSchedule(rounds=rounds))
    runs = with_discovery(run_planned(plan, results, workers, tell))
    others = {"against_measured_only": paired_rows(runs, MEASURED_ONLY), "landscapes": landscape_rows(runs)}
    _show(summary_rows(runs), paired_rows(runs, REFERENCE), _COLUMNS, json, others)
    if figure is not None:
        from fast.flows.scientist.landscape_table import runs_figure

        drawn = [run for run in runs if run.strategy not in NOT_DRAWN]
        _draw(lambda: runs_figure(drawn, REFERENCE), figure)


def _compare_campaigns(
    config: Path, seeds: int, strategies: str | None, lakes: Path, workers: int, figure: Path | None, json: bool
) -> None:
    from fast.flows.scientist.campaign_runs import PlannedCampaign, run_campaigns
    from fast.flows.scientist.campaign_table import COLUMNS, campaign_rows, campaigns_figure, paired_campaign_rows
    from fast.flows.scientist.strategies import REFERENCE, STRATEGIES
    from fast.tasks.campaign.config import load_config, world_path
    from fast.tasks.campaign.setup import read_world

    names = _names(strategies, list(STRATEGIES))
    loaded = load_config(config)
    world = read_world(world_path(config, loaded))
    plan = [
        PlannedCampaign(STRATEGIES[name], loaded.seed + seed, loaded, world, lakes)
        for seed in range(seeds)
        for name in names
    ]
    runs = run_campaigns(plan, tell, workers)
    _show(
        campaign_rows(runs),
        paired_campaign_rows(runs, REFERENCE),
        COLUMNS,
        json,
        {"campaigns": list(map(asdict, runs))},
    )
    if figure is not None:
        _draw(lambda: campaigns_figure(runs, REFERENCE), figure)


def _refuse(options: dict[str, object], beside: str) -> None:
    """Refuse options that do not belong to what is compared.

    Raises:
        UsageError: naming the first of them that was given.
    """
    from fast.models.errors import UsageError

    for name, value in options.items():
        if value is not None:
            raise UsageError(f"--{name} says nothing about {beside}; leave it out.")


def _show(summary: Rows, paired: Rows, columns: Sequence[str], as_json: bool, others: dict[str, Rows]) -> None:
    """Print the tables; `campaigns` among the others as JSON only."""
    from fast.flows.scientist.strategies import MEASURED_ONLY, REFERENCE

    titles = {
        "against_measured_only": f"against `{MEASURED_ONLY}` on the same seeds",
        "landscapes": "rounds to 97 % of the optimum, median",
    }
    parts = [
        table_text(summary, list(columns), WIDTH),
        f"against `{REFERENCE}` on the same seeds (positive: better)",
        table_text(paired, width=WIDTH),
    ]
    for name, title in titles.items():
        if others.get(name):
            parts += [title, table_text(others[name], width=WIDTH)]
    tables = {"strategies": summary, "paired": paired, **others}
    show({name: rows for name, rows in tables.items() if rows}, "\n\n".join(parts), as_json)


def _names(text: str | None, known: Sequence[str]) -> list[str]:
    """Names of strategies from `a;b`.

    Raises:
        UsageError: there is no such strategy.
    """
    from fast.models.errors import UsageError
    from fast.models.validation import closest

    if text is None:
        return list(known)
    names = [name.strip() for name in text.split(";")]
    for name in names:
        if name not in known:
            raise UsageError(f"There is no strategy `{name}`; {closest(name, list(known))}")
    return names


def _draw(make: "Callable[[], Figure]", path: Path) -> None:
    from fast.flows.report.style import figure_style

    path.parent.mkdir(parents=True, exist_ok=True)
    with figure_style():
        make().savefig(path, dpi=160)
    tell(f"{path} drawn")
