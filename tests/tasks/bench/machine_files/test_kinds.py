"""Kinds of files that programs of testing machines write, each read by the format that is guessed from it."""

import io
import re
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from fast.models.errors import FastError, MissingDependencyError, UsageError
from fast.tasks.bench.machine_files import grid
from fast.tasks.bench.machine_files.format import MachineFormat
from fast.tasks.bench.machine_files.guess import guess_format, parse_format
from fast.tasks.bench.machine_files.numbers import Marks, find_marks
from fast.tasks.bench.machine_files.pulls import Pulls, read_pulls
from fast.tasks.bench.machine_files.split import split_pulls

N = 40
TIME_S = np.arange(N) / 10
LIFT_MM = np.arange(N) / 2
FORCE_N = np.round(8 * np.sin(np.pi * np.arange(N) / (N - 1)), 4)
SAMPLES = list(zip(TIME_S, LIFT_MM, FORCE_N, strict=True))
PEAK_N = float(FORCE_N.max())


def table(separator: str = ",", decimal: str = ".", n: int = N, scale: float = 1.0) -> str:
    """Samples of one pull: time in s, lift in mm, force in N."""
    rows = zip(TIME_S[:n], LIFT_MM[:n], scale * FORCE_N[:n], strict=True)
    return "".join(separator.join(f"{value:.4f}" for value in row).replace(".", decimal) + "\n" for row in rows)


def read(folder: Path, content: str | bytes, name: str = "B01T0_2.csv") -> Pulls:
    path = folder / name
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_pulls([path], parse_format(guess_format([path]), "guess"))


def peaks(found: Pulls) -> list[float]:
    return [round(float(grasp.trace.force_n.max()), 3) for grasp in found.grasps]


GERMAN = "Prüfer;Änne\n\nPrüfzeit;Standardweg;Standardkraft\ns;mm;N\n" + table(";", ",")
BLANKS = "Time (s)   Test Extension (mm)   Load (N)\n" + table("     ")
NARROW = "Time (s) Extension (mm) Load (N)\n" + table(" ")
MESUR = (
    "11/27/2026  9:05 AM\nUnits: N\nReadings: Continuous\nX-Axis: Travel\nTravel Unit: mm\n" + "Time\tTravel\tLoad\n"
)
RESULTS = "Number,Peak,Work\n,N,J\n1,6.1,0.05\n2,5.9,0.04\n3,6.0,0.05\n4,6.0,0.05\n\n"
PLAIN = "Time,Extension,Load\n(s),(mm),(N)\n"


@pytest.mark.parametrize(
    "content",
    [
        GERMAN.encode("cp1252"),
        GERMAN.encode("utf-16-le"),
        GERMAN.encode("utf-16-be").replace(b"\0\n", b"\0\r"),
        BLANKS,
        NARROW,
        "Time  Axial Displacement  Axial Force\ns     mm        N\n" + table("  "),
        MESUR + table("\t"),
        RESULTS + PLAIN + table(),
        PLAIN + table() + "\n" + RESULTS + "\x1a",
        PLAIN + table() + "Maximum,19.5,8\n",
        PLAIN + table() + "\nPeak,Work,Stiffness\n8,0.1,0.5\n",
        "Time,Strain,Stress,Extension,Load\n(s),(%),(MPa),(mm),(N)\n"
        + "".join(f"{t},{x / 50:.3f},{f:.3f},{x},{f}\n" for t, x, f in SAMPLES),
        "時間,ｽﾄﾛｰｸ,試験力\nsec,mm,N\n".encode("cp932") + table().encode(),
        "时间,位移,负荷\n(s),(mm),(N)\n".encode("gb18030") + table().encode(),
        "Temps;Déplacement;Charge\n(s);(mm);(N)\n" + table(";", ","),
        "Zeit (hh:mm:ss);Weg [mm];Kraft [N]\n"
        + "".join(f"23:59:{58 + t:06.3f};{x};{f}\n".replace("23:59:6", "00:00:0") for t, x, f in
                  SAMPLES),
        "Time,Extension,Load\n(s),(mm),(N)\n" + table(n=20) + "\nTime,Extension,Load\n(s),(mm),(N)\n"
        + "".join(table().splitlines(True)[20:]),
    ],
    ids=["zwick", "utf-16-le", "lone-cr", "blanks", "one-blank", "mts-793", "mesur", "results-above", "results-below",
         "word-below", "numbers-below", "strain", "japanese", "chinese", "french", "midnight", "pages"],
)  # fmt: skip
def test_one_pull(tmp_path: Path, content: str | bytes) -> None:
    (grasp,) = read(tmp_path, content).grasps
    assert grasp.trace.lift_mm == pytest.approx(LIFT_MM)
    assert grasp.trace.time_s - grasp.trace.time_s[0] == pytest.approx(TIME_S)
    assert grasp.trace.force_n == pytest.approx(FORCE_N, abs=1e-3)


