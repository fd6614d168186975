"""Worlds that hide effects: they are what their keys say, sealed ones can be judged, and three tiny ones are named."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fast.flows.challenge.hidden.lab_laws import LAB_LAWS
from fast.flows.challenge.hidden.other_lab_laws import OTHER_LAB_LAWS
from fast.flows.challenge.hidden.panel_file import read_small
from fast.flows.challenge.hidden.panels import MODULUS_MPA, Panels, raw_strength, visible_share
from fast.flows.challenge.hidden.worlds import UNLISTED, Hidden, WorldKey, Worlds
from fast.lake.store import Lake
from fast.models.design.space import numbered_design
from fast.models.errors import UsageError
from fast.models.gap.bank.bank import Bank, BankPlan
from fast.models.gap.data import GapData
from fast.models.objects.catalogue import get_object
from fast.models.records import Trace
from fast.models.simulation.effects.catalogue import CATALOGUE
from tests.studies.benchmarks.base import Options
from tests.studies.gap.answers import Answer, Closing, Said, answer, measure_twin
from tests.studies.gap.development import PUBLIC_SEED, measure_gap, with_known_fields
from tests.studies.gap.grasp_laws.truth import OTHER_GRASP_LAWS
from tests.studies.gap.independent import is_alarm, read_independent
from tests.studies.gap.judgement import Judged
from tests.studies.gap.local_banks import LocalBanks
from tests.studies.gap.sealed import SealedKey, judged, measure_gap_sealed, read_problem, seal, write_problem
from tests.studies.gap.small_panel import write_small
from tests.studies.gap.tables import gap_tables
from tests.studies.gap.truth import LAWS, PANEL_DESIGNS, PANEL_OBJECTS, Panel
from tests.synthetic.rehearsal import USUAL

SMALL = Path(__file__).parents[2] / "data" / "gap-small.npz"
SLIP = "static_kinetic_friction"


@pytest.fixture(scope="module")
def small() -> tuple[Panels, Bank]:
    """Eight designs on six objects: a base, one under another friction law, and the bank."""
    return read_small(SMALL)


@pytest.fixture(scope="module")
def worlds(small: tuple[Panels, Bank]) -> Worlds:
    """Worlds of the small panel from a public seed."""
    return Worlds(*small, seed=5)


def _key(worlds: Worlds, effect: str | None = None, strength: float = 0.1, seed: int = 3) -> WorldKey:
    key = WorldKey(group="single", number=0, seed=seed, base="base-0", young_modulus_mpa=9.7)
    return key if effect is None else worlds.with_effect(key, effect, strength, np.random.default_rng(0))


def test_the_file_keeps_panels_and_bank(small: tuple[Panels, Bank], tmp_path: Path) -> None:
    """Forces to two thousandths of a newton, lost grasps as such."""
    panels, bank = small
    bank.centre_steps_n[0, 0] = np.nan
    write_small(tmp_path / "again.npz", panels, bank, list(panels.cells))
    other, other_bank = read_small(tmp_path / "again.npz")
    assert np.isnan(other_bank.centre_steps_n[0, 0]).all()
    assert np.nanmax(np.abs(other_bank.grid_steps_n - bank.grid_steps_n)) < 1e-9
    assert list(other.cells["base-0"]) == list(panels.cells["base-0"])
    bank.centre_steps_n[0, 0] = other_bank.grid_steps_n[0, 0].mean(axis=0)


def test_a_seed_always_draws_the_same_world_and_another_draws_another(worlds: Worlds) -> None:
    """Keys and data."""
    key = worlds.draw("single", 2)
    again = Worlds(worlds.panels, worlds.bank, 5).draw("single", 2)
    assert key == again != Worlds(worlds.panels, worlds.bank, 6).draw("single", 2)
    first, second = worlds.problem(key), worlds.problem(again)
    assert np.array_equal(first.grasps.steps_n, second.grasps.steps_n)
    assert np.array_equal(first.held_out_tools, second.held_out_tools)
    assert first.held_out_tools.sum() == first.held_out_objects.sum() == 2


def test_worlds_of_a_larger_panel_have_designs_and_objects_of_their_own(
    small: tuple[Panels, Bank], tmp_path: Path
) -> None:
    """Traces, prints, bank and what is hidden are theirs, also after the file."""
    panels, bank = small
    worlds = Worlds(panels, bank, seed=5, n_designs=6, n_objects=5)
    key, other = worlds.draw("null", 0), worlds.draw("null", 1)
    assert {key.designs, key.objects} & {other.designs, other.objects} == set()
    assert (len(set(key.designs)), len(set(key.objects))) == (6, 5)
    problem = worlds.problem(worlds.with_effect(key, "load_cell_offset", 0.1, np.random.default_rng(0)))
    assert problem.grasps.designs == tuple(numbered_design(number) for number in key.designs)
    assert problem.grasps.objects == key.objects
    tool, obj = panels.designs.index(key.designs[2]), panels.objects.index(key.objects[3])
    by_cell = {name: array for name, array in vars(bank).items() if np.shape(array)[:2] == (8, 6)}
    assert len(by_cell) == 6
    for name, array in by_cell.items():
        assert np.array_equal(getattr(problem.bank, name)[2, 3], array[tool, obj], equal_nan=True)
    assert problem.bank.targets[3] == bank.targets[obj]
    assert np.array_equal(problem.bank.effects[SLIP].steps_n[2, 3], bank.effects[SLIP].steps_n[tool, obj])
    assert worlds.of(key).panels.cells["base-0"][2, 3] is panels.cells["base-0"][tool, obj]
    is_cell = (problem.grasps.tool == 2) & (problem.grasps.obj == 3)
    true_n = worlds.of(key).panels.steps_n["base-0"][2, 3] * key.young_modulus_mpa / MODULUS_MPA
    rest_n = problem.grasps.steps_n[is_cell].mean(axis=0) - true_n
    assert np.sqrt(np.mean(rest_n**2)) < 0.2 * np.sqrt(np.mean(true_n**2))
    write_problem(tmp_path / "w.npz", problem, key.designs)
    read = read_problem(tmp_path / "w.npz", worlds.bank_of)
    assert np.array_equal(read.bank.grid_steps_n, problem.bank.grid_steps_n)


@pytest.mark.parametrize("effect", ["load_cell_offset", "temperature_softening", "object_post_compliance"])
def test_a_law_of_the_lab_is_as_strong_as_asked(worlds: Worlds, effect: str) -> None:
    """Within a tenth, by RMS over the forces; visible is never more than raw."""
    hidden = _key(worlds, effect, 0.05).effects[0]
    assert hidden.raw_strength == pytest.approx(0.05, rel=0.1)
    assert 0.0 < hidden.visible_strength <= hidden.raw_strength * 1.001


def test_one_cell_that_snaps_is_no_strength_without_it(worlds: Worlds) -> None:
    """An effect that doubles the force of one cell looks strong, and is not once that cell is left out."""
    name = SLIP
    cells = dict(worlds.panels.cells[name])
    snapped = cells[0, 0]
    cells[0, 0] = Trace(snapped.time_s, snapped.lift_mm, 2.0 * snapped.force_n)
    snapping = replace(worlds, panels=replace(worlds.panels, cells={**worlds.panels.cells, name: cells}))
    usual, strange = _key(worlds, name), _key(snapping, name)
    assert strange.effects[0].visible_strength > 2.0 * usual.effects[0].visible_strength
    assert strange.effects[0].spread_strength == pytest.approx(usual.effects[0].visible_strength, rel=0.15)
    assert 0.0 < usual.effects[0].spread_strength < usual.effects[0].visible_strength


def test_aliases_are_invisible_and_other_effects_are_not(worlds: Worlds) -> None:
    """A span error is theta's modulus; a friction law is not a friction coefficient."""
    gain = _key(worlds, "load_cell_gain", 0.05).effects[0]
    assert gain.visible_strength < 0.05 * gain.raw_strength
    friction = _key(worlds, SLIP).effects[0]
    assert friction.visible_strength > 0.3 * friction.raw_strength


