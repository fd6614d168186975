"""Recipes: what each process needs, its thinnest wall and gap against what is drawn, and the shipped files."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from fast.models.design.printability import PrintingRules, broken_rules
from fast.models.design.recipe import Recipe
from fast.models.design.space import random_designs
from fast.models.errors import ConfigError
from fast.models.validation import load_record

FILES = sorted((Path(__file__).parents[3] / "recipes").glob("*.toml"))


def read(name: str, **changes: object) -> Recipe:
    told = next(tomllib.loads(path.read_text()) for path in FILES if path.stem == name)
    return load_record(Recipe, {"name": name, **told, **changes}, "recipe")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_shipped_recipes_print_every_wall_of_the_paper_and_survive_json(path):
    recipe = read(path.stem)
    assert recipe.wall_mm <= 2.0
    assert Recipe.model_validate_json(recipe.content_json) == recipe


def test_both_processes_that_labs_use_are_shipped():
    assert {read(path.stem).process for path in FILES} == {"polyjet", "fdm"}


@pytest.mark.parametrize(
    ("name", "changes", "sentence"),
    [
        ("fdm-tpu", {"nozzle_mm": None}, 'process "fdm" needs nozzle_mm'),
        ("polyjet", {"nozzle_mm": 0.4}, 'process "polyjet" has no nozzle; remove nozzle_mm'),
        ("polyjet", {"min_wall_mm": None}, 'process "polyjet" needs min_wall_mm'),
        ("polyjet", {"bed_mm": [490, 3]}, "two sizes of 50 to 2000 mm"),
        ("polyjet", {"process": "laser"}, "print.*laser|process.*laser"),
        ("polyjet", {"post_processing": []}, "post_processing"),
    ],
)
def test_what_is_missing_or_too_much_is_said(name, changes, sentence):
    with pytest.raises(ConfigError, match=sentence):
        read(name, **changes)


def test_a_nozzle_prints_walls_of_two_lines():
    assert read("fdm-tpu", nozzle_mm=0.6).wall_mm == 1.2
    assert read("fdm-tpu", nozzle_mm=0.6).wall_rule == "2 lines of a nozzle of 0.6 mm"
    assert read("fdm-tpu", nozzle_mm=0.6, min_wall_mm=1.5).wall_mm == 1.5


def test_a_wall_below_the_limit_is_found_wherever_it_is():
    designs = random_designs(40, np.random.default_rng(7))
    thinnest = [min(d.front_thickness_mm, d.back_thickness_mm, d.rib_thickness_mm) for d in designs]
    for limit_mm in (2.0, 2.2, 2.5, 3.0):
        rules = PrintingRules(min_cavity_mm=0.0, min_wall_mm=limit_mm)
        assert [bool(broken_rules(d, rules)) for d in designs] == [mm < limit_mm - 0.01 for mm in thinnest]


def test_the_gap_of_the_recipe_stands_in_place_of_that_of_the_config():
    rules = read("polyjet", support_gap_mm=4.0).limit(
        PrintingRules(min_cavity_mm=1.0, min_wall_mm=2.5, max_mass_g=30.0)
    )
    assert (rules.min_cavity_mm, rules.min_wall_mm, rules.max_mass_g) == (4.0, 2.5, 30.0)