def beside(*tables: str) -> str:
    """Tables side by side; shorter ones end in empty cells."""
    lines = [text.splitlines() for text in tables]
    longest = max(map(len, lines))
    return "".join(",".join(part[i] if i < len(part) else ",," for part in lines) + "\n" for i in range(longest))


STACKED = PLAIN + table() + "\n" + PLAIN + table(n=25, scale=0.5) + "\n" + PLAIN + table(scale=0.7)
THERE_AND_BACK = "".join(
    f"{n},{x},{f}\n"
    for n, (x, f) in enumerate(zip([*LIFT_MM, *LIFT_MM[::-1]] * 3, [*FORCE_N, *(0 * FORCE_N - 30)] * 3, strict=True))
)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (STACKED, [PEAK_N, round(0.5 * PEAK_N, 3), round(0.7 * PEAK_N, 3)]),
        (beside(PLAIN + table(), PLAIN + table(n=25, scale=0.5)), [PEAK_N, round(0.5 * PEAK_N, 3)]),
        (PLAIN + table() + table(scale=0.5), [PEAK_N, round(0.5 * PEAK_N, 3)]),
        (PLAIN + THERE_AND_BACK, [PEAK_N] * 3),
        ("Speed (mm/s),5\nExtension (mm),Load (N)\n" + THERE_AND_BACK, [PEAK_N] * 3),
    ],
    ids=["stacked", "side-by-side", "joined", "there-and-back", "speed"],
)
def test_several_pulls(tmp_path: Path, content: str, expected: list[float]) -> None:
    if content.startswith("Speed"):
        content = "".join(line.split(",", 1)[1] if line[0].isdigit() else line for line in content.splitlines(True))
    found = read(tmp_path, content)
    assert peaks(found) == pytest.approx(expected, abs=1e-3)
    assert [grasp.repeat for grasp in found.grasps] == list(range(len(expected)))
    for grasp in found.grasps:
        assert grasp.trace.time_s[0] == 0.0
        assert np.diff(grasp.trace.time_s).min() > 0


def test_each_sheet_of_a_spreadsheet_is_a_pull(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["Results", "F max", 8.0])
    for name in ("Specimen 1", "Specimen 2"):
        sheet = book.create_sheet(name)
        for line in (PLAIN + table()).splitlines():
            sheet.append([float(cell) if cell[0].isdigit() else cell for cell in line.split(",")])
    out = io.BytesIO()
    book.save(out)
    assert peaks(read(tmp_path, out.getvalue(), "B01T0_2.xlsx")) == pytest.approx([PEAK_N] * 2, abs=1e-3)


def other(names: str, units: str, order: tuple[int, int, int] = (0, 1, 2), scale: float = 1.0) -> str:
    """A pull of 0.5 of the usual force below a head of its own."""
    rows = [line.split(",") for line in table(scale=0.5 * scale).splitlines()]
    return f"{names}\n{units}\n" + "".join(",".join(row[i] for i in order) + "\n" for row in rows)


OTHERS = {
    "unit": other("Time,Extension,Load", "(s),(mm),(kgf)", scale=1 / 9.80665),
    "unit-in-names": other("Time (s),Extension (mm),Load (kgf)", ",,", scale=1 / 9.80665),
    "order": other("Time,Load,Extension", "(s),(N),(mm)", (0, 2, 1)),
    "names": other("Time,Travel,Force", "s,mm,N"),
    "wider": other("Time,No,Travel,Force", "(s),-,(mm),(N)", (0, 0, 1, 2)),
}
SUMMARY = "No,Extension at maximum (mm),Maximum Load (N)\n" + "".join(
    f"{n},{12 + 5 * (n * 7 % 5)}.5,{6 + n % 3}.25\n" for n in range(30)
)


