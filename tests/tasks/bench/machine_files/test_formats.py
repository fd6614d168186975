"""Files of a testing machine: units, decimals and headers as a small TOML file says, and what is wrong in words."""

from pathlib import Path

import numpy as np
import pytest

from fast.models.errors import FastError, UsageError
from fast.tasks.bench.machine_files.format import MachineFormat, read_format
from fast.tasks.bench.machine_files.pulls import read_pulls
from fast.tasks.bench.told import ToldGrasp

FORMAT = """
file_name = "{tool}_{object}_{repeat}.csv"
separator = ";"
decimal = ","
encoding = "latin-1"
skip_lines = 2
skip_after_header = 1
[time]
name = "Zeit"
unit = "ms"
[lift]
name = "Weg"
unit = "in"
zero = "first sample"
[force]
name = "Kraft"
unit = "kgf"
sign = -1
"""
PULL = "Prüfung;7\n\nZeit;Weg;Kraft;Rest\nms;in;kgf;-\n0;1,0;0,0;x\n500;1,1;-0,5;y\n1500;1,2;-1,25;z\n"


def write(folder: Path, text: str = PULL, name: str = "B02T3_14_1.csv", machine: str = FORMAT) -> tuple[Path, Path]:
    (folder / "utm.toml").write_text(machine)
    (folder / name).write_text(text, encoding="latin-1")
    return folder / name, folder / "utm.toml"


def read_pull(path: Path, machine: MachineFormat) -> ToldGrasp:
    (grasp,) = read_pulls([path], machine).grasps
    return grasp


def test_units_sign_zero_and_name_are_those_of_the_format(tmp_path: Path) -> None:
    path, machine = write(tmp_path)
    told = read_pull(path, read_format(machine))
    assert (told.tool_id, told.object_id, told.repeat) == ("B02T3", 14, 1)
    assert told.trace is not None
    assert told.trace.time_s == pytest.approx([0.0, 0.5, 1.5])
    assert told.trace.lift_mm == pytest.approx([0.0, 2.54, 5.08])
    assert told.trace.force_n == pytest.approx(np.array([0.0, 0.5, 1.25]) * 9.80665)


def test_without_a_time_the_lift_speed_gives_it(tmp_path: Path) -> None:
    no_time = FORMAT.replace('[time]\nname = "Zeit"\nunit = "ms"\n', "")
    path, machine = write(tmp_path, machine="lift_speed_mm_per_s = 2.54\n" + no_time)
    trace = read_pull(path, read_format(machine)).trace
    assert trace is not None
    assert trace.time_s == pytest.approx([0.0, 1.0, 2.0])


def test_a_campaign_may_stand_in_the_name(tmp_path: Path) -> None:
    path, machine = write(tmp_path, name="pull_B02T3_14_1.csv")
    assert read_pull(path, read_format(machine)).tool_id == "pull/B02T3"


@pytest.mark.parametrize(
    ("machine", "words"),
    [
        (FORMAT.replace('"kgf"', '"stone"'), "force.unit is `stone`; change it to one of N, mN"),
        (FORMAT.replace("{object}", ""), "{object} must stand in it once"),
        ("lift_speed_mm_per_s = 5\n" + FORMAT, "one of the two"),
        (FORMAT.replace('name = "Weg"', 'name = "Weg"\nnumber = 2'), "one of the two"),
        (FORMAT.replace("skip_lines", "skiplines"), "skip_lines"),
        ("separator = ", "utm.toml"),
    ],
)
def test_a_wrong_format_is_named(tmp_path: Path, machine: str, words: str) -> None:
    _, path = write(tmp_path, machine=machine)
    with pytest.raises(FastError, match=words):
        read_format(path)


@pytest.mark.parametrize(
    ("text", "name", "words"),
    [
        (PULL, "pull7.csv", "the name is not like"),
        (PULL.replace("Kraft", "Last"), "B02T3_14_1.csv", "has no column `Kraft`"),
        (PULL.replace("500;1,1;-0,5", "500;1,1;weg"), "B02T3_14_1.csv", "row 6 has `weg`, which is no number"),
        (PULL.replace("kgf;-", "lbf;-"), "B02T3_14_1.csv", "the force is in lbf, the format file says kgf"),
        ("", "B02T3_14_1.csv", "has no samples"),
    ],
)
def test_a_wrong_file_is_named(tmp_path: Path, text: str, name: str, words: str) -> None:
    path, machine = write(tmp_path, text, name)
    with pytest.raises(UsageError, match=words):
        read_pull(path, read_format(machine))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    path, machine = write(tmp_path)
    path.unlink()
    with pytest.raises(UsageError, match="cannot be read"):
        read_pull(path, read_format(machine))


def test_a_column_may_be_named_as_it_stands_in_the_file_with_its_unit(tmp_path: Path) -> None:
    machine = FORMAT.replace('"Zeit"', '"Zeit_ms"').replace('"Weg"', '"Weg [in]"').replace('"Kraft"', '"kraft/kgf"')
    text = PULL.replace("Zeit;Weg;Kraft;Rest\nms;in;kgf;-", "Zeit_ms;Weg [in];Kraft/kgf;Rest\n")
    path, format_path = write(tmp_path, text, machine=machine)
    trace = read_pull(path, read_format(format_path)).trace
    assert trace is not None
    assert trace.lift_mm == pytest.approx([0.0, 2.54, 5.08])
