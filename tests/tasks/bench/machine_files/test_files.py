"""Files that other people's programs wrote: read as they are, or refused in one sentence."""

import csv
import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fast.models.errors import FastError
from fast.tasks.bench.machine_files.format import MachineFormat, read_format
from fast.tasks.bench.machine_files.guess import guess_format
from fast.tasks.bench.machine_files.numbers import Marks, find_marks, read_number
from fast.tasks.bench.machine_files.pulls import Pulls, read_pulls
from fast.tasks.bench.machine_files.words import quantity_of_name, split_unit
from tests.flows.cli.cli_lakes import ROOT

CASES = ROOT / "tests" / "data" / "cases"


def read_guessed(path: Path, folder: Path) -> Pulls:
    """The pulls of a file by the format that is guessed from it."""
    (folder / "guessed.toml").write_text(guess_format([path]))
    return read_pulls([path], read_format(folder / "guessed.toml"))


@pytest.mark.parametrize(
    ("name", "peaks_n", "n_samples", "note"),
    [
        ("machine-comma-comma/B01T0_2_0.csv", [6.0], 200, ""),
        ("machine-folders/B01T0_2_0.is_tens_RawData/Specimen_RawData_1.csv", [6.0], 200, ""),
        ("machine-summary/B01T0_2_0.csv", [6.0], 200, "2 rows below the samples were left out"),
        ("machine-thousands/B01T0_2_0.csv", [1506.0], 160, ""),
        ("machine-no-header/B01T0_2_0.csv", [6.0], 160, ""),
        ("machine-cycles/B01T0_2.csv", [6.0, 5.8, 5.9], None, "samples of the way back were left out"),
    ],
)
def test_a_file_is_read_by_the_format_that_is_guessed_from_it(tmp_path, name, peaks_n, n_samples, note):
    found = read_guessed(CASES / name, tmp_path)
    assert [round(grasp.force_n, 1 if grasp.force_n < 100 else 0) for grasp in found.grasps] == peaks_n
    assert [grasp.repeat for grasp in found.grasps] == list(range(len(peaks_n)))
    assert {(grasp.tool_id, grasp.object_id) for grasp in found.grasps} == {("B01T0", 2)}
    assert note in " ".join(found.notes)
    assert bool(found.notes) == bool(note)
    if n_samples is not None:
        assert len(found.grasps[0].trace.force_n) == n_samples


def test_one_pull_by_its_name_with_several_in_the_file_is_refused(tmp_path):
    path = tmp_path / "B01T0_2_0.csv"
    path.write_bytes((CASES / "machine-cycles" / "B01T0_2.csv").read_bytes())
    with pytest.raises(FastError, match="has 3 pulls, its name says that it is one"):
        read_pulls([path], MachineFormat())
    assert 'file_name = "{tool}_{object}_*.csv"  # the file has 3 pulls' in guess_format([path])


