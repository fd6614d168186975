"""The part of URScript that the arm's driver sends: one function of statements, one a line."""

import re
from dataclasses import dataclass

import numpy as np

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_MOVE = re.compile(rf"movel\(p\[((?:{_NUMBER}\s*,\s*){{5}}{_NUMBER})\]\s*,\s*a=({_NUMBER})\s*,\s*v=({_NUMBER})\)")
_STOP = re.compile(rf"stopl\(({_NUMBER})\)")
_OUTPUT = re.compile(r"set_standard_digital_out\(([0-7])\s*,\s*(True|False)\)")
_REGISTER = re.compile(r"write_output_integer_register\((\d+)\s*,\s*(-?\d+)\)")
_PROGRAM = re.compile(r"\A\s*def (\w+)\(\):\s*\n(.*)\n\s*end\s*\Z", re.DOTALL)


@dataclass(frozen=True)
class Move:
    """Go straight to a pose (x, y, z in m, rotation vector in rad) at a speed in m/s."""

    pose: np.ndarray
    speed_m_per_s: float


@dataclass(frozen=True)
class Stop:
    """End the motion."""


@dataclass(frozen=True)
class Output:
    """Switch a standard digital output."""

    number: int
    is_on: bool


@dataclass(frozen=True)
class Register:
    """Write an output integer register."""

    number: int
    value: int


Statement = Move | Stop | Output | Register


def read_program(text: str) -> list[Statement]:
    """Read the statements of a program.

    Raises:
        ValueError: it is no function, or a statement is not understood; a robot would show a message and do nothing.
    """
    program = _PROGRAM.match(text)
    if program is None:
        raise ValueError("the text is no function: it must be `def NAME():`, lines, `end`")
    return [_read_statement(line.strip()) for line in program[2].splitlines() if line.strip()]


def _read_statement(line: str) -> Statement:
    if found := _MOVE.fullmatch(line):
        return Move(np.array([float(value) for value in found[1].split(",")]), float(found[3]))
    if _STOP.fullmatch(line):
        return Stop()
    if found := _OUTPUT.fullmatch(line):
        return Output(int(found[1]), found[2] == "True")
    if found := _REGISTER.fullmatch(line):
        return Register(int(found[1]), int(found[2]))
    raise ValueError(f"`{line}` is not understood")
