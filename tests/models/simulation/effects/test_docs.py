"""Entries of the catalogue say everything of an effect; `docs/reference/effects.md` is written from them."""

from fast.models.simulation.effects.catalogue import CATALOGUE, catalogue_entries


def test_entries_say_everything_of_an_effect() -> None:
    entry = next(e for e in catalogue_entries() if e["effect"] == "base_compliance")
    assert entry["parameters"][0]["unit"] == "mm/N"
    assert entry["scales_with_modulus"] is False
    assert entry["cost"] == "C"
    assert entry["alias_of"] is None
    assert {e["code"] for e in catalogue_entries()} == {spec.code for spec in CATALOGUE.values()}
