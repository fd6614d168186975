"""Turn a failed validation into sentences a person can act on."""

import difflib
import json
import re
import tomllib
from collections.abc import Iterator, Sequence
from numbers import Integral
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from fast.models.errors import ConfigError, UsageError
from fast.models.units import unit_of

R = TypeVar("R", bound=BaseModel)

_KIND_WORDS = {
    "float_parsing": "a number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_parsing": "a whole number",
    "int_parsing_size": "a smaller whole number",
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
    "model_attributes_type": "a table of keys and values",
}
_TYPE = re.compile(r"[a-z-]+\[.*\]")  # how pydantic writes a type into a path
LONGEST_VALUE = 80
_TOO_DEEP = "its tables or lists are nested too deeply; correct it"
_LIMIT_WORDS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Parse the values of a TOML text; `source` names it in messages.

    Raises:
        ConfigError: it is not TOML.
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{source} is not TOML: {error}; correct that line.") from error
    except RecursionError as error:
        raise ConfigError(f"{source} is not TOML: {_TOO_DEEP}.") from error


def parse_json(text: str, source: str) -> Any:
    """Parse the values of a JSON text; `source` names it in messages.

    Raises:
        ConfigError: it is not JSON, or a table has a key twice.
    """

    def to_table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        keys = [key for key, _ in pairs]
        if doubled := [key for key in dict.fromkeys(keys) if keys.count(key) > 1]:
            raise ConfigError(f"{source}: the key `{doubled[0][:LONGEST_VALUE]}` is there twice; leave one out.")
        return dict(pairs)

    try:
        return json.loads(text, object_pairs_hook=to_table)
    except ValueError as error:
        raise ConfigError(f"{source} is not JSON: {error}; correct it.") from error
    except RecursionError as error:
        raise ConfigError(f"{source} is not JSON: {_TOO_DEEP}.") from error


def load_record(record_type: type[R], data: Any, source: str) -> R:
    """Build a record from outside data.

    `source` names where the data came from, for the message.

    Raises:
        ConfigError: one sentence per fault, naming the key, its value, the limit and the unit.
    """
    values = dict(_values(data))
    if faulty := [path for path, value in values.items() if isinstance(value, str) and not is_text(value)]:
        raise ConfigError(f"{source}: `{faulty[0]}` has a character that no text may have; write it again.")
    try:
        record = record_type.model_validate(data)
    except ValidationError as error:
        raise ConfigError(f"{source}: {describe_faults(record_type, error)}") from error
    _refuse_booleans(values, dict(_values(record.model_dump())), source)
    return record


def check_type(given: object, kind: type, name: str, what: str = "") -> None:
    """Refuse an argument of another type. `what` it must be, in words; default: the public name of `fast`.

    Raises:
        UsageError: it is of another type.
    """
    if not isinstance(given, kind):
        wanted = what or f"a fast.{kind.__name__}"
        raise UsageError(f"{name} is of type {type(given).__name__}, it must be {wanted}; change it.")


def check_whole(given: object, name: str, least: int | None = 0) -> int:
    """Check for a whole number of at least `least`, if that is given, also one of numpy.

    Raises:
        UsageError: it is none.
    """
    number = plain(given)
    is_whole = isinstance(number, int | Integral) and not isinstance(number, bool)
    if not is_whole or (least is not None and number < least):
        at_least = "" if least is None else f" of at least {least}"
        raise UsageError(f"{name} is {given!r}, it must be a whole number{at_least}; change it.")
    return int(number)


def check_again(record: R, source: str) -> R:
    """Return the record with its values checked, as `model_copy(update=...)` does not; `source` names it in messages.

    Raises:
        ConfigError: as `load_record`.
    """
    return load_record(type(record), _content(record), source)


def _content(record: BaseModel) -> dict[str, Any]:
    """Return values by key, of records within it too, also keys it does not have; without cached properties."""
    own = {name: value for name, value in record if not hasattr(type(record), name)}
    return {name: _content(value) if isinstance(value, BaseModel) else value for name, value in own.items()}


def describe_faults(record_type: type[BaseModel], error: ValidationError) -> str:
    """Describe what is wrong with the values of a record: a sentence each, with value, limit, unit and what to do."""
    faults = _join_choices(error.errors())
    absent = [_path(fault) for fault in faults if fault["type"] == "missing"]
    sentences = [_missing_sentence(absent)] if absent else []
    sentences += [_sentence(record_type, fault) for fault in faults if fault["type"] != "missing"]
    return " ".join(" ".join(sentences).split())  # values may hold line breaks