def draw_pull(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Lift in mm and force in N of a made-up pull, 60 samples each: uneven steps, some noise, up to 1,500 N."""
    rng = np.random.default_rng(seed)
    lift_mm = np.concatenate([[0.0], np.cumsum(rng.uniform(0.2, 0.8, 59))])
    force_n = rng.uniform(5, 1500) * np.sin(np.pi * lift_mm / lift_mm[-1]) ** 2 + rng.normal(0, 0.5, 60)
    return np.round(lift_mm, 3), np.round(force_n, 3)


@given(
    separator=st.sampled_from([",", ";", "\t", "|"]),
    decimal=st.sampled_from([".", ","]),
    has_thousands=st.booleans(),
    names=st.sampled_from([("Time", "Extension", "Load"), ("Zeit", "Weg", "Kraft"), ("Temps", "Course", "Force"),
                           ("時間", "変位", "試験力"), ("Tempo", "Spostamento", "Carico"),
                           ("Tiempo", "Desplazamiento", "Fuerza"), ("时间", "位移", "负荷"), None]),
    unit=st.sampled_from([("N", 1.0), ("kN", 1e-3), ("lbf", 1 / 4.4482216152605), ("kgf", 1 / 9.80665)]),
    units_in=st.sampled_from(["names", "row"]),
    n_above=st.integers(0, 7),
    n_below=st.integers(0, 3),
    order=st.permutations([0, 1, 2]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le"]),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    seeds=st.lists(st.integers(0, 1000), min_size=1, max_size=3),
)  # fmt: skip
@settings(max_examples=80, deadline=None)
def test_whatever_the_dialect_the_numbers_are_those_that_were_written(
    tmp_path_factory, separator, decimal, has_thousands, names, unit, units_in, n_above, n_below, order, encoding, end,
    seeds,
):  # fmt: skip
    other = "," if decimal == "." else "."

    def say(value: float) -> str:
        text = f"{value:,.6f}" if has_thousands else f"{value:.6f}"
        return text.translate(str.maketrans({",": other, ".": decimal}))

    units = ("s", "mm", unit[0])
    rows = [[f"Setting {i}", "x"] for i in range(n_above)]
    if names is not None:
        head = [f"{name} ({u})" if units_in == "names" else name for name, u in zip(names, units, strict=True)]
        rows += [[head[i] for i in order]]
    rows += [[f"({units[i]})" for i in order]] if units_in == "row" or names is None else []
    pulls = [draw_pull(seed) for seed in seeds]
    lift_mm = np.concatenate([part for lift, _ in pulls for part in (lift, lift[-2::-1])])
    force_n = np.concatenate([part for _, force in pulls for part in (force, np.zeros(59))])
    columns = (np.arange(len(lift_mm)) / 10.0, lift_mm, force_n * unit[1])
    rows += [[say(columns[i][n]) for i in order] for n in range(len(lift_mm))]
    rows += [["Maximum", "6", ""] for _ in range(n_below)]
    out = io.StringIO()
    csv.writer(out, delimiter=separator, lineterminator=end).writerows(rows)
    folder = tmp_path_factory.mktemp("dialect")
    (folder / "B01T0_2.csv").write_bytes(out.getvalue().encode(encoding))
    grasps = read_guessed(folder / "B01T0_2.csv", folder).grasps
    assert [grasp.repeat for grasp in grasps] == list(range(len(pulls)))
    for grasp, (lift, force) in zip(grasps, pulls, strict=True):
        assert grasp.trace.lift_mm == pytest.approx(lift, abs=1e-6)
        assert grasp.trace.time_s - grasp.trace.time_s[0] == pytest.approx(np.arange(60) / 10.0, abs=1e-6)
        assert grasp.trace.force_n == pytest.approx(force, abs=1e-3)


TABLE = "Time (s),Extension (mm),Load (N)\n" + "".join(f"{i / 10},{i / 2},{i * (20 - i) / 10}\n" for i in range(21))
FORMAT = '[lift]\nname = "Extension"\n[force]\nname = "Load"\n'


def read_text(folder: Path, text: str | bytes, machine: str = '[time]\nname = "Time"\n' + FORMAT) -> Pulls:
    (folder / "utm.toml").write_text(machine)
    path = folder / "B01T0_2_0.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_pulls([path], read_format(folder / "utm.toml"))


def test_an_empty_cell_is_left_out_and_said(tmp_path):
    found = read_text(tmp_path, TABLE.replace("\n0.5,2.5,7.5\n", "\n0.5,2.5,\n"))
    assert len(found.grasps[0].trace.force_n) == 20
    assert found.notes == ["B01T0_2_0.csv: 1 samples lack a number and were left out"]


def test_times_of_hours_and_minutes_are_seconds(tmp_path):
    lines = TABLE.splitlines()
    clock = [lines[0], *(f"00:01:{float(line.split(',')[0]):06.3f}," + line.split(",", 1)[1] for line in lines[1:])]
    trace = read_text(tmp_path, "\n".join(clock)).grasps[0].trace
    assert trace.time_s[[0, -1]] == pytest.approx([60.0, 62.0])


@pytest.mark.parametrize(
    ("text", "time_s"),
    [
        ("12:00:01.5 AM", 1.5),
        ("11:59:59 am", 43199.0),
        ("12:00:00 PM", 43200.0),
        ("1:00:02,25 p.m.", 46802.25),
        ("11/30/2026 2:05 PM", 50700.0),
    ],
)
def test_a_clock_of_twelve_hours_is_read(text, time_s):
    assert read_number(text, Marks(".")) == pytest.approx(time_s)


def test_a_speed_that_the_file_says_gives_the_time(tmp_path):
    text = "Test speed,300,mm/min\n\n" + "\n".join(line.split(",", 1)[1] for line in TABLE.splitlines())
    assert read_text(tmp_path, text, FORMAT).grasps[0].trace.time_s[-1] == pytest.approx(2.0)
    with pytest.raises(FastError, match="says neither times nor the speed of the lift"):
        read_text(tmp_path, text.split("\n\n")[1], FORMAT)


def test_decimal_marks_that_a_spreadsheet_ate_are_said(tmp_path):
    eaten = "Time (s),Extension,Load\n" + "".join(f"{i},{f'{i * 0.25:g}'.replace('.', '')},5\n" for i in range(1, 40))
    with pytest.raises(FastError, match="as where a spreadsheet took decimal marks"):
        read_text(tmp_path, eaten.replace("Load", "Load (N)").replace("Extension", "Extension (mm)"))


def test_a_small_table_says_which_file_is_which_grasp(tmp_path):
    (tmp_path / "run 7.csv").write_text(TABLE)
    (tmp_path / "files.csv").write_text("file,tool,object,repeat\nrun 7.csv,B01T3,14,1\n")
    (tmp_path / "utm.toml").write_text('[time]\nname = "time (S)"\n' + FORMAT)
    (grasp,) = read_pulls([tmp_path / "files.csv"], read_format(tmp_path / "utm.toml")).grasps
    assert (grasp.tool_id, grasp.object_id, grasp.repeat) == ("B01T3", 14, 1)


def test_a_spreadsheet_is_read(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for line in TABLE.splitlines():
        book.active.append([float(c) if c[0].isdigit() else c for c in line.split(",")])
    book.save(tmp_path / "B01T0_2_0.xlsx")
    assert read_guessed(tmp_path / "B01T0_2_0.xlsx", tmp_path).grasps[0].force_n == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "has no samples"),
        (b"Time,Extension,Load\n", "has no samples"),
        (b"\x00\x01\x02" * 400, "is no text and no spreadsheet"),
        (b"PK\x03\x04 torn", "spreadsheet"),
        (b"\xd0\xcf\x11\xe0 old", "old kind"),
        (b"Time (s),Extension (mm),Load (N)\n" + b"1,nan,inf\n" * 40, "has no samples"),
        (TABLE.replace("Extension", "Strain").encode(), "has no column `Extension`"),
        (TABLE.replace(" (N)", "").encode(), "does not say the unit of the force"),
        (b'"' + b"x" * 200_000, "no readable table|has no samples"),
    ],
)
def test_what_cannot_be_read_is_refused_in_a_sentence(tmp_path, content, words):
    with pytest.raises(FastError, match=words) as refused:
        read_text(tmp_path, content)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("cells", "marks"),
    [
        (["0.75", "1,009.3"], Marks(".", ",")),
        (["1.009,3", "2,5"], Marks(",", ".")),
        (["0,75", "12,5"], Marks(",")),
        (["12 345,6"], Marks(",", " ")),
        (["7", "8"], Marks(".")),
    ],
)
def test_marks_of_numbers(cells, marks):
    assert find_marks(cells) == marks
    assert read_number(cells[0], marks) is not None


def test_names_of_columns_and_units():
    assert split_unit("Load (N)") == ("Load", "N")
    assert split_unit("Kraft [kN]") == ("Kraft", "kN")
    assert split_unit("Force/N") == ("Force", "N")
    assert split_unit("Strain 1 (%)") == ("Strain 1 (%)", None)
    assert [quantity_of_name(name) for name in ("Standardkraft", "Compressive extension", "Strain", "Cycle count")] == [
        "force", "lift", None, None
    ]  # fmt: skip