def write_sheets(**sheets: str) -> bytes:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, text in sheets.items():
        sheet = book.create_sheet(name)
        for line in text.splitlines():
            sheet.append([float(cell) if cell[:1].isdigit() else cell for cell in line.split(",")])
    out = io.BytesIO()
    book.save(out)
    return out.getvalue()


def read_as_is(folder: Path, content: str | bytes, machine: str = "") -> Pulls:
    """The pulls of a file by what it says itself, or by what a format file says."""
    path = folder / ("B01T0_2.csv" if isinstance(content, str) else "B01T0_2.xlsx")
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_pulls([path], parse_format('file_name = "{tool}_{object}.*"\n' + machine, "utm.toml"))


@pytest.mark.parametrize("text", OTHERS.values(), ids=OTHERS)
def test_each_head_says_what_is_below_it(tmp_path: Path, text: str) -> None:
    usual = PLAIN + table()
    for tables, shares in (
        ([usual, text], [1, 0.5]),
        ([text, usual], [0.5, 1]),
        ([usual, text, usual, SUMMARY], [1, 0.5, 1]),
    ):
        below = "\n".join(f"Specimen {n}\n{part}" for n, part in enumerate(tables))
        sheets = write_sheets(**{f"Sheet {n}": part for n, part in enumerate(tables)}, Notes="", Summary=SUMMARY)
        for content in (below, sheets):
            found = read_as_is(tmp_path, content)
            assert peaks(found) == pytest.approx([share * PEAK_N for share in shares], abs=2e-3)
            assert [grasp.repeat for grasp in found.grasps] == list(range(len(shares)))
            for grasp in found.grasps:
                assert grasp.trace.lift_mm == pytest.approx(LIFT_MM)


@pytest.mark.parametrize(
    ("kind", "machine", "words"),
    [
        ("unit", '[force]\nname = "Load"\nunit = "N"', r"the force is in kgf, the format file says N.*row 48 on"),
        ("names", '[force]\nname = "Load"', r"no column `Load`.*row 48 on below `Time \(s\), Travel \(mm\), Force"),
        ("order", '[lift]\nnumber = 2\nunit = "mm"', "heads that differ, and the format file counts columns"),
    ],
)
def test_a_head_that_the_format_file_does_not_fit_is_refused_by_its_place(
    tmp_path: Path, kind: str, machine: str, words: str
) -> None:
    with pytest.raises(UsageError, match=words) as refused:
        read_as_is(tmp_path, "Specimen 1\n" + PLAIN + table() + "\nSpecimen 2\n" + OTHERS[kind], machine)
    assert "\n" not in str(refused.value)
    with pytest.raises(UsageError, match="of sheet `Second` from row 3 on"):
        read_as_is(tmp_path, write_sheets(First=PLAIN + table(), Second=OTHERS[kind]), machine)


def test_a_unit_in_the_lines_above_a_head_is_that_of_its_samples(tmp_path: Path) -> None:
    names = "X-Axis,Travel\nTravel Unit,mm\nTime (s),Travel,Load\n"
    text = "Units: N\n" + names + table() + "\nUnits: kgf\n" + names + table(scale=0.5 / 9.80665)
    assert peaks(read_as_is(tmp_path, text)) == pytest.approx([PEAK_N, 0.5 * PEAK_N], abs=2e-3)


def test_a_head_without_units_has_those_of_the_others_if_they_agree(tmp_path: Path) -> None:
    bare = "\nTime,Extension,Load\n" + table(scale=0.5)
    assert peaks(read_as_is(tmp_path, PLAIN + table() + bare)) == pytest.approx([PEAK_N, 0.5 * PEAK_N], abs=1e-3)
    with pytest.raises(UsageError, match="does not say the unit of the force.*from row 89 on"):
        read_as_is(tmp_path, PLAIN + table() + "\n" + OTHERS["unit"] + "\n" + bare)


def test_a_gauge_that_writes_the_unit_beside_each_number(tmp_path: Path) -> None:
    path = tmp_path / "B01T0_2_0.csv"
    path.write_text(
        "0.1\n2026,11,27,09,05,00\n" + "".join(f"{f},N,{x},mm\n" for f, x in zip(FORCE_N, LIFT_MM, strict=True))
    )
    text = 'lift_speed_mm_per_s = 5\n[force]\nnumber = 1\nunit = "N"\n[lift]\nnumber = 3\nunit = "mm"'
    (grasp,) = read_pulls([path], parse_format(text, "gauge")).grasps
    assert grasp.trace.force_n == pytest.approx(FORCE_N)
    assert grasp.trace.time_s == pytest.approx(TIME_S)


