"""Runs the code of docs/how-to/use-botorch.md as it is printed there: alone, and in a batch of a campaign."""

import re
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fast.lake.tables.campaign import ProposalRow
from fast.models.design.space import from_unit, random_unit
from fast.models.scientist.propose import NO_PENDING, Rule, propose
from fast.models.scientist.surrogate.fit import ObservationSet, fit_surrogate
from fast.tasks.campaign.config import load_config
from fast.tasks.scientist.propose import propose_guided
from tests.docs.pages import DOCS, ROOT, blocks_of
from tests.tasks.campaign.small_campaign import begun, small_campaign

PAGE = DOCS / "how-to" / "use-botorch.md"
*FUNCTIONS, OWN_CODE = [block.text for block in blocks_of(PAGE, "python")]
RULES = re.findall(r"def (make_\w+)\(model, situation\)", "".join(FUNCTIONS))


@pytest.fixture(autouse=True)
def my_lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page's functions as `my_lab.py` in the present folder."""
    (tmp_path / "my_lab.py").write_text("\n".join(FUNCTIONS))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "my_lab", raising=False)


def named() -> dict[str, Any]:
    (section,) = [tomllib.loads(block.text)["scientist"] for block in blocks_of(PAGE, "toml")]
    return section


def test_each_function_has_at_most_ten_lines() -> None:
    assert max(len([line for line in block.splitlines() if line]) for block in FUNCTIONS) <= 10


@pytest.mark.parametrize("rule", RULES)
def test_every_rule_of_the_page_chooses_tools_apart(rule: str) -> None:
    x, s = random_unit(24, np.random.default_rng(1)), np.repeat([0, 1], 12)
    surrogate = fit_surrogate(ObservationSet(x, s, 10.0 + 8.0 * x[:, 0] + s, np.zeros(24)))
    chosen = propose(surrogate, 1, 3, NO_PENDING, np.random.default_rng(2), Rule(f"my_lab:{rule}"))
    assert len({proposal.design for proposal in chosen}) == 3
    assert np.mean([p.design.length_mm for p in chosen]) > np.mean([d.length_mm for d in from_unit(x)])


def test_a_campaign_chooses_a_batch_with_model_rule_and_constraint_of_the_page(tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text(
        (ROOT / "campaigns" / "quick.toml").read_text().replace("../worlds", str(ROOT / "worlds"))
        + blocks_of(PAGE, "toml")[0].text
    )
    assert load_config(tmp_path / "lab.toml").scientist.own_functions == list(named().values())
    campaign = begun(small_campaign(tmp_path, scientist=named()))
    propose_guided(campaign, 2)
    tools = campaign.state().tools
    assert len(tools) == 4
    assert all(t.design.rib_count % 2 == 0 and t.design.width_mm <= 33.0 for t in tools)
    rows = campaign.lake.records(ProposalRow)
    assert [r.acquisition for r in rows if r.batch == 2 and r.slot is not None] == [named()["acquisition"]] * 2


def test_the_surrogate_serves_own_code() -> None:
    names: dict[str, Any] = {}
    exec(compile(OWN_CODE, PAGE.name, "exec"), names)
    assert names["best"].shape == (1, 10)
    assert names["value"] > 0.0
