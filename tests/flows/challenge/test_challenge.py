"""The challenge: what is written is what was measured, the same seed makes the same worlds, and faults are named."""

import csv
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from fast.flows.challenge.answers import LIFT_MM, list_asked
from fast.flows.challenge.grade import Graded, clopper_pearson, grade_answers, make_tables
from fast.flows.challenge.hidden.panel_file import PANEL
from fast.flows.challenge.hidden.worlds import Worlds
from fast.flows.challenge.keys import FILE, WITHHELD, find_keys, open_keys
from fast.flows.challenge.make import (
    SEED,
    draw_keys,
    find_withheld,
    make_challenge,
    open_worlds,
    read_seed,
)
from fast.flows.challenge.manifest import Manifest, read_families
from fast.flows.challenge.public import PUBLIC, make_template, start
from fast.flows.challenge.world_folder import read_world
from fast.flows.cli.main import run
from fast.models.errors import UsageError

Change = Callable[[dict[str, Any]], None]
SECRET = "sixteen letters and more"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A challenge of three worlds: nothing, a listed effect, another."""
    folder = tmp_path_factory.mktemp("challenge") / "worlds"
    make_challenge(SECRET, folder, 3)
    return folder


def answer(folder: Path, path: Path, change: Change = lambda _: None) -> Path:
    """A file of answers that says nothing, changed."""
    content = json.loads(json.dumps(make_template(folder)))
    change(content)
    path.write_text(json.dumps(content))
    return path


def draw_from(seed: str) -> Worlds:
    """Worlds of the public panel."""
    return open_worlds(seed, PANEL)


def test_the_public_set_is_small_whole_and_of_its_seed() -> None:
    manifest, keys = Manifest.read(PUBLIC), find_keys(PUBLIC)
    files = [file for folder in (PUBLIC, keys) for file in folder.rglob("*") if file.is_file()]
    assert len(manifest.worlds) == 12
    assert sum(file.stat().st_size for file in files) < 5e6
    sealed, _ = open_keys(keys, PUBLIC)
    seed = read_seed(keys / SEED)
    assert [one.key for one in draw_keys(draw_from(seed), seed, 12)] == [one.key for one in sealed]
    hidden = [name for one in sealed for name in one.key.names]
    assert len(hidden) == len(set(hidden)) == 8


def test_an_entrant_reads_what_the_lab_measured(made: Path) -> None:
    """Step means to the rounding of the files, contexts, bank, and nothing of the asked grasps."""
    sealed, withheld = open_keys(find_keys(made), made)
    panel = draw_from(SECRET)
    for key in sealed:
        given, problem = read_world(made, key.world), panel.problem(key.key)
        grasps, true = given.data.grasps, problem.grasps
        tool, obj = find_withheld(key.key, len(true.tools), len(true.objects))
        kept = np.flatnonzero((true.tool != tool) & (true.obj != obj))
        assert np.array_equal(grasps.tool, true.tool[kept])
        assert np.array_equal(grasps.obj, true.obj[kept])
        apart_n = grasps.steps_n - true.steps_n[kept]
        assert np.sqrt(np.mean(apart_n**2)) < 0.005
        assert np.abs(apart_n).max() < 0.1  # a hundredth of a millimetre where the force rises
        assert grasps.designs == true.designs
        for ours, theirs in zip(grasps.contexts, [true.contexts[row] for row in kept], strict=True):
            assert ours.model_copy(update={"clock_s": theirs.clock_s}) == theirs
            assert ours.clock_s == pytest.approx(theirs.clock_s, abs=0.01)
        assert np.allclose(given.data.bank.grid_steps_n, problem.bank.grid_steps_n, atol=1e-3, equal_nan=True)
        assert given.data.bank.effects.keys() == problem.bank.effects.keys()
        assert np.isnan(given.asked.steps_n).all()
        assert set(given.asked.grasp_ids) == set(withheld[key.world]) == set(list_asked(made / key.world))


def test_a_world_is_a_hand_off_folder(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["lake", "import", str(made / "w01"), "--lake", str(tmp_path / "lake"), "--dry-run"]) == 0
    assert "9 designs, 144 measured grasps" in capsys.readouterr().out


def test_a_seed_makes_the_same_worlds_and_another_makes_others(made: Path, tmp_path: Path) -> None:
    again = make_challenge(SECRET, tmp_path / "again", 3)
    assert again == Manifest.read(made)
    keys = [[one.key for one in draw_keys(draw_from(seed), seed, 3)] for seed in (SECRET, "another secret of mine")]
    assert keys[0] == [one.key for one in open_keys(find_keys(made), made)[0]]
    assert not {key.world_id for key in keys[0]} & {key.world_id for key in keys[1]}
    traces = [(folder / "w02" / "traces.parquet").read_bytes() for folder in (made, tmp_path / "again")]
    assert traces[0] == traces[1]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda a: a["answers"].pop(1), "w02 is not answered; answer each of the 3 worlds w01 to w03 once"),
        (lambda a: a["answers"].append(a["answers"][0]), "w01 is answered more than once"),
        (lambda a: a["answers"][2].update(world="w77"), "w77 is not of this challenge; w03 is not answered"),
        (lambda a: a.update(challenge="C123"), "answers challenge `C123`, but .* made from another seed"),
        (lambda a: a["answers"][0].update(missing="yes"), "`answers.0.missing` is 'yes', it must be true or false"),
        (lambda a: a["answers"][0].update(probability=1.4), "`answers.0.probability` is 1.4, it must be at most 1"),
        (lambda a: a["answers"][0].update(effect="stress_relax"), "w01, effect: .*did you mean `stress_relaxation`"),
        (
            lambda a: a["answers"][1].update(missing=False, effect="not listed"),
            "nothing is missing in w02 by `missing`, and an `effect` is by name; correct one of the two",
        ),
        (lambda a: a["answers"][0].update(effect="nonsense"), "known: [^.]*, not listed, object_edge"),
        (lambda a: a.update(answers=[]), "w01, w02, w03 are not answered"),
        (lambda a: a.pop("challenge"), "`challenge`"),
    ],
)
def test_faulty_answers_are_named_in_one_sentence(
    made: Path, tmp_path: Path, change: Change, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = answer(made, tmp_path / "answers.json", change)
    assert run(["challenge", "grade", str(path), "--challenge", str(made)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    with pytest.raises(UsageError, match=sentence):
        grade_answers(path, made)


def test_other_bad_input_is_named(made: Path, tmp_path: Path) -> None:
    path = answer(made, tmp_path / "answers.json")
    with pytest.raises(UsageError, match="is no folder of a challenge"):
        grade_answers(path, tmp_path)
    with pytest.raises(UsageError, match="give their folder as --keys"):
        grade_answers(path, made, tmp_path / "nowhere")
    with pytest.raises(UsageError, match="cannot be read"):
        grade_answers(tmp_path / "nowhere.json", made)
    (tmp_path / "text.json").write_text("{")
    with pytest.raises(UsageError, match="is not JSON"):
        grade_answers(tmp_path / "text.json", made)
    (tmp_path / "short").write_text("abc")
    with pytest.raises(UsageError, match="has 3 characters, too few for a secret"):
        read_seed(tmp_path / "short")
    with pytest.raises(UsageError, match="is there already"):
        make_challenge(SECRET, made, 3)
    with pytest.raises(UsageError, match="is no panel of true grasps"):
        make_challenge(SECRET, tmp_path / "worlds", 3, tmp_path / "text.json")
    with np.load(PANEL) as file:
        older = {name: file[name] for name in file.files}
    older["numerical_steps_n"] = older["numerical_steps_n"][:, :, :3]
    np.savez(tmp_path / "older.npz", **older)
    with pytest.raises(
        UsageError, match="has 3 numerical variants of each cell, that of this version 4; make the panel"
    ):
        make_challenge(SECRET, tmp_path / "worlds", 3, tmp_path / "older.npz")
    assert not (tmp_path / "worlds").exists()


def test_a_probability_that_contradicts_the_alarm_is_named(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def contradict(content: dict[str, Any]) -> None:
        content["answers"][0].update(missing=False, probability=0.99)
        content["answers"][1].update(missing=True, probability=0.01)

    path = answer(made, tmp_path / "answers.json", contradict)
    assert run(["challenge", "grade", str(path), "--challenge", str(made)]) == 0
    said = "contradict each other in w01 (missing: false, 0.99), w02 (missing: true, 0.01): alarms count by the one"
    assert said in capsys.readouterr().out


def test_a_changed_key_is_refused(made: Path, tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    keys.mkdir()
    for file in find_keys(made).iterdir():
        (keys / file.name).write_bytes(file.read_bytes())
    changed, n = re.subn(r'("young_modulus_mpa":)[\d.]+', r"\g<1>9.9", (keys / FILE).read_text())
    assert n == 3
    (keys / FILE).write_text(changed)
    with pytest.raises(UsageError, match="does not fit the hash"):
        open_keys(keys, made)


def test_hashes_that_were_changed_with_the_keys_are_refused(made: Path, tmp_path: Path) -> None:
    """Answers name the challenge, and its name is of its hashes."""
    folder = tmp_path / "worlds"
    shutil.copytree(made, folder)
    manifest = Manifest.read(folder)
    manifest.model_copy(update={"worlds": {**manifest.worlds, "w01": "0" * 64}}).write(folder)
    with pytest.raises(UsageError, match=f"not those that challenge {manifest.challenge} is named after"):
        open_keys(find_keys(made), folder)


@pytest.mark.parametrize("columns", [["world", "grasp_id"], ["world", "grasp_id", "lift_mm", "force_n"]])
def test_withheld_forces_that_are_cut_are_named(made: Path, tmp_path: Path, columns: list[str]) -> None:
    keys = tmp_path / "keys"
    shutil.copytree(find_keys(made), keys)
    pq.write_table(pq.read_table(keys / WITHHELD)[:-3].select(columns), keys / WITHHELD)
    with pytest.raises(UsageError, match=r"^the keys of .* cannot be read in .* give their folder as --keys\.$"):
        open_keys(keys, made)


def test_keys_are_found_from_within_the_folder(made: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(made / "w01")
    assert find_keys(Path("..")) == find_keys(made)
    monkeypatch.chdir(made)
    assert find_keys(Path(".")) == find_keys(made)


def test_answers_of_an_editor_that_marks_its_files_are_read(made: Path, tmp_path: Path) -> None:
    path = answer(made, tmp_path / "answers.json")
    path.write_text(path.read_text(), encoding="utf-8-sig")
    assert len(grade_answers(path, made)[1]) == 3


def test_foretold_forces_are_graded_and_faults_in_them_named(made: Path, tmp_path: Path) -> None:
    """Who foretells what was measured closes more than can be closed: the noise, too."""
    _, withheld = open_keys(find_keys(made), made)
    path = answer(made, tmp_path / "answers.json", lambda a: a.update(forces="forces.csv"))
    rows = [
        (world, name, lift_mm, force_n)
        for world, forces in withheld.items()
        for name, of_grasp in forces.items()
        for lift_mm, force_n in zip(LIFT_MM.tolist(), of_grasp.tolist(), strict=True)
    ]
    for kept, sentence in (
        (rows[len(LIFT_MM) :], "is not foretold"),
        ([(*rows[0][:2], 3.0, "x"), *rows], "row 2: "),
        ([*rows, *rows], "the lift goes back from 39.75 to 0.25 mm; give one curve of each grasp"),
        ([(*row[:2], row[2] / 1000.0, row[3]) for row in rows], "has forces from .* to 0.03975 mm of lift; give .* mm"),
    ):
        _write_forces(tmp_path / "forces.csv", kept)
        with pytest.raises(UsageError, match=sentence):
            grade_answers(path, made)
    _write_forces(tmp_path / "forces.csv", rows)
    _, graded = grade_answers(path, made)
    assert [one.after_n for one in graded] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert all(one.closed is None or one.closed > 1.0 for one in graded)


def _write_forces(path: Path, rows: list[tuple[Any, ...]]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("world", "grasp_id", "lift_mm", "force_n"))
        writer.writerows(rows)


def test_who_knows_the_keys_is_right_and_who_says_nothing_is_silent(tmp_path: Path) -> None:
    """On the public set: all right, sure, no false alarm; and nothing at all."""
    sealed, _ = open_keys(find_keys(PUBLIC), PUBLIC)
    families = read_families(PUBLIC)

    def know(content: dict[str, Any]) -> None:
        for one, key in zip(content["answers"], sealed, strict=True):
            names = key.key.names
            one["missing"], one["probability"] = bool(names), float(bool(names))
            one["effect"] = (names[0] if names[0] in families else "not listed") if names else ""

    knowing = _figures(grade_answers(answer(PUBLIC, tmp_path / "knows.json", know), PUBLIC)[1])
    silent = _figures(grade_answers(answer(PUBLIC, tmp_path / "silent.json"), PUBLIC)[1])
    assert knowing["false alarms where nothing is hidden"] == (0, 4)
    assert silent["false alarms where nothing is hidden"] == (0, 4)
    for cause in ("a listed cause", "a cause that is not listed"):
        k, n = knowing[f"alarm, {cause} of 2 % or more"]
        assert k == n > 0
        assert silent[f"alarm, {cause} of 2 % or more"] == (0, n)
    k, n = knowing["family right, given an alarm"]
    assert k == n > 0
    k, n = silent["“nothing” said at 4 % or more"]
    assert k == n > 0


def _figures(graded: list[Graded]) -> dict[str, tuple[int, int]]:
    return {row["figure"]: (row["seen"], row["worlds"]) for row in make_tables(graded)["figures"] if "seen" in row}


def test_intervals_hold_the_share() -> None:
    low, high = clopper_pearson(5, 10)
    assert (low, high) == pytest.approx((0.187, 0.813), abs=1e-3)
    assert clopper_pearson(0, 20)[0] == 0.0
    assert clopper_pearson(20, 20)[1] == 1.0


def test_start_gives_the_worlds_without_their_keys_and_answers_that_can_be_graded(tmp_path: Path) -> None:
    answers = start(tmp_path / "mine")
    assert Manifest.read(tmp_path / "mine") == Manifest.read(PUBLIC)
    assert not find_keys(tmp_path / "mine").exists()
    assert run(["challenge", "grade", str(answers)]) == 0
    assert run(["challenge", "grade", str(answers), "--challenge", str(tmp_path / "mine")]) == 0
    for there in (tmp_path / "mine", Path("."), Path("/")):
        with pytest.raises(UsageError, match="is there already"):
            start(there)
