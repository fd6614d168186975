"""Turn a failed validation into sentences a person can act on."""

import difflib
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from models.errors import ConfigError
from models.units import unit_of

R = TypeVar("R", bound=BaseModel)

_LIMIT_WORDS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}


def load_record(record_type: type[R], data: Any, source: str) -> R:
    """Build a record from outside data.

    `source` names where the data came from, for the message.

    Raises:
        ConfigError: one sentence per fault, naming the key, its value, the limit and the unit.
    """
    try:
        return record_type.model_validate(data)
    except ValidationError as error:
        sentences = [_sentence(record_type, fault) for fault in error.errors()]
        raise ConfigError(f"{source}: " + " ".join(sentences)) from error


def closest(word: str, known: list[str]) -> str:
    """`; did you mean X?` for a near miss, else the list of what is known."""
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.55)
    return f"did you mean `{near[0]}`?" if near else f"known: {', '.join(sorted(known))}."


def _sentence(record_type: type[BaseModel], fault: Any) -> str:
    path = ".".join(str(part) for part in fault["loc"])
    kind, value, limits = fault["type"], fault["input"], fault.get("ctx", {})
    if kind == "extra_forbidden":
        known = list(_fields_at(record_type, fault["loc"][:-1]))
        return f"unknown key `{path}`; {closest(str(fault['loc'][-1]), known)}"
    if kind == "missing":
        return f"`{path}` is missing; add it."
    unit = unit_of(str(fault["loc"][-1])) if fault["loc"] else None
    suffix = f" {unit}" if unit else ""
    for key, words in _LIMIT_WORDS.items():
        if key in limits:
            return f"`{path}` is {value}{suffix}, it must be {words} {limits[key]}{suffix}; change it."
    reason = fault["msg"].removeprefix("Value error, ")
    return f"`{path}` is {value!r}: {reason[:1].lower()}{reason[1:]}." if path else f"{reason}."


def _fields_at(record_type: type[BaseModel], path: tuple[Any, ...]) -> dict[str, Any]:
    fields = record_type.model_fields
    for part in path:
        if isinstance(part, int) or part not in fields:
            continue
        annotation = fields[part].annotation
        inner = [annotation, *getattr(annotation, "__args__", ())]
        nested = [t for t in inner if isinstance(t, type) and issubclass(t, BaseModel)]
        fields = nested[0].model_fields if nested else fields
    return fields
