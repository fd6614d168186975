"""Pages and printed sheets: one environment for every template of the product, and the words for numbers with units.

A template (`*.html.j2`) lies beside the Python that computes what it shows and is named by its path in the package:
`flows/report/labs.html.j2`. `flows/report/page.html.j2` is what all pages extend, `flows/report/parts.html.j2` has the
parts they share. Every value is escaped; a template that names a value which nobody gave is an error.
"""

from datetime import datetime
from functools import cache
from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined

from fast.models.units import typeset

DASH = "–"


def render(template: str, **values: object) -> str:
    """Render the HTML of a template with its values.

    Raises:
        jinja2.UndefinedError: the template shows a value that was not given.
    """
    return find_environment().get_template(template).render(values)


@cache
def find_environment() -> Environment:
    """Return the environment, made once a process: filters for numbers and times, the stylesheet as a global."""
    made = Environment(
        loader=PackageLoader("fast", ""),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=lambda value: DASH if value is None else value,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,
    )
    made.filters.update(number=number, count=count, moment=moment, typeset=typeset)
    made.globals["stylesheet"] = files("fast.flows.report").joinpath("page.css").read_text(encoding="utf-8")
    return made


def number(value: float | None, digits: int = 1, unit: str = "", dash: str = DASH) -> str:
    """Number with fixed digits, thousands apart, and its unit; where there is none, `dash`."""
    if value is None or value != value:
        return dash
    return typeset(value, f"z,.{digits}f").replace(",", "\u202f") + (f"\u00a0{unit}" if unit else "")


def count(n: int, noun: str) -> str:
    """Write a number of things: `1 tool`, `3 tools`."""
    return f"{number(n, 0)} {noun}{'' if n == 1 else 's'}"


def moment(value: datetime | None) -> str:
    """Write date and time to the minute, as stored (UTC)."""
    return DASH if value is None else value.strftime("%Y-%m-%d %H:%M")
