"""What a bench asks a person while it works: a sentence, choices, and fields to fill in."""

from collections.abc import Callable
from typing import Literal

from pydantic import Field

from fast.models.records import Record


class AskedField(Record):
    """Something to fill in. `label`: with its unit."""

    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    label: str
    kind: Literal["number", "text"] = "number"


class BenchQuestion(Record):
    """A question to a person. `key`: what it is about; a bench that is opened again and asks the same, finds it."""

    key: str = Field(min_length=1, max_length=200)
    sentence: str = Field(min_length=1)
    choices: tuple[str, ...] = Field(min_length=1, max_length=6)
    fields: tuple[AskedField, ...] = ()


class BenchAnswer(Record):
    """What a person answered. `values`: by the name of the field."""

    choice: str
    values: dict[str, float | str] = {}
    operator: str = Field(min_length=1)


Ask = Callable[[BenchQuestion], BenchAnswer]
"""Has a person asked, and returns the answer; raises `StopAskedError` when somebody stops or pauses meanwhile."""
