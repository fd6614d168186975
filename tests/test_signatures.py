"""Signatures and records that read: no function takes eight arguments, every field of a wide record says what it is."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("flows", "hardware", "lake", "models", "tasks")
MOST = 7
_FREE = re.compile(r"(nb\.njit|intrinsic|app\.|flow\()")  # compiled kernels, commands, flows with their parameters
_COMMAND = re.compile(r'"fast\.([\w.]+):(\w+)"')  # a command that is loaded when it is asked for
_KNOWN = {"simulate_grasp"}  # what a grasp is made of, and how it is solved, each a record and by name


def product_files() -> Iterator[Path]:
    return (path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py")))


def count_arguments(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    given = function.args
    names = [one.arg for one in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return len([name for name in names if name not in ("self", "cls")])


def wide_functions(text: str) -> list[str]:
    """Names of the functions with too many arguments, free ones left out."""
    functions = (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
    return [
        one.name
        for one in functions
        if count_arguments(one) > MOST and not any(_FREE.match(ast.unparse(d)) for d in one.decorator_list)
    ]


def test_no_function_takes_eight_arguments() -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in product_files()}
    commands = {found.groups() for text in texts.values() for found in _COMMAND.finditer(text)}
    wide = {
        f"{path.relative_to(ROOT)}: {name}"
        for path, text in texts.items()
        for name in wide_functions(text)
        if name not in _KNOWN and (".".join(path.relative_to(ROOT).with_suffix("").parts), name) not in commands
    }
    assert not wide, f"more than {MOST} arguments; give what belongs together a frozen class of its own: {sorted(wide)}"


def test_what_is_wide_is_seen() -> None:
    eight = ", ".join(f"x{number}" for number in range(8))
    assert wide_functions(f"def f({eight}): ...") == ["f"]
    assert wide_functions(f"class A:\n    def f(self, {eight.removesuffix(', x7')}): ...") == []
    assert wide_functions(f"@nb.njit(cache=True)\ndef f({eight}): ...\n@app.command\ndef g(*, {eight}): ...") == []


WIDE = 8
_SAYS = re.compile(r"(description=|help=|_density\()")  # a field that says what it is in its own statement


def undescribed_fields(text: str) -> dict[str, list[str]]:
    """Names of the classes with many fields, and those of their fields that nothing is said of."""
    found = {}
    for node in (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ClassDef)):
        statements = [*node.body, ast.Pass()]
        fields = {
            one.target.id: bool(_SAYS.search(ast.unparse(one))) or is_text(after)
            for one, after in zip(statements, statements[1:], strict=False)
            if isinstance(one, ast.AnnAssign)
            and isinstance(one.target, ast.Name)
            and "ClassVar" not in ast.unparse(one.annotation)
        }
        if len(fields) >= WIDE and (silent := [name for name, is_said in fields.items() if not is_said]):
            found[node.name] = silent
    return found


def is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def test_every_field_of_a_wide_record_says_what_it_is() -> None:
    silent = {
        f"{path.relative_to(ROOT)}: {name}": fields
        for path in product_files()
        for name, fields in undescribed_fields(path.read_text(encoding="utf-8")).items()
    }
    assert not silent, f"write one line under each of these fields: {silent}"


def test_what_says_nothing_is_seen() -> None:
    fields = "\n".join(f'    x{number}: int\n    """One."""' for number in range(7))
    assert undescribed_fields(f"class A:\n{fields}\n    last: int = Field(ge=0)\n") == {"A": ["last"]}
    assert undescribed_fields(f'class A:\n{fields}\n    last: int = Field(description="One.")\n') == {}
