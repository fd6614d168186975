"""The batch sheet: what a person takes to the printer and to the rack."""

import tomllib
from html import escape
from pathlib import Path

import numpy as np
import pytest

from fast.models.design.finger import finger_bodies
from fast.models.design.recipe import Recipe
from fast.models.design.space import BEST_PUBLISHED, random_designs
from fast.models.design.tray import PrintItem
from fast.tasks.bench.sheet import batch_sheet_html

RECIPES = Path(__file__).parents[3] / "recipes"
TPU = Recipe(name="fdm-tpu", **tomllib.loads((RECIPES / "fdm-tpu.toml").read_text()))


@pytest.fixture
def batch():
    designs = random_designs(10, np.random.default_rng(5))
    return [PrintItem(f"B03T{slot}", design) for slot, design in enumerate(designs)]


def test_sheet_names_every_tool_and_needs_no_network(batch):
    html = batch_sheet_html("quick/B03", batch, ["fast print confirm quick/B03 --operator NAME"])
    assert all(f"<h3>{item.label}</h3>" in html for item in batch)
    assert "fast print confirm quick/B03 --operator NAME" in html
    assert "http" not in html
    assert "<script" not in html


def test_sheet_escapes_what_people_type(batch):
    assert "<b>lab</b>" not in batch_sheet_html("<b>lab</b>", batch, [])


def test_sheet_gives_mass_and_volume_and_draws_fingers_at_one_scale(batch):
    html = batch_sheet_html("quick/B03", batch, [])
    bodies = finger_bodies(batch[0].design)
    assert f"{bodies.volume_mm3 / 1e3:.1f} cm³" in html
    assert html.count(' 37 122" role="img" aria-label="profile"') == len(batch)


def test_sheet_prints_the_recipe_and_what_breaks_its_rules(batch):
    html = batch_sheet_html("quick/B03", batch, [], TPU)
    assert "<h2>Recipe fdm-tpu</h2>" in html
    assert all(escape(step) in html for step in TPU.post_processing)
    assert "TPU, Shore A 85" in html
    assert "PETG" in html
    assert 'class="warn"' not in html
    volumes = [finger_bodies(item.design) for item in batch]
    grams = 2 * sum(1.21 * f.compliant.volume + 1.27 * f.rigid.volume for f in volumes) / 1e3
    assert f"{grams:.0f} g of material" in html
    thick = TPU.model_copy(update={"nozzle_mm": 1.2})
    n_thin = sum(min(item.design.front_thickness_mm, item.design.back_thickness_mm, item.design.rib_thickness_mm) < 2.4
                 for item in batch)  # fmt: skip
    assert 0 < n_thin < len(batch)
    assert batch_sheet_html("quick/B03", batch, [], thick).count("thinner than 2.4 mm") == n_thin


def test_sheet_marks_the_reference_finger(batch):
    items = [PrintItem("B01T0", BEST_PUBLISHED), *batch]
    assert batch_sheet_html("quick/B01", items, []).count("B01T0 <small>reference finger</small>") == 1
    assert "reference finger" not in batch_sheet_html("quick/B01", batch, [])