def eaten(value: float) -> str:
    """What a spreadsheet of a country with decimal commas makes of `0.75`, `1.5` and `12.25`."""
    return f"{value:.4f}".rstrip("0").replace(".", "").lstrip("0") or "0"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (PLAIN + "".join(f"{t},{eaten(x * 0.37)},{eaten(f)}\n" for t, x, f in SAMPLES),
         "jump between whole numbers, as where a spreadsheet took decimal marks"),
        (PLAIN + table().replace(".", ""), "the lift goes over 195,000 mm in whole numbers"),
        (PLAIN + table(decimal=","), "has 3 columns and 6 cells in a row: decimal marks and separators are the same"),
        (PLAIN + table().replace("1.0000,5.0000,", "1.0000,OVER,"), "row 13 has `OVER`, which is no number"),
        (PLAIN + table().replace("1.0000,5.0000,", "***,OVER,"), "row 13 has `"),
        (PLAIN.replace("Load", "Torque").replace("(N)", "(Nm)") + table(), "which column is the force cannot be told"),
        (PLAIN + "".join(f"{n},,{n}\n" for n in range(20)), "which column is the lift|has no numbers"),
    ],
    ids=["eaten", "all-eaten", "comma-comma", "over", "over-twice", "torque", "empty"],
)  # fmt: skip
def test_what_would_be_read_wrongly_is_refused(tmp_path: Path, content: str, words: str) -> None:
    with pytest.raises(UsageError, match=words) as refused:
        read(tmp_path, content)
    assert "\n" not in str(refused.value)
    assert "nothing was written" in str(refused.value)


def test_whole_thousands_beside_decimals(tmp_path: Path) -> None:
    rows = "".join(f'{t},{x},"{1000 + 10 * n:,}"\n' for n, (t, x) in enumerate(zip(TIME_S, LIFT_MM, strict=True)))
    assert peaks(read(tmp_path, PLAIN + rows)) == [1390.0]


def test_noise_of_whole_numbers_is_no_lost_mark(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    force_mn = np.where(np.arange(400) < 40, 150 * np.arange(400), rng.integers(-12, 12, 400))
    rows = "".join(f"{n / 10},{n / 10},{f}\n" for n, f in enumerate(force_mn))
    assert peaks(read(tmp_path, PLAIN.replace("(N)", "(mN)") + rows)) == [5.85]


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("B01T0_2_1.csv", 'file_name = "{tool}_{object}_{repeat}.csv"'),
        ("run7_pull_b01t0-object2-r1_2026-11-27.txt", 'file_name = "run*_{tool}-object{object}-r{repeat}_*-*-*.txt"'),
        ("B01T0_2_1.is_tens_RawData/Specimen_RawData_3.csv", 'program = "bluehill"'),
        ("B01T0_2_1/specimen.dat", 'program = "mts-793"'),
        ("B01T0_2_1/data.csv", 'file_name = "{tool}_{object}_{repeat}/data.csv"'),
        ("stiff one_2_1.csv", 'file_name = "{tool}_{object}_{repeat}.csv"'),
    ],
)
def test_the_name_of_a_file_says_which_grasp_it_is(tmp_path: Path, name: str, line: str) -> None:
    path = tmp_path / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(PLAIN + table())
    names = ["stiff one"]
    text = guess_format([path], names)
    assert line in text.splitlines()[1]
    (grasp,) = read_pulls([path], parse_format(text, "guess"), names).grasps
    assert (grasp.object_id, grasp.repeat) == (2, 1)
    assert grasp.tool_id.lower() in ("b01t0", "pull/b01t0", "stiff one")


def test_a_folder_is_searched_and_repeats_may_begin_with_one(tmp_path: Path) -> None:
    for number in (1, 2):
        path = tmp_path / "B01T0_2.is_tens_RawData" / f"Specimen_RawData_{number}.csv"
        path.parent.mkdir(exist_ok=True)
        path.write_text(PLAIN + table(scale=number))
    name = "{tool}_{object}.is_*_RawData/Specimen_RawData_{repeat}.csv"
    found = read_pulls([tmp_path], MachineFormat(file_name=name, first_repeat=1))
    assert {grasp.repeat: round(grasp.force_n / PEAK_N) for grasp in found.grasps} == {0: 1, 1: 2}
    with pytest.raises(UsageError, match="has no file like `.*bluehill|has no file like"):
        read_pulls([tmp_path], MachineFormat(file_name="{tool}_{object}_{repeat}.txt"))
    with pytest.raises(UsageError, match="the repeat is 1, the first one is 2"):
        read_pulls([tmp_path], MachineFormat(file_name=name, first_repeat=2))


