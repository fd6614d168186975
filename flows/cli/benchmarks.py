"""`fast bench`: run benchmarks and print what one unit of work costs here."""

from typing import Annotated

from cyclopts import App, Parameter

from flows.cli.common import AsJson, show, table_text

app = App(name="bench", help="Performance and study benchmarks.")


@app.command
def run(name: Annotated[str, Parameter(help="One of `fast bench list`.")], *, json: AsJson = False) -> None:
    """Run one benchmark; figures are CPU seconds unless their name says otherwise."""
    from flows.benchmarks import BENCHMARKS
    from models.errors import UsageError
    from models.validation import closest

    if name not in BENCHMARKS:
        raise UsageError(f"there is no benchmark `{name}`; {closest(name, list(BENCHMARKS))}")
    rows = BENCHMARKS[name]()
    columns = list(dict.fromkeys(column for row in rows for column in row))
    show(rows, table_text(rows, columns), json)


@app.command(name="list")
def list_benchmarks(*, json: AsJson = False) -> None:
    """The benchmarks there are, with what they measure."""
    from flows.benchmarks import BENCHMARKS

    rows = [{"name": name, "measures": (work.__doc__ or "").strip()} for name, work in BENCHMARKS.items()]
    show(rows, "\n".join(f"{row['name']:<10} {row['measures']}" for row in rows), json)
