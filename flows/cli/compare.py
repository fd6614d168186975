"""`fast compare`: the scientist's strategies side by side as whole campaigns, at the same budget, on the same world."""

from collections.abc import Sequence
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from fast.flows.cli.campaign import open_lake, resolve_campaign
from fast.flows.cli.common import AsJson, say_progress, show, table_text, write_out
from fast.models.errors import UsageError

AT_LEAST_ONE = Number(gte=1)
WIDTH = 100  # columns of text


def compare(
    config: Annotated[Path | None, Parameter(help="Campaign config with a virtual bench.")] = None,
    *,
    lake: Annotated[
        Path | None, Parameter(help="Replay strategies on what was measured in this lake, instead of on a bench.")
    ] = None,
    campaign: Annotated[str | None, Parameter(help="Campaign of --lake; not needed where there is one.")] = None,
    races: Annotated[int, Parameter(help="Seeds of each strategy.", validator=AT_LEAST_ONE)] = 2,
    strategies: Annotated[
        str | None, Parameter(help="Names with semicolons between them, in quotes; default: all.")
    ] = None,
    lakes: Annotated[Path, Parameter(help="Folder of the lakes of the campaigns; may be continued.")] = Path(
        "compare-data"
    ),
    figure: Annotated[Path | None, Parameter(help="Picture to draw, e.g. compare.png.")] = None,
    workers: Annotated[int, Parameter(help="Campaigns that run side by side.", validator=AT_LEAST_ONE)] = 1,
    json: AsJson = False,
) -> None:
    """Compare the scientist's strategies as whole campaigns, with paired seeds.

    They have the schedule of their config, the same number of measured tools for each strategy, and the same first
    designs. With --lake they are replayed on the tools of a campaign, where the nearest measured design stands for one
    that is proposed; the error of that is said.
    """
    if lake is not None and config is None:
        _replay(lake, campaign, races, json)
        return
    if config is None or lake is not None:
        raise UsageError("give a config, or --lake with what was measured; one of them.")
    from fast.flows.scientist.campaign_runs import BASELINE, STRATEGIES, PlannedCampaign, run_campaigns
    from fast.flows.scientist.campaign_table import COLUMNS, campaign_rows, campaigns_figure, paired_campaign_rows
    from fast.tasks.campaign.config import load_config, world_path
    from fast.tasks.campaign.setup import read_world

    names = _names(strategies, list(STRATEGIES))
    loaded = load_config(config)
    world = read_world(world_path(config, loaded))
    plan = [
        PlannedCampaign(STRATEGIES[name], loaded.seed + seed, loaded, world, lakes)
        for seed in range(races)
        for name in names
    ]
    runs = run_campaigns(plan, say_progress, workers)
    summary, paired = campaign_rows(runs), paired_campaign_rows(runs, BASELINE)
    parts = [
        table_text(summary, list(COLUMNS), WIDTH),
        f"against `{BASELINE}` on the same seeds (positive: better)",
        table_text(paired, width=WIDTH),
    ]
    tables = {"strategies": summary, "paired": paired, "campaigns": list(map(asdict, runs))}
    show({name: rows for name, rows in tables.items() if rows}, "\n\n".join(parts), json)
    if figure is not None:
        from fast.flows.report.style import figure_style

        picture = BytesIO()
        with figure_style():
            campaigns_figure(runs, BASELINE).savefig(picture, format=figure.suffix[1:] or "png", dpi=160)
        write_out("--figure", figure, picture.getvalue())
        say_progress(f"{figure} drawn")


def _replay(lake: Path, campaign: str | None, races: int, as_json: bool) -> None:
    """Replay strategies on what a campaign has measured."""
    from fast.flows.campaign.status import read_campaign
    from fast.tasks.campaign.simulator_versions import at_present
    from fast.tasks.scientist.backtest import backtest

    found = open_lake(lake)
    rows = backtest(at_present(read_campaign(found, resolve_campaign(found, campaign))), races, say_progress)
    errors = [row["stand_in_n"] for row in rows if row["stand_in_n"] is not None]
    note = (
        f"The nearest measured design stands for each proposal; by the surrogate of all data it is "
        f"{min(errors):.1f} to {max(errors):.1f} off, in N or J. Strategies that differ by less are not told apart."
    )
    show({"replays": rows, "note": note}, f"{table_text(rows, width=WIDTH)}\n\n{note}", as_json)


def _names(text: str | None, known: Sequence[str]) -> list[str]:
    """Read the names of strategies from `a;b`.

    Raises:
        UsageError: there is no such strategy.
    """
    from fast.models.validation import closest

    if text is None:
        return list(known)
    names = [name.strip() for name in text.split(";")]
    for name in names:
        if name not in known:
            raise UsageError(f"There is no strategy `{name}`; {closest(name, list(known))}")
    return names