def test_a_table_of_files_names_objects(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(PLAIN + table())
    (tmp_path / "files.csv").write_text("file,tool,object,repeat\na.csv,stiff,large sphere,1\n")
    text = guess_format([tmp_path])
    assert "files.csv says which file is which grasp" in text
    (grasp,) = read_pulls([tmp_path], parse_format(text, "guess")).grasps
    assert (grasp.tool_id, grasp.object_id, grasp.repeat) == ("stiff", 2, 1)
    (tmp_path / "files.csv").write_text("file,tool,object,repeat\nb.csv,stiff,2,1\n")
    with pytest.raises(FastError, match="cannot be read"):
        read_pulls([tmp_path], MachineFormat())


def test_notes_of_many_files_are_one_line(tmp_path: Path) -> None:
    for number in range(8):
        (tmp_path / f"B01T0_2_{number}.csv").write_text(PLAIN + table() + "\nEnd of test\n")
    assert read_pulls([tmp_path], MachineFormat()).notes == ["in 8 files: 8 rows below the samples were left out"]


def test_a_spreadsheet_without_its_library_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(MissingDependencyError, match="is a spreadsheet.*pip install openpyxl, or save it as CSV"):
        read(tmp_path, b"PK\x03\x04", "B01T0_2.xlsx")


def test_a_spreadsheet_that_unpacks_to_very_much_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("openpyxl")
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/worksheets/sheet1.xml", bytes(3_000_000))
    monkeypatch.setattr(grid, "LARGEST_MB", 0.1)
    with pytest.raises(UsageError, match="unpacks to 3 MB, which no file of pulls does"):
        read(tmp_path, out.getvalue(), "B01T0_2.xlsx")


def test_a_column_counts_pulls_that_nothing_else_parts() -> None:
    lift_mm = np.tile(np.arange(20) / 2, 2)
    assert split_pulls(lift_mm, np.repeat([1.0, 2.0], 20)) == ([slice(0, 20), slice(20, 40)], 0)
    assert split_pulls(np.arange(40) / 2, np.repeat([1.0, 2.0], 20)) == ([slice(0, 20), slice(20, 40)], 0)
    assert split_pulls(np.array([])) == ([], 0)


def test_heads_between_pulls_are_not_counted_as_left_out(tmp_path: Path) -> None:
    assert read(tmp_path, STACKED).notes == []
    assert read(tmp_path, STACKED + "\nEnd\n").notes == ["B01T0_2.csv: 1 rows below the samples were left out"]


def test_a_comma_before_three_digits_is_what_a_person_says() -> None:
    assert find_marks(["1,009", "2,500"]) == Marks(".", ",")
    assert find_marks(["1,009", "2,500"], ",") == Marks(",")
    assert find_marks(["0,009", "2,500"]) == Marks(",")


def rows(*columns, separator: str = ",") -> str:
    """Cells of these columns, numbers with four decimals."""
    return "".join(
        separator.join(cell if isinstance(cell, str) else f"{cell:.4f}" for cell in row) + "\n"
        for row in zip(*columns, strict=True)
    )


DAY = [f"2026-11-28T23:59:5{8 + k // 20}.{k % 20 * 5:02d}0Z" for k in range(N)]  # a sample each 50 ms
CYRILLIC = "Время, с;Перемещение, мм;Нагрузка, Н\n" + table(";", ",")


@pytest.mark.parametrize(
    ("content", "last_s"),
    [
        ("t [s],pos [mm],F [N]\n" + rows(TIME_S, -LIFT_MM, -FORCE_N), 3.9),
        ("Time (s),Position (mm),Load (N)\n" + rows(TIME_S, 312.4 - LIFT_MM, FORCE_N), 3.9),
        ("timestamp,crosshead_mm,load_N\n" + rows(DAY, LIFT_MM, FORCE_N), 1.95),
        ("time,position,force\n" + rows(1.764e9 + TIME_S, LIFT_MM, FORCE_N), 3.9),
        ("X_Value\tForce (N)\tPosition (mm)\tComment\n" + rows(TIME_S, FORCE_N, LIFT_MM, separator="\t"), 3.9),
        ("# gauge: any\n# t_s lift_mm force_N\n" + rows(TIME_S, LIFT_MM, FORCE_N, separator=" "), 3.9),
        ("#,Time (s),Weg (mm),Kraft (N)\n" + rows(np.arange(N), TIME_S, LIFT_MM, FORCE_N), 3.9),
        (CYRILLIC.encode("cp1251"), 3.9),
        (CYRILLIC.encode(), 3.9),
    ],
    ids=["down", "from above", "of the day", "since 1970", "LabVIEW", "numpy", "counted", "cp1251", "Cyrillic"],
)
def test_files_of_other_programs_are_read(tmp_path: Path, content: str | bytes, last_s: float) -> None:
    (grasp,) = read(tmp_path, content).grasps
    assert grasp.trace.force_n.max() == pytest.approx(PEAK_N, abs=1e-3)
    assert (grasp.trace.lift_mm[0], grasp.trace.lift_mm[-1]) == pytest.approx((0.0, LIFT_MM[-1]))
    assert (grasp.trace.time_s[0], grasp.trace.time_s[-1]) == pytest.approx((0.0, last_s), abs=1e-6)


def test_units_that_stand_beside_each_number_tell_the_columns(tmp_path: Path) -> None:
    content = "Reading,Units,Travel,Units\n" + rows(FORCE_N, ["N"] * N, LIFT_MM, ["mm"] * N)
    with pytest.raises(UsageError, match="neither times nor the speed of the lift"):
        read(tmp_path, content)
    found = read_pulls(
        [tmp_path / "B01T0_2.csv"], MachineFormat(file_name="{tool}_{object}.csv", lift_speed_mm_per_s=5.0)
    )
    assert peaks(found) == [round(PEAK_N, 3)]
    assert found.grasps[0].trace.time_s[-1] == pytest.approx(LIFT_MM[-1] / 5.0)


@pytest.mark.parametrize(
    ("cell", "words"),
    [
        ("{:.1f} mN", "give numbers alone, all in one unit, which stands in the head, like `Load (mN)`"),
        ("OL", "row 2 has `OL`, which is no number; nothing was written: correct it."),
    ],
)
def test_a_cell_that_is_no_number_has_its_remedy(tmp_path: Path, cell: str, words: str) -> None:
    with pytest.raises(UsageError, match=re.escape(words)):
        read(tmp_path, "Time (s),Extension (mm),Load (N)\n" + rows(TIME_S, LIFT_MM, [cell.format(f) for f in FORCE_N]))


@pytest.mark.parametrize("name", ["Peak Load", "Max Force", "Spitzenkraft"])
def test_the_force_is_taken_before_its_peak_so_far(tmp_path: Path, name: str) -> None:
    held_n = [float(value) for value in np.maximum.accumulate(FORCE_N)]
    found = read(tmp_path, f"Time (s),Extension (mm),{name} (N),Load (N)\n" + rows(TIME_S, LIFT_MM, held_n, FORCE_N))
    assert found.grasps[0].trace.force_n == pytest.approx(FORCE_N)


def test_a_sheet_of_numbers_without_a_head_is_left_out_with_a_word(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in [("Time (s)", "Extension (mm)", "Load (N)"), *SAMPLES]:
        book.active.append([cell if isinstance(cell, str) else float(cell) for cell in row])
    sheet = book.create_sheet("second")
    for row in SAMPLES:
        sheet.append([float(cell) for cell in row])
    out = io.BytesIO()
    book.save(out)
    found = read(tmp_path, out.getvalue(), "B01T0_2.xlsx")
    assert peaks(found) == [round(PEAK_N, 3)]
    assert found.notes == ["B01T0_2.xlsx: 40 rows of numbers of sheet `second` have no head and were left out"]


def test_a_sample_that_is_no_number_to_the_program_is_left_out_and_counted(tmp_path: Path) -> None:
    forces = ["NaN" if k in (7, 8) else f"{force_n:.4f}" for k, force_n in enumerate(FORCE_N)]
    found = read(tmp_path, PLAIN + rows(TIME_S, LIFT_MM, forces))
    assert len(found.grasps[0].trace.time_s) == N - 2
    assert found.notes == ["B01T0_2.csv: 2 samples lack a number and were left out"]
