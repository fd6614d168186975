"""A circle of imports is found, and the imports that make it are told."""

from grimp import ImportGraph

from tests.import_circle import NoCircle, find_circle


def _check(*imports: tuple[str, str]) -> list[str]:
    graph = ImportGraph()
    graph.add_module("house")
    for importer, imported in imports:
        graph.add_import(importer=importer, imported=imported)
    contract = NoCircle("no circle", {}, {"package": "house"})
    return list(contract.check(graph, verbose=False).metadata["circle"])


def test_a_circle_is_told_in_the_order_of_its_imports():
    found = _check(("house.a", "house.b"), ("house.b", "house.c"), ("house.c", "house.a"), ("house.d", "house.a"))
    steps = list(zip(found, found[1:], strict=False))
    assert sorted(steps) == [("house.a", "house.b"), ("house.b", "house.c"), ("house.c", "house.a")]


def test_two_ways_to_the_same_module_are_no_circle_and_other_packages_do_not_count():
    assert not _check(("house.a", "house.c"), ("house.a", "house.b"), ("house.b", "house.c"))
    assert not _check(("house.a", "numpy"), ("numpy", "house.a"))


def test_no_imports_are_no_circle():
    assert find_circle({}) == []