def test_the_law_of_an_effect_is_drawn_from_two(small: tuple[Panels, Bank]) -> None:
    """Sealed worlds have both; both are as strong as asked, and their traces differ."""
    worlds = Worlds(*small, seed=5, has_other_laws=True)
    drawn = [worlds.with_effect(_key(worlds), "stress_relaxation", 0.05, np.random.default_rng(n)) for n in range(6)]
    kinds = {key.effects[0].is_other: key for key in drawn}
    assert set(kinds) == {False, True}
    for key in kinds.values():
        assert key.effects[0].raw_strength == pytest.approx(0.05, rel=0.1)
    first, other = (worlds.problem(kinds[is_other]).grasps.steps_n for is_other in (False, True))
    assert 0.001 < np.sqrt(np.mean((first - other) ** 2) / np.mean(first**2)) < 0.05
    assert not any(Worlds(*small, seed=5).draw("single", n).effects[0].is_other for n in range(4))


def test_strengths() -> None:
    """RMS over RMS."""
    force = np.full((2, 120), 2.0)
    assert raw_strength(0.1 * force, force) == pytest.approx(0.1)


def test_visible_share_of_the_force_itself_is_nothing(worlds: Worlds) -> None:
    """A factor on all forces is Young's modulus."""
    sites = worlds.lab(_key(worlds)).order()
    rows = [site.tool for site in sites], [site.obj for site in sites]
    force_n = worlds.panels.steps_n["base-0"][rows]
    assert visible_share(0.1 * force_n, force_n, sites, worlds.panels.sets["base-0"].theta, worlds.bank) < 0.02


