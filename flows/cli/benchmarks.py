"""`fast bench`: run benchmarks and print what one unit of work costs here; `python -m tests.studies` shares it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, Parameter

from fast.flows.cli.common import AsJson, show, table_text, tell

if TYPE_CHECKING:
    from fast.flows.benchmarks.base import Benchmark, Tables

app = App(name="bench", help="What simulations, fits, the lake and campaigns cost on this machine.")


@Parameter(name="*")
@dataclass(frozen=True)
class Chosen:
    """Options of benchmarks and studies as they are typed; None leaves the choice to them."""

    designs: Annotated[int | None, Parameter(help="How many designs of the fixed random sequence.")] = None
    objects: Annotated[str | None, Parameter(help="Object ids, e.g. 0,14,30.")] = None
    results: Annotated[
        Path | None, Parameter(help="JSON-lines file of the outcomes; what is in it is not simulated again.")
    ] = None
    limit_minutes: Annotated[float | None, Parameter(help="Stop after this time; --results continues.")] = None
    workers: Annotated[int | None, Parameter(help="Worker processes.")] = None
    figure: Annotated[Path | None, Parameter(help="Picture to draw, e.g. accuracy.png.")] = None


@Parameter(name="*")
@dataclass(frozen=True)
class BenchChosen(Chosen):
    """What only benchmarks take."""

    tiers: Annotated[str | None, Parameter(help="Tiers of the simulator, e.g. production,reference.")] = None
    grasps: Annotated[str | None, Parameter(help="Sizes of lakes, in grasps, e.g. 8640,1000000.")] = None
    n_sim: Annotated[int | None, Parameter(help="Simulations of a made-up problem.")] = None
    n_real: Annotated[int | None, Parameter(help="Measured designs of a made-up problem.")] = None


@app.command
def run(
    name: Annotated[str, Parameter(help="One of `fast bench list`.")],
    *,
    chosen: BenchChosen = BenchChosen(),
    json: AsJson = False,
) -> None:
    """Run one benchmark; figures are CPU seconds unless their name says otherwise."""
    from fast.flows.benchmarks.registry import BENCHMARKS

    run_benchmark(BENCHMARKS, name, chosen, json)


@app.command(name="list")
def list_benchmarks(*, json: AsJson = False) -> None:
    """The benchmarks there are, with what they measure."""
    from fast.flows.benchmarks.registry import BENCHMARKS

    show_list(BENCHMARKS, json)


def run_benchmark(benchmarks: Mapping[str, "Benchmark"], name: str, chosen: Chosen, as_json: bool) -> None:
    """Run the benchmark of this name and print its tables, after where and with which code it ran.

    Raises:
        UsageError: there is no such benchmark, or it has no such option.
    """
    from fast.flows.benchmarks.base import Options, circumstances
    from fast.models.errors import UsageError
    from fast.models.validation import closest

    if name not in benchmarks:
        raise UsageError(f"there is no benchmark `{name}`; {closest(name, list(benchmarks))}")
    given: dict[str, Any] = {
        option: _PARSERS[option](value) if option in _PARSERS else value
        for option, value in vars(chosen).items()
        if value is not None
    }
    _check_options(name, benchmarks[name], given)
    tables = benchmarks[name].measure(Options(**given, tell=tell))
    head = {"benchmark": name, "options": given, **circumstances()}
    show({**head, "tables": _rounded(tables)}, _text(tables), as_json)


def show_list(benchmarks: Mapping[str, "Benchmark"], as_json: bool) -> None:
    """Print the names of the benchmarks and what they measure."""
    rows = [{"name": name, "measures": benchmark.about} for name, benchmark in benchmarks.items()]
    width = max(len(name) for name in benchmarks)
    show(rows, "\n".join(f"{row['name']:<{width}} {row['measures']}" for row in rows), as_json)


def _object_ids(text: str) -> tuple[int, ...]:
    """Object ids from `0,14,30`.

    Raises:
        UsageError: no number, or no such object.
    """
    from fast.models.errors import UsageError
    from fast.models.objects.catalogue import get_object

    try:
        return tuple(get_object(int(word)).object_id for word in text.split(","))
    except ValueError as error:
        raise UsageError(f"--objects `{text}` is no list of object ids; write it like 0,14,30.") from error


def _sizes(text: str) -> tuple[int, ...]:
    """Numbers of grasps from `8640,1000000`.

    Raises:
        UsageError: no whole number, or one below 1.
    """
    from fast.models.errors import UsageError

    words = text.split(",")
    if not all(word.strip().isdecimal() and int(word) > 0 for word in words):
        raise UsageError(f"--grasps `{text}` is no list of numbers of grasps; write it like 8640,1000000.")
    return tuple(int(word) for word in words)


def _names(text: str) -> tuple[str, ...]:
    """Names from `production,reference`."""
    return tuple(text.split(","))


_PARSERS: dict[str, Callable[[str], tuple[Any, ...]]] = {"objects": _object_ids, "tiers": _names, "grasps": _sizes}


def _check_options(name: str, benchmark: "Benchmark", given: dict[str, Any]) -> None:
    from fast.models.errors import UsageError
    from fast.models.records import find_tier

    for option, value in given.items():
        if option not in benchmark.options:
            flag = option.replace("_", "-")
            raise UsageError(f"the benchmark `{name}` has no option --{flag}; leave it out.")
        if option in ("designs", "workers", "n", "worlds", "n_sim", "n_real") and value < 1:
            raise UsageError(f"--{option} is {value}, at least 1 is needed.")
    for tier in given.get("tiers", ()):
        find_tier(tier)


def _rounded(tables: "Tables") -> "Tables":
    """The tables with figures of five digits: more are noise, and make every repetition look different."""
    return {
        title: [{k: float(f"{v:.5g}") if isinstance(v, float) else v for k, v in row.items()} for row in rows]
        for title, rows in tables.items()
    }


def _text(tables: "Tables") -> str:
    parts = []
    for title, rows in tables.items():
        columns = list(dict.fromkeys(column for row in rows for column in row))
        parts.append(f"{title}\n\n{table_text(rows, columns)}")
    return "\n\n".join(parts)
