"""`import fast`: every public name is there, costs nothing before it is used, and is all that is installed."""

import math
import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from setuptools import find_namespace_packages

import fast

ROOT = Path(__file__).parents[1]
MOST_NAMES = 30
OF_A_CHECKOUT = {"write-a-bench-driver.md"}  # a driver is a part of the code, and its tests are in the checkout
LAB_PAGES = [page for folder in ("how-to", "tutorial") for page in sorted((ROOT / "docs" / folder).glob("*.*"))]


@pytest.mark.parametrize("name", fast.__all__)
def test_every_public_name_is_there_and_explained(name: str) -> None:
    assert getattr(fast, name).__doc__
    assert name in dir(fast)


def test_the_public_face_is_small() -> None:
    assert len(fast.__all__) <= MOST_NAMES
    assert list(fast.__all__) == list(fast._HOMES)


def test_pages_for_labs_import_from_the_public_face_alone() -> None:
    below = {
        page.name: found
        for page in [ROOT / "README.md", *LAB_PAGES]
        if page.name not in OF_A_CHECKOUT
        and (found := re.findall(r"^\W*(?:from|import) fast\..*", page.read_text(encoding="utf-8"), flags=re.M))
    }
    assert below == {}, "a lab's program may import from `fast` alone: give it the name there, or show another way"


def test_pages_use_the_public_names_and_show_each_of_them() -> None:
    text = "\n".join(page.read_text(encoding="utf-8") for page in LAB_PAGES if page.suffix == ".md")
    used = set(re.findall(r"\bfast\.(\w+)(?:\(|`|\.open|,)", text))
    for names in re.findall(r"^from fast import (.*)$", text, flags=re.M):
        used |= set(names.split(", "))
    assert used - {"flows", "tasks", "lake", "hardware", "models"} == set(fast.__all__)


def test_an_unknown_name_is_told_with_the_known_ones() -> None:
    with pytest.raises(AttributeError, match="module `fast` has no `simulat`; it has .*simulate"):
        fast.simulat  # type: ignore[attr-defined]  # noqa: B018


def test_importing_it_loads_no_heavy_package() -> None:
    code = (
        "import sys, fast; print([m for m in ('numpy', 'torch', 'prefect', 'duckdb', 'pydantic') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.stdout == "[]\n", done.stderr


def test_a_wheel_brings_one_name_and_all_data() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    packages = find_namespace_packages(str(ROOT), include=settings["packages"]["find"]["include"])
    assert {package.split(".")[0] for package in packages} == {"fast"}
    assert {"fast.flows", "fast.tasks", "fast.lake", "fast.hardware", "fast.models", "fast.worlds"} <= set(packages)
    patterns = settings["package-data"]["*"]
    names = ("prefect.yaml", "campaigns/quick.toml", "worlds/quick.toml", "materials/paper.toml", "lake/views.sql",
             "flows/report/page.html.j2", "flows/report/page.css")  # fmt: skip
    for name in names:
        assert (ROOT / "fast" / name).is_file()
        assert f"*{Path(name).suffix}" in patterns


def test_the_links_of_the_package_are_the_folders_of_the_repository() -> None:
    for name in ("flows", "tasks", "lake", "hardware", "models"):
        assert (ROOT / "fast" / name).resolve() == ROOT / name


@pytest.mark.parametrize("name", ["FinRay", "RigidObject"])
def test_a_notebook_completes_the_arguments_of_a_record(name: str) -> None:
    said = f"import fast, inspect; print(*inspect.signature(fast.{name}).parameters)"
    found = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True).stdout.split()
    assert found == list(getattr(fast, name).model_fields)


class Strange:
    """Nothing of `fast`."""


STRANGE = [None, "cube", [1, 2], math.nan, np.array(1.5), -1, Strange()]
USUAL = {"design": fast.BEST_PUBLISHED, "obj": fast.get_object(30)}
CALLS: dict[str, Callable[[Any], object]] = {
    "get_object": fast.get_object,
    "to_unit": fast.to_unit,
    "from_unit": fast.from_unit,
    "random_unit": lambda given: fast.random_unit(given, np.random.default_rng(1)),
    "random_unit's rng": lambda given: fast.random_unit(2, given),
    "Trace": lambda given: fast.Trace([0.0], given, given),
    "SurrogateModel": fast.SurrogateModel,
    "fit_surrogate": fast.fit_surrogate,
    "skin_of": fast.skin_of,
    "update_features": fast.update_features,
    "simulate_grasp's design": lambda given: fast.simulate_grasp(**USUAL | {"design": given}),
    "simulate_grasp's object": lambda given: fast.simulate_grasp(**USUAL | {"obj": given}),
    "simulate_grasp's version": lambda given: fast.simulate_grasp(**USUAL, version=given),
    "simulate_grasp's placement": lambda given: fast.simulate_grasp(**USUAL, placement=given),
    "simulate_grasp's along": lambda given: fast.simulate_grasp(**USUAL, along=given),
}


@pytest.mark.parametrize("name", CALLS)
def test_an_argument_of_another_type_is_a_sentence(name: str) -> None:
    for given in STRANGE:
        with pytest.raises(fast.FastError) as caught:
            CALLS[name](given)
        assert not isinstance(caught.value, fast.SimulationFailed)


@pytest.mark.parametrize("call", [fast.Lake, fast.Lake.open, fast.Campaign, fast.find_gap])
def test_a_path_that_is_none_is_a_sentence(call: Callable[[Any], object]) -> None:
    for given in (None, [1, 2], math.nan, -1, Strange()):
        with pytest.raises(fast.FastError, match="; give a folder or|it must be the path of a file"):
            call(given)


def test_numbers_of_numpy_are_numbers() -> None:
    assert fast.get_object(np.int64(30)) is fast.get_object(np.array(30)) is USUAL["obj"]
    assert fast.random_unit(np.int32(2), np.random.default_rng(1)).shape == (2, 9)