def test_hidden_names_are_the_catalogues_or_of_no_catalogue() -> None:
    """So that an answer can be compared with a key."""
    unlisted = {*UNLISTED, "wider_closing"}
    names = {*LAB_LAWS, *LAWS}
    assert set(OTHER_LAB_LAWS) <= set(CATALOGUE)
    for name, law in OTHER_GRASP_LAWS.items():
        assert law.kind is not CATALOGUE[name].kind
    assert names - unlisted <= set(CATALOGUE)
    assert not unlisted & set(CATALOGUE)


def test_a_sealed_problem_is_read_as_it_was_written(worlds: Worlds, tmp_path: Path) -> None:
    """Data without the key."""
    problem = worlds.problem(_key(worlds, "load_cell_lag"))
    write_problem(tmp_path / "w.npz", problem, worlds.panels.designs)
    read = read_problem(tmp_path / "w.npz", worlds.bank_of)
    assert np.array_equal(read.grasps.steps_n, problem.grasps.steps_n)
    assert read.grasps.contexts == problem.grasps.contexts
    assert read.grasps.noise == problem.grasps.noise
    assert read.grasps.designs == problem.grasps.designs
    assert np.array_equal(read.is_held_out, problem.is_held_out)


def test_a_changed_key_voids_a_sealed_run(worlds: Worlds, tmp_path: Path) -> None:
    """The hash was there first, and data say nothing of the key."""
    seal(worlds, tmp_path, Options(worlds=1))
    keys = tmp_path / "sealed-keys.jsonl"
    first = SealedKey.model_validate_json(keys.read_text().splitlines()[0])
    said = Answer(code="c", rounds=(Said(kind="none"),))
    line = {"world": first.world, "answer": said.model_dump(mode="json"), "answer_hash": said.answer_hash}
    (tmp_path / "sealed-answers.jsonl").write_text(json.dumps(line) + "\n")
    assert judged(tmp_path)[0].key == first.key
    changed = first.model_copy(update={"key": first.key.model_copy(update={"young_modulus_mpa": 1.0})})
    keys.write_text(keys.read_text().replace(first.model_dump_json(exclude_defaults=True), changed.model_dump_json()))
    with pytest.raises(UsageError, match="this sealed run is void"):
        judged(tmp_path)


NULL = WorldKey(group="null", number=0, seed=1, base="b", young_modulus_mpa=9.0)
LAGGING = NULL.model_copy(
    update={
        "group": "single",
        "effects": (Hidden(effect="load_cell_lag", raw_strength=0.05, visible_strength=0.04),),
    }
)


