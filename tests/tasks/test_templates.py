"""Templates: what they escape, how numbers read, and what a page has around its sections."""

from datetime import UTC, datetime

import pytest
from jinja2 import UndefinedError

from fast.tasks.templates import count, find_environment, moment, number

PAGE = """
{% extends "flows/report/page.html.j2" %}
{% from "flows/report/parts.html.j2" import section, sources, table %}
{% set title, kicker, footer = name, "K", "F" %}
{% set nav = {"there": "There", "gone": "Gone"} %}
{% block main %}
{% call section("there", name) %}
{{ table("Forces", {"tool": "tool", "force (N)": ["force_n", 1]}, rows, empty="None.", best=0) }}
{% endcall %}
{% endblock %}
"""


def render(**values):
    return find_environment().from_string(PAGE).render(values)


def test_numbers_read_as_a_person_writes_them():
    assert number(-12345.678, 1, "N") == "\u221212\u202f345.7\u00a0N"
    assert [number(value) for value in (None, float("nan"), 0.25, -0.01)] == ["–", "–", "0.2", "0.0"]
    assert [count(n, "tool") for n in (0, 1, 2000)] == ["0 tools", "1 tool", "2\u202f000 tools"]
    assert [moment(value) for value in (None, datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC))] == ["–", "2026-01-02 03:04"]


def test_no_text_of_a_person_is_markup():
    page = render(name="<b>A&B</b>", rows=[{"tool": "<i>", "force_n": 1.0}])
    assert page.count("&lt;b&gt;A&amp;B&lt;/b&gt;") == 3  # window, heading, section
    assert "<td>&lt;i&gt;</td>" in page
    assert not {"<b>", "<i>"} & {page[i : i + 3] for i in range(len(page))}


def test_the_navigation_has_the_sections_that_are_there():
    page = render(name="N", rows=[])
    assert '<a href="#there">There</a>' in page
    assert "Gone" not in page


def test_a_table_is_reached_by_keyboard_and_sets_numbers_right():
    page = render(name="N", rows=[{"tool": "B01T0", "force_n": 31.24}, {"tool": None, "force_n": None}])
    assert '<div class="scroll" tabindex="0" role="region" aria-label="Forces">' in page
    assert '<th>tool</th><th class="number">force (N)</th>' in page
    assert '<tr class="best"><td>B01T0</td><td class="number">31.2</td></tr>' in page
    assert '<tr><td>–</td><td class="number">–</td></tr>' in page
    assert "None." in render(name="N", rows=[])


def test_a_value_that_nobody_gave_is_an_error():
    with pytest.raises(UndefinedError, match="'rows' is undefined"):
        render(name="N")
