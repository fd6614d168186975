"""Turn a failed validation into sentences a person can act on."""

import difflib
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from models.errors import ConfigError
from models.units import unit_of

R = TypeVar("R", bound=BaseModel)

_KIND_WORDS = {
    "float_parsing": "a number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_parsing": "a whole number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_parsing": "true or false",
    "bool_type": "true or false",
    "string_type": "text",
    "string_too_short": "a text that is not empty",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a table of keys and values",
    "model_type": "a table of keys and values",
}
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
        faults = error.errors()
        absent = [_path(fault) for fault in faults if fault["type"] == "missing"]
        sentences = [_missing_sentence(absent)] if absent else []
        sentences += [_sentence(record_type, fault) for fault in faults if fault["type"] != "missing"]
        raise ConfigError(f"{source}: " + " ".join(sentences)) from error


def closest(word: str, known: list[str]) -> str:
    """`did you mean X?` for a near miss, else the list of what is known."""
    if not known:
        return "there are none."
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.55)
    return f"did you mean `{near[0]}`?" if near else f"known: {', '.join(sorted(known))}."


def _sentence(record_type: type[BaseModel], fault: Any) -> str:
    path = _path(fault)
    kind, value, limits = fault["type"], fault["input"], fault.get("ctx", {})
    if kind == "extra_forbidden":
        known = list(_fields_at(record_type, fault["loc"][:-1]))
        return f"unknown key `{path}`; {closest(str(fault['loc'][-1]), known)}"
    unit = unit_of(str(fault["loc"][-1])) if fault["loc"] else None
    suffix = f" {unit}" if unit else ""
    for key, words in _LIMIT_WORDS.items():
        if key in limits:
            return f"`{path}` is {value}{suffix}, it must be {words} {limits[key]}{suffix}; change it."
    what = f"`{path}` is {value!r}" if path else f"the content is {value!r}"
    if kind in _KIND_WORDS:
        return f"{what}, it must be {_KIND_WORDS[kind]}; change it."
    if kind == "literal_error":
        return f"{what}, it must be {limits['expected']}; change it."
    if kind == "string_pattern_mismatch":
        rule = _fields_at(record_type, fault["loc"][:-1])[fault["loc"][-1]].description
        return f"{what}, it must match {limits['pattern']} ({rule}); change it."
    reason = fault["msg"].removeprefix("Value error, ")
    return f"`{path}` is {value!r}: {reason[:1].lower()}{reason[1:]}." if path else f"{reason}."


def _path(fault: Any) -> str:
    return ".".join(str(part) for part in fault["loc"])


def _missing_sentence(paths: list[str]) -> str:
    names = ", ".join(f"`{path}`" for path in paths)
    return f"{names} is missing; add it." if len(paths) == 1 else f"{names} are missing; add them."


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
