import math
import random

import pytest

from fast.hardware.parts.layout import BenchLayout
from fast.hardware.parts.route import shortest_tour, travel_s
from fast.models.errors import UsageError

LAYOUT = BenchLayout()


def length_mm(objects):
    places = [LAYOUT.object_xy_mm(object_id) for object_id in objects]
    return sum(math.dist(a, b) for a, b in zip(places, places[1:], strict=False))


def test_the_tour_of_the_full_grid_steps_from_neighbour_to_neighbour():
    tour = shortest_tour(range(36))
    assert sorted(tour) == list(range(36))
    assert length_mm(tour) == pytest.approx(35 * LAYOUT.object_pitch_mm), "no tour of 36 places is shorter"
    assert {tour[0] // 6, tour[-1] // 6} == {5}, "it starts and ends in the row next to the dock"


def test_the_tour_does_not_depend_on_how_the_objects_are_listed():
    ids = [1, 8, 14, 22, 30, 35, 3]
    assert shortest_tour(ids) == shortest_tour(sorted(ids, reverse=True))
    assert shortest_tour([5]) == (5,)


def test_a_random_order_travels_longer():
    tour = list(shortest_tour(range(36)))
    shuffled = list(tour)
    random.Random(1).shuffle(shuffled)
    assert travel_s([LAYOUT.object_xy_mm(o) for o in shuffled]) > 1.5 * travel_s([LAYOUT.object_xy_mm(o) for o in tour])


def test_a_leg_takes_its_trapezoid():
    assert travel_s([(0.0, 0.0), (150.0, 0.0)]) == pytest.approx(150 / 200 + 200 / 500)
    assert travel_s([(0.0, 0.0), (20.0, 0.0)]) == pytest.approx(2 * math.sqrt(20 / 500))
    assert travel_s([(3.0, 4.0), (3.0, 4.0)]) == 0.0


def test_an_object_whose_place_another_has_taken_is_not_on_the_bench():
    layout = BenchLayout(own_objects=((1234, 14),))
    assert layout.object_xy_mm(1234) == LAYOUT.object_xy_mm(14)
    assert not layout.has_place(14)
    with pytest.raises(UsageError, match="Object 14 is not on the bench, own object 1234 stands on its place"):
        layout.object_xy_mm(14)
    assert layout.object_at(*LAYOUT.object_xy_mm(14)) == 1234
