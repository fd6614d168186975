"""The rehearsal of a search's panel: as many worlds as are asked for, the same whoever makes them."""

import numpy as np
import pytest

from fast.models.gap.evidence.rehearsal import rehearse_panel
from fast.models.gap.evidence.worlds import LISTED, NOTHING, UNLISTED
from fast.models.records import EffectValue
from fast.models.simulation.effects.catalogue import CATALOGUE
from tests.synthetic.gap import made_up_gap


def test_the_panel_is_rehearsed_with_the_effects_of_the_simulator() -> None:
    data = made_up_gap(5, 5, 0, n_repeats=2)
    known = EffectValue(effect="load_cell_offset", parameters={"offset_n": 0.1})
    said: list[str] = []
    found = rehearse_panel(data, [known], 4, 2, said.append)
    assert [one.group for one in found.worlds] == [NOTHING, LISTED, NOTHING, UNLISTED]
    assert found.worlds[1].cause != "load_cell_offset"  # what is in the simulator is not missing
    assert found.worlds[1].family == CATALOGUE[found.worlds[1].cause].family
    again = rehearse_panel(data, [known], 4)
    signs, others = ([(one.signs.nats, one.signs.spread_nats) for one in made.worlds] for made in (found, again))
    assert np.array(signs) == pytest.approx(np.array(others), rel=1e-6, abs=1e-6)
