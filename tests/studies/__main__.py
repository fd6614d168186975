"""`python -m tests.studies`: the studies behind claims of the documentation, and what work costs on a machine.

`make studies` is something else: the tests that are marked as studies.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter

from fast.flows.cli.common import AsJson, say_progress, show, table_text
from fast.flows.cli.main import run_and_leave
from fast.models.errors import UsageError
from fast.models.objects.catalogue import get_object
from fast.models.simulation.version import find_tier
from fast.models.validation import closest
from tests.studies.benchmarks.base import Benchmark, Options, Tables, circumstances

app = App(
    name="python -m tests.studies",
    help="Studies behind claims of the documentation: `python -m tests.studies NAME [options]`, from the checkout. "
    "Some take hours; `list` names them.",
)


@Parameter(name="*")
@dataclass(frozen=True)
class Chosen:
    """Options of studies as they are typed; None leaves the choice to the study."""

    designs: Annotated[int | None, Parameter(help="How many designs of the fixed random sequence.")] = None
    objects: Annotated[str | None, Parameter(help="Object ids, e.g. 0,14,30.")] = None
    results: Annotated[
        Path | None, Parameter(help="JSON-lines file of the outcomes; what is in it is not simulated again.")
    ] = None
    limit_minutes: Annotated[float | None, Parameter(help="Stop after this time; --results continues.")] = None
    workers: Annotated[int | None, Parameter(help="Worker processes.")] = None
    figure: Annotated[Path | None, Parameter(help="Picture to draw, e.g. accuracy.png.")] = None
    tiers: Annotated[str | None, Parameter(help="Tiers of the simulator, e.g. production,reference.")] = None
    grasps: Annotated[str | None, Parameter(help="Sizes of lakes, in grasps, e.g. 8640,1000000.")] = None
    n_sim: Annotated[int | None, Parameter(help="Simulations of a made-up problem.")] = None
    n_real: Annotated[int | None, Parameter(help="Measured designs of a made-up problem.")] = None
    n: Annotated[int | None, Parameter(help="How many kills, seeds or cases.")] = None
    worlds: Annotated[int | None, Parameter(help="How many made-up problems of known truth.")] = None
    panel: Annotated[Path | None, Parameter(help="File of true grasps and their bank (panel.npz).")] = None


@app.default
def run(
    name: Annotated[str, Parameter(help="One of `python -m tests.studies list`.")],
    *,
    chosen: Chosen = Chosen(),
    json: AsJson = False,
) -> None:
    """Run one study and print its tables, after where and with which code it ran.

    Figures are CPU seconds unless their name says otherwise.
    """
    from tests.studies.registry import STUDIES

    if name not in STUDIES:
        raise UsageError(f"there is no study `{name}`; {closest(name, list(STUDIES))}")
    given: dict[str, Any] = {
        option: _PARSERS[option](value) if option in _PARSERS else value
        for option, value in vars(chosen).items()
        if value is not None
    }
    _check_options(name, STUDIES[name], given)
    tables = STUDIES[name].measure(Options(**given, tell=say_progress))
    show({"study": name, "options": given, **circumstances(), "tables": _rounded(tables)}, _text(tables), json)


@app.command(name="list")
def list_studies(*, json: AsJson = False) -> None:
    """The studies there are, with what they measure."""
    from tests.studies.registry import STUDIES

    rows = [{"name": name, "measures": study.about} for name, study in STUDIES.items()]
    width = max(map(len, STUDIES))
    show(rows, "\n".join(f"{row['name']:<{width}} {row['measures']}" for row in rows), json)


def _object_ids(text: str) -> tuple[int, ...]:
    """Object ids from `0,14,30`.

    Raises:
        UsageError: no number, or no such object.
    """
    try:
        return tuple(get_object(int(word)).object_id for word in text.split(","))
    except ValueError as error:
        raise UsageError(f"--objects `{text}` is no list of object ids; write it like 0,14,30.") from error


def _sizes(text: str) -> tuple[int, ...]:
    """Numbers of grasps from `8640,1000000`.

    Raises:
        UsageError: no whole number, or one below 1.
    """
    words = text.split(",")
    if not all(word.strip().isdecimal() and int(word) > 0 for word in words):
        raise UsageError(f"--grasps `{text}` is no list of numbers of grasps; write it like 8640,1000000.")
    return tuple(int(word) for word in words)


def _tiers(text: str) -> tuple[str, ...]:
    """Names from `production,reference`.

    Raises:
        UsageError: there is no such tier.
    """
    for tier in text.split(","):
        find_tier(tier)
    return tuple(text.split(","))


_PARSERS: dict[str, Callable[[str], tuple[Any, ...]]] = {"objects": _object_ids, "tiers": _tiers, "grasps": _sizes}


def _check_options(name: str, study: Benchmark, given: dict[str, Any]) -> None:
    for option, value in given.items():
        if option not in study.options:
            raise UsageError(f"`{name}` has no option --{option.replace('_', '-')}; leave it out.")
        if option in ("designs", "workers", "n", "worlds", "n_sim", "n_real") and value < 1:
            raise UsageError(f"--{option} is {value}, at least 1 is needed.")


def _rounded(tables: Tables) -> Tables:
    """The tables with figures of five digits: more are noise, and make every repetition look different."""
    return {
        title: [{k: float(f"{v:.5g}") if isinstance(v, float) else v for k, v in row.items()} for row in rows]
        for title, rows in tables.items()
    }


def _text(tables: Tables) -> str:
    parts = []
    for title, rows in tables.items():
        columns = list(dict.fromkeys(column for row in rows for column in row))
        parts.append(f"{title}\n\n{table_text(rows, columns)}")
    return "\n\n".join(parts)


if __name__ == "__main__":
    run_and_leave(app)