def _join_choices(faults: Sequence[Any]) -> list[Any]:
    """Join faults by the keys that people know: one instead of one per type where a value fits none of several types.

    pydantic puts the type into the path, as in `('objects', 'ids', 'tuple[int, ...]', 1)`.
    """
    joined: list[Any] = []
    for fault in faults:
        path = tuple(part for part in fault["loc"] if not _is_type(part))
        fault = {**fault, "loc": path, "is_choice": len(path) < len(fault["loc"])}
        last = joined[-1] if joined else None
        if last is None or not (last["is_choice"] and fault["is_choice"]) or path[: len(last["loc"])] != last["loc"]:
            joined.append(fault)
        elif len(path) > len(last["loc"]):  # it fits this type but for one of its parts
            joined[-1] = fault
        else:
            last["also"] = [*last.get("also", ()), fault]
    return joined


def _is_type(part: int | str) -> bool:
    return isinstance(part, str) and (part in ("int", "float", "str", "bool") or bool(_TYPE.fullmatch(part)))


def plain(value: Any) -> Any:
    """Return the value as Python's own number or text, if it is a scalar of numpy, pandas or torch."""
    return value.item() if getattr(value, "shape", None) == () else value


def is_text(value: str) -> bool:
    """Return whether a string can be written and be part of a path: no NUL, and nothing that UTF-8 cannot say."""
    return "\0" not in value and value == value.encode(errors="replace").decode()


def _refuse_booleans(given: dict[str, Any], taken: dict[str, Any], source: str) -> None:
    """Raise ConfigError where `true` or `false` was taken for a number, as pydantic does."""
    for path, value in given.items():
        if isinstance(value, bool) and isinstance(taken.get(path, value), int | float) and taken.get(path) is not value:
            word = str(value).lower()
            raise ConfigError(f"{source}: `{path}` is {word}, it must be a number; change it.")


def _values(data: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield `(section.key, value)` of all values of nested data that are no tables or lists themselves."""
    if isinstance(data, dict):
        items = [(str(key), value) for key, value in data.items()]
    elif isinstance(data, list | tuple):
        items = [(str(place), value) for place, value in enumerate(data)]
    else:
        yield path, data
        return
    for key, value in items:
        yield from _values(value, f"{path}.{key}" if path else key)


def closest(word: str, known: list[str]) -> str:
    """Ask `did you mean X?` for a near miss, else list what is known."""
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
    shown = _shorten(value)
    what = f"`{path}` is {shown}" if path else f"the content is {shown}"
    wanted = [words for choice in (fault, *fault.get("also", ())) if (words := _wanted(choice))]
    if wanted:
        return f"{what}, it must be {' or '.join(wanted)}; change it."
    if kind == "string_pattern_mismatch":
        rule = _fields_at(record_type, fault["loc"][:-1])[fault["loc"][-1]].description
        return f"{what}, it must match {limits['pattern']} ({rule}); change it."
    if kind in ("union_tag_not_found", "union_tag_invalid"):
        key = f"{path}.{limits['discriminator'].strip(chr(39))}"
        if kind == "union_tag_not_found":
            return _missing_sentence([key])
        return f"`{key}` is {limits['tag']!r}, it must be one of {limits['expected_tags']}; change it."
    reason = fault["msg"].removeprefix("Value error, ")
    end = "" if reason.endswith((".", "?", "!")) else "."
    return f"`{path}` is {shown}: {reason[:1].lower()}{reason[1:]}{end}" if path else f"{reason}{end}"


def _wanted(fault: Any) -> str:
    """Say what a value must be, in words; empty where the fault is of another kind."""
    if fault["type"] == "literal_error":
        return str(fault["ctx"]["expected"])
    return _KIND_WORDS.get(fault["type"], "")


def _shorten(value: Any) -> str:
    """Return a value as it was written, its beginning if it is long."""
    text = repr(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."


def _path(fault: Any) -> str:
    return ".".join(str(part) for part in fault["loc"])


def _missing_sentence(paths: list[str]) -> str:
    names = ", ".join(f"`{path}`" for path in paths)
    return f"{names} is missing; add it." if len(paths) == 1 else f"{names} are missing; add them."


def _fields_at(record_type: type[BaseModel], path: tuple[Any, ...]) -> dict[str, Any]:
    fields, nested = record_type.model_fields, list[type[BaseModel]]()
    for part in path:
        if part in fields:
            nested = list(_records_in(fields[part].annotation))
            fields = nested[0].model_fields if nested else fields
        elif named := [t for t in nested if any(part in get_args(f.annotation) for f in t.model_fields.values())]:
            fields = named[0].model_fields  # a part says by a key of which kind it is, as `shape = "sphere"`
    return fields


def _records_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield the record types of which a value may be, or be made."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _records_in(inner)
