from fast.models.gap.evaluation.evaluate import find_confounds


def test_aliases_are_declared_with_what_tells() -> None:
    found = {a.effect: a for a in find_confounds({"print_anisotropy": 0.05, "load_cell_lag": 0.9})}
    assert "dead weight" in found["load_cell_gain"].experiment
    assert found["velocity_strengthening_friction"].of.startswith("friction")
    assert "95 %" in found["print_anisotropy"].of
    assert "load_cell_lag" not in found