def _judged(key: WorldKey, kind: str, *effects: str, left_out: bool = False, probability: float = 0.95) -> Judged:
    one = Said(kind=kind, effects=effects, probability=probability)  # type: ignore[arg-type]
    return Judged(key, Answer(code="c", rounds=(one,), cpu_s=2.0), left_out)


def test_figures_count_what_they_say() -> None:
    """Two nulls with one alarm; a right set, a wrong name, an unknown of what was left out, a kin of it."""
    rows = gap_tables(
        [
            _judged(NULL, "none"),
            _judged(NULL, "unknown"),
            _judged(LAGGING, "set", "lift_misalignment", "load_cell_lag"),
            _judged(LAGGING, "effect", "friction_wear"),
            _judged(LAGGING, "unknown", left_out=True),
            _judged(LAGGING, "effect", "lift_misalignment", left_out=True),
            _judged(LAGGING, "effect", "friction_wear", left_out=True, probability=0.6),
        ]
    )["figures"]
    figures = {row["figure"]: row for row in rows}
    assert figures["false alarms, null worlds"]["value"] == 0.5
    assert figures["family right first, given an alarm"]["value"] == 0.5
    assert figures["member right, given a single name"]["value"] == 0.0
    assert figures["truth in the name or set, given one"]["value"] == 0.5
    assert figures["truth not in the catalogue: unknown, or its family"]["value"] == pytest.approx(2 / 3)
    assert figures["stated probability of 0.9 or more is right"]["value"] == pytest.approx(4 / 6)
    assert figures["mean size of name or set"]["value"] == 1.5
    assert figures["Brier score"]["value"] == pytest.approx((4 * 0.05**2 + 2 * 0.95**2 + 0.6**2) / 7, abs=1e-3)


def test_closed_gaps_are_held_against_their_twins() -> None:
    """From 0.8 to 0.5 N, where the same world without the effect leaves 0.4 N."""
    one = Said(kind="effect", effects=("load_cell_lag",))
    said = Answer(code="c", rounds=(one,), closing=Closing(before_n=0.8, after_n=0.5))
    (row,) = gap_tables([Judged(LAGGING, said, twin_n=0.4)])["gap closed"]
    assert (row["before_n"], row["after_n"], row["twin_n"], row["closed"]) == (0.8, 0.5, 0.4, 0.75)


def test_a_conformal_set_holds_a_family_of_the_catalogue_or_else_unknown() -> None:
    """*Still possible: not in the catalogue* holds the truth where it is not in the catalogue, and nowhere else."""

    def count(possible: tuple[str, ...], left_out: bool) -> tuple[list[int], float]:
        one = Said(kind="effect", effects=possible[:1], possible=possible)
        said = Judged(LAGGING, Answer(code="c", rounds=(one,)), left_out)
        rows = [row for row in gap_tables([said])["figures"] if "conformal" in str(row["figure"])]
        return [row["seen"] for row in rows if "seen" in row], rows[-1]["value"]

    assert count(("friction_wear", "unknown"), left_out=False) == ([0], 2.0)
    assert count(("friction_wear", "unknown"), left_out=True) == ([1], 2.0)
    assert count(("friction_wear",), left_out=True) == ([0], 1.0)
    assert count(("lift_misalignment", "load_cell_lag"), left_out=False) == ([1], 1.0)  # one family


def test_a_panel_of_a_secret_is_drawn_again_from_it() -> None:
    """Designs, objects, thetas and amplitudes are all of the seed."""
    first, other = Panel.draw("a"), Panel.draw("b")
    assert first == Panel.draw("a")
    assert (first.designs, first.sets) != (other.designs, other.sets)
    assert len(first.designs) == len(set(first.designs)) == PANEL_DESIGNS
    assert len(first.objects) == len({get_object(number).object_class for number in first.objects}) == PANEL_OBJECTS


def test_a_benchmark_without_its_files_says_what_it_needs(tmp_path: Path) -> None:
    """One sentence each."""
    with pytest.raises(UsageError, match="need --results FOLDER/FILE"):
        measure_gap_sealed(Options())
    with pytest.raises(UsageError, match=r"panel.json is missing"):
        measure_gap_sealed(Options(results=tmp_path / "worlds.jsonl"))
    with pytest.raises(UsageError, match=r"panel.json is missing"):
        measure_gap(Options(results=tmp_path / "worlds.jsonl"))


