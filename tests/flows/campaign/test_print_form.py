"""The form of the human step: what it asks for, what it refuses, and how an answer is read."""

import pytest
from pydantic import ValidationError

from fast.flows.campaign.print_form import make_form, read_answer
from fast.models.errors import UsageError
from fast.tasks.bench.measured_tools import MeasuredTool


def answer(slots=(0, 1), **tools):
    return make_form("small", 1, slots, "", None)(operator="ada", **tools)


def test_only_the_name_is_needed_and_an_empty_answer_is_not_enough():
    form = make_form("small", 1, [0, 1], "", None)
    assert form.model_json_schema()["required"] == ["operator"]
    with pytest.raises(ValidationError):
        form()
    word = read_answer(form(operator=" ada "), 1, [0, 1], [0, 1])
    assert (word.operator, word.rejected, word.again, word.measured) == ("ada", {}, {}, {})


def test_numbers_are_plain_fields_with_limits():
    tool = make_form("small", 1, [0], "", None).model_json_schema()["$defs"]["ToolAnswer"]["properties"]
    assert tool["front_mm"] == {
        "title": "Front wall, measured, mm", "type": "number", "exclusiveMinimum": 0
    }  # fmt: skip
    with pytest.raises(ValidationError):
        answer(B01T0={"front_mm": -2.5})


def test_an_answer_is_read_by_slot():
    given = answer(
        slots=(0, 1, 2, 3),
        B01T0={"front_mm": 2.6, "hardness_shore_a": 85, "rack_slot": 7},
        B01T1={"became": "rejected", "reason": "tip torn", "front_mm": 2.6},
        B01T2={"became": "print again", "reason": "warped"},
    )
    word = read_answer(given, 1, [0, 1, 2, 3], [0, 1, 2, 3])
    assert word.measured == {0: MeasuredTool(measured_front_thickness_mm=2.6, hardness_shore_a=85)}
    assert (word.rejected, word.again, word.mounted) == ({1: "tip torn"}, {2: "warped"}, {0: 7})


def test_slots_confirmed_elsewhere_meanwhile_are_left_out():
    given = answer(B01T0={"became": "rejected", "reason": "torn"}, B01T1={"rack_slot": 1})
    word = read_answer(given, 1, [0, 1], [1])
    assert (word.rejected, word.mounted) == ({}, {1: 1})


@pytest.mark.parametrize("became", ["rejected", "print again"])
def test_a_reason_is_asked_for(became):
    with pytest.raises(UsageError, match=f"B01T0 is '{became}' without a reason; give one"):
        read_answer(answer(B01T0={"became": became, "reason": "  "}), 1, [0, 1], [0, 1])


def test_after_a_bad_answer_the_form_says_why_and_keeps_what_was_typed_but_the_name():
    bad = answer(material_lot="L7", B01T0={"became": "rejected", "front_mm": 2.6})
    again = make_form("small", 1, [0, 1], "B01T0 has no reason.", bad).model_json_schema()["properties"]
    assert "could not be used: B01T0 has no reason." in again["operator"]["description"]
    assert "default" not in again["operator"]
    assert again["material_lot"]["default"] == "L7"
    assert again["B01T0"]["default"] == {"became": "rejected", "reason": "", "front_mm": 2.6}
