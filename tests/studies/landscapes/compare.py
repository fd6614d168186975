"""The scientist's strategies on landscapes that answer at once, with paired seeds and the paper's schedule."""

from pathlib import Path

from fast.flows.report.style import figure_style
from fast.flows.scientist.campaign_runs import BASELINE
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.landscapes.run import RunSchedule
from tests.studies.landscapes.strategies import LANDSCAPE_STRATEGIES, NOT_DRAWN
from tests.studies.landscapes.study import plan_runs, run_planned, with_discovery
from tests.studies.landscapes.table import landscape_rows, paired_rows, runs_figure, summary_rows

BANK = Path(__file__).resolve().parents[3] / "docs" / "benchmarks" / "landscapes.json"
N_SEEDS, N_WORKERS = 20, 2


def measure_landscapes(options: Options) -> Tables:
    """Strategies of the scientist on landscapes of eight hidden truths; --n seeds of each."""
    plan = plan_runs(BANK, options.n or N_SEEDS, list(LANDSCAPE_STRATEGIES), RunSchedule())
    runs = with_discovery(run_planned(plan, options.results, options.workers or N_WORKERS, options.tell))
    if options.figure is not None:
        with figure_style():
            figure = runs_figure([run for run in runs if run.strategy not in NOT_DRAWN], BASELINE)
            figure.savefig(options.figure, dpi=160)
    return {
        "strategies": summary_rows(runs),
        f"against {BASELINE} on the same seeds (positive: better)": paired_rows(runs, BASELINE),
        "against measured only on the same seeds": paired_rows(runs, "measured only"),
        "rounds to 97 % of the optimum, median": landscape_rows(runs),
    }