def test_effects_without_simulations_cannot_be_named(small: tuple[Panels, Bank]) -> None:
    """A bank that is half filled answers with what it has."""
    _, bank = small
    field = bank.effects["shear_adhesion"]
    kept = field.steps_n.copy()
    field.steps_n[:4] = np.nan
    known = with_known_fields(bank).effects
    field.steps_n[:] = kept
    assert "shear_adhesion" not in known
    assert "static_kinetic_friction" in known


def test_a_tiny_null_world_is_answered_with_nothing(worlds: Worlds) -> None:
    """Another mesh, contact law, placement and prints are no gap; the twin of a null world is itself."""
    key = _key(worlds)
    problem = worlds.problem(key)
    said = answer(problem, USUAL, max_rounds=1)
    assert said.rounds[0].kind == "none"
    assert said.closing is not None
    assert said.closing.before_n == said.closing.after_n == pytest.approx(measure_twin(problem, USUAL))


def test_a_world_is_answered_with_the_bank_around_its_theta(
    worlds: Worlds, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last bank answers: the one around theta, moved where theta left it."""
    plans: list[BankPlan] = []

    def take(banks: LocalBanks, wide: GapData, plan: BankPlan) -> GapData:
        plans.append(plan)
        return wide

    monkeypatch.setattr(LocalBanks, "_with_bank", take)
    monkeypatch.setattr("fast.models.gap.local_bank.has_left", lambda found, plan: len(plans) == 1)
    problem = worlds.problem(_key(worlds))
    banks = LocalBanks(Lake.open(tmp_path, create=True))
    said = answer(problem, USUAL, max_rounds=1, banks=banks)
    assert [plan.is_local for plan in plans] == [True, True]
    assert said.rounds[0].kind == "none"
    assert measure_twin(problem, USUAL, banks) == pytest.approx(measure_twin(problem, USUAL))


def test_a_tiny_world_with_a_transmitter_that_lags_is_named(worlds: Worlds) -> None:
    """By the law of the lab, which averages where the catalogue has an exponential; and nobody else."""
    said = answer(worlds.problem(_key(worlds, "load_cell_lag")), USUAL, max_rounds=1)
    assert said.is_alarm
    assert CATALOGUE[said.rounds[0].effects[0]].family == CATALOGUE["load_cell_lag"].family


def test_a_tiny_world_with_an_unlisted_pull_is_unknown(worlds: Worlds) -> None:
    """A magnet is in no catalogue; what it leaves has a pattern that no effect predicts."""
    said = answer(worlds.problem(_key(worlds, "magnetic_pull", 0.1)), USUAL, max_rounds=1)
    assert said.rounds[0].kind == "unknown"


@pytest.fixture(scope="module")
def of_another_solver() -> Worlds:
    """Its mesh, contact and integration are its own."""
    return Worlds(*read_independent(), seed=11)


def test_what_another_solver_differs_by_is_no_gap(of_another_solver: Worlds) -> None:
    said = answer(of_another_solver.problem(_key(of_another_solver)), USUAL, max_rounds=1)
    assert said.rounds[0].kind == "none"


def test_a_delay_in_another_solvers_grasps_is_found(of_another_solver: Worlds) -> None:
    problem = of_another_solver.problem(_key(of_another_solver, "load_cell_lag"))
    said = answer(problem, USUAL, max_rounds=1).rounds[0]
    assert CATALOGUE[said.effects[0]].family == CATALOGUE["load_cell_lag"].family


@pytest.mark.parametrize(("n_designs", "n_objects"), [(1, 3), (2, 2)])
def test_another_solver_is_no_alarm_on_a_small_panel(n_designs: int, n_objects: int) -> None:
    """Few cells show few of the ways in which solvers differ: of these were alarms 2 and 4 before."""
    worlds = Worlds(*read_independent(), PUBLIC_SEED, n_designs=n_designs, n_objects=n_objects)
    assert sum(is_alarm(worlds, worlds.draw("null", number)) for number in range(12)) <= 1
