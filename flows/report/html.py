"""HTML parts of the report. Every text that comes from data is escaped here; callers pass `Markup` for HTML."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

from fast.flows.report.campaign.queries import Result
from fast.tasks.templates import DASH, number


class Markup(str):
    """Text that is already HTML."""

    __slots__ = ()

    def __html__(self) -> str:
        """As a template shows it."""
        return self


def text(value: object) -> Markup:
    """HTML of a value: escaped, a dash where there is none."""
    if isinstance(value, Markup):
        return value
    return Markup(DASH if value is None or value == "" else escape(str(value)))


def paragraph(content: object, css: str = "") -> Markup:
    """A paragraph."""
    return Markup(f"<p{_class(css)}>{text(content)}</p>")


def section(anchor: str, title: str, *parts: str) -> Markup:
    """A section of the page; parts are HTML."""
    return Markup(f'<section id="{anchor}"><h2>{escape(title)}</h2>{"".join(parts)}</section>')


def columns(*parts: str, css: str = "two") -> Markup:
    """Parts side by side where there is room."""
    return Markup(f'<div class="{css}">{"".join(f"<div>{part}</div>" for part in parts)}</div>')


def tiles(items: Sequence[tuple[str, str]]) -> Markup:
    """Key numbers with a line under each."""
    cells = "".join(f'<div class="tile"><b>{text(value)}</b><span>{text(label)}</span></div>' for value, label in items)
    return Markup(f'<div class="tiles">{cells}</div>')


def picture(source: str, alternative: str, caption: object = "") -> Markup:
    """A figure from a file of the report's folder."""
    under = f"<figcaption>{text(caption)}</figcaption>" if caption else ""
    return Markup(f'<figure><img src="{source}" alt="{escape(alternative)}">{under}</figure>')


def folded(summary: str, content: str) -> Markup:
    """HTML that the reader unfolds."""
    return Markup(f"<details><summary>{escape(summary)}</summary>{content}</details>")


def sources(*results: Result) -> Markup:
    """Folded: the SQL that was executed, and the CSV of its result."""
    blocks = "".join(
        f'<p class="note"><a href="data/{r.name}.csv">data/{r.name}.csv</a>, {r.table.num_rows} rows, '
        f'is the answer of <a href="data/{r.name}.sql">this query</a>:</p><pre>{escape(r.sql)}</pre>'
        for r in results
    )
    return folded("Data and SQL", blocks)


def table(
    headings: Sequence[str],
    rows: Sequence[Sequence[object]],
    numeric: Sequence[int] = (),
    best_row: int | None = None,
    empty: str = "Nothing yet.",
) -> Markup:
    """A table; `numeric` columns are right-aligned, `best_row` is marked, `empty` stands where there are no rows."""
    if not rows:
        return paragraph(empty)
    marks = [_class("number") if i in numeric else "" for i in range(len(headings))]
    head = "".join(f"<th{mark}>{text(h)}</th>" for h, mark in zip(headings, marks, strict=True))
    body = "".join(
        f"<tr{_class('best') if i == best_row else ''}>"
        + "".join(f"<td{mark}>{text(cell)}</td>" for cell, mark in zip(row, marks, strict=True))
        + "</tr>"
        for i, row in enumerate(rows)
    )
    return Markup(f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>')


Column = str | tuple[str, int] | Callable[[Any], object]


def record_table(
    rows: Sequence[Mapping[str, Any]], columns: Mapping[str, Column], empty: str = "Nothing yet."
) -> Markup:
    """A table of records: under each heading a field, a field as a number with its digits, or a function of the row."""
    cells = [[_cell(row, column) for column in columns.values()] for row in rows]
    numeric = [place for place, column in enumerate(columns.values()) if isinstance(column, tuple)]
    return table(list(columns), cells, numeric, empty=empty)


def _cell(row: Mapping[str, Any], column: Column) -> object:
    if callable(column):
        return column(row)
    return row[column] if isinstance(column, str) else number(row[column[0]], column[1])


@dataclass(frozen=True)
class Page:
    """What stands around the sections of a page; `nav` names, by anchor, those that may be there."""

    title: str
    kicker: str
    footer: str
    nav: Mapping[str, str]
    file: str = "index.html"


def _class(css: str) -> str:
    return f' class="{css}"' if css else ""
