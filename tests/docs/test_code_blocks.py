"""Code of the documentation: commands parse, Python compiles, TOML parses. What runs is tested with its subject."""

import re
import shlex
import tomllib
from pathlib import Path

import pytest
from cyclopts.exceptions import CoercionError, CycloptsError, MissingArgumentError

from fast.flows.cli.main import app
from tests.docs.pages import DOCS, PAGES, ROOT, Block, blocks_of, name_of, prose_of

FIRST_CAMPAIGN = DOCS / "tutorial" / "first-campaign.md"


def words_of(line: str) -> list[str] | None:
    """Words and operators of a shell line; None where a quotation is still open."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars=True)
    lexer.whitespace_split = True
    try:
        return list(lexer)
    except ValueError:
        return None


def commands_of(text: str) -> list[list[str]]:
    """Words of every `fast` command in a shell block, without `fast` itself."""
    text = re.sub(r"<<'(\w+)'\n.*?^\1$", "", text, flags=re.M | re.S).replace("\\\n", " ")
    found, pending = [], ""
    for line in text.splitlines():
        pending += line + "\n"
        words = words_of(pending)
        if words is None:
            continue
        pending = ""
        command: list[str] = []
        for word in [*words, ";"]:
            if not set(word) <= set("();<>|&"):
                command.append(word)
                continue
            if command and command[0] == "fast":
                found.append(command[1:])
            command = []
    assert not pending, f"no closing quotation: {pending}"
    return found


def complaint_about(words: list[str], *, is_whole: bool = True) -> str | None:
    """What `fast` says against a command, which is parsed and not run.

    One that is not whole may lack arguments, and have a word like `ID` in place of a number.
    """
    try:
        app.parse_args(words, exit_on_error=False, print_error=False)
    except (MissingArgumentError, CoercionError) as error:
        return " ".join(str(error).split()) if is_whole else None
    except CycloptsError as error:
        return " ".join(str(error).split())
    return None


def complaints_in(page: Path) -> list[str]:
    """What is wrong with the commands in the shell blocks of a page."""
    commands = [command for block in blocks_of(page, "sh", "bash") for command in commands_of(block.text)]
    return [f"fast {shlex.join(words)}: {why}" for words in commands if (why := complaint_about(words))]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_parse(page: Path):
    assert complaints_in(page) == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_named_in_the_text_exist(page: Path):
    named = [words for code in re.findall(r"`(fast [a-z][^`\n]*)`", prose_of(page)) for words in commands_of(code)]
    wrong = [f"fast {shlex.join(words)}: {why}" for words in named if (why := complaint_about(words, is_whole=False))]
    assert wrong == []


def test_the_first_tutorial_needs_no_terminal_after_the_page_is_served():
    commands = [command for block in blocks_of(FIRST_CAMPAIGN, "sh") for command in commands_of(block.text)]
    assert [command[0] for command in commands] == ["doctor", "serve"]


def test_what_the_first_tutorial_presses_is_on_the_page():
    shown = "".join(path.read_text() for path in (ROOT / "flows" / "page").glob("*.html.j2"))
    bold = {" ".join(words.split()) for words in re.findall(r"\*\*([^*]+)\*\*", FIRST_CAMPAIGN.read_text())}
    pressed = {words for words in bold if not words.endswith(".")}  # not the head of a box
    assert len(pressed) >= 8
    assert sorted(words for words in pressed if words not in shown) == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_python_compiles(page: Path):
    for block in blocks_of(page, "python"):
        compile(block.text, name_of(page), "exec")


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_toml_parses(page: Path):
    for block in blocks_of(page, "toml"):
        tomllib.loads(block.text)


@pytest.mark.parametrize("words", ["campaign rn x", "sql --formt csv", "simulate --workers five", "nothing"])
def test_a_wrong_command_is_found(words: str):
    assert complaint_about(words.split()) is not None


def test_commands_are_found_in_shell():
    block = Block("sh", "fast sql - <<'SQL'\nSELECT 1\nSQL\nexport A=b  # fast\nfast a \\\n  b && fast c < d  # e\n")
    assert commands_of(block.text) == [["sql", "-"], ["a", "b"], ["c"]]
