"""`python -m tests.studies`: the studies behind claims of the documentation, by the runner of `fast bench`.

`make studies` is something else: the tests that are marked as studies.
"""

from dataclasses import dataclass
from typing import Annotated

from cyclopts import App, Parameter

from fast.flows.cli.benchmarks import Chosen, run_benchmark, show_list
from fast.flows.cli.common import AsJson
from fast.flows.cli.main import run_and_leave

app = App(
    name="python -m tests.studies",
    help="Studies behind claims of the documentation: `python -m tests.studies NAME [options]`, from the checkout. "
    "Some take hours; `list` names them.",
)


@Parameter(name="*")
@dataclass(frozen=True)
class StudyChosen(Chosen):
    """What only studies take."""

    n: Annotated[int | None, Parameter(help="How many kills, or cases.")] = None
    worlds: Annotated[int | None, Parameter(help="How many made-up problems of known truth.")] = None


@app.default
def run(
    name: Annotated[str, Parameter(help="One of `python -m tests.studies list`.")],
    *,
    chosen: StudyChosen = StudyChosen(),
    json: AsJson = False,
) -> None:
    """Run one study; figures are CPU seconds unless their name says otherwise."""
    from tests.studies.registry import STUDIES

    run_benchmark(STUDIES, name, chosen, json)


@app.command(name="list")
def list_studies(*, json: AsJson = False) -> None:
    """The studies there are, with what they measure."""
    from tests.studies.registry import STUDIES

    show_list(STUDIES, json)


if __name__ == "__main__":
    run_and_leave(app)
