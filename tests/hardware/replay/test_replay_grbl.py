"""Wire logs of the gantry, played back to the driver: everything it sends is what was sent."""

import threading

import pytest

from fast.hardware.clock import ScaledClock, VirtualClock
from fast.hardware.grbl.profile import GrblProfile
from fast.hardware.parts.gantry import Gantry
from fast.hardware.replay.grbl import replay_grbl, split
from fast.hardware.virtual.grbl.server import VirtualGrbl
from fast.hardware.wire.serial import SerialTransport
from fast.models.errors import DeviceError
from tests.hardware.grbl.faulty_line import call_after

NEAR_HOME_MM = (1380.0, 1400.0, 170.0)


def ordinary(gantry, controller, clock):
    gantry.home()
    gantry.move_to(1400, 1300, 120)
    gantry.move_to(z_mm=88, speed_mm_per_s=20)
    gantry.start_lift(20, 5)
    for _ in range(15):
        gantry.sample()
        clock.sleep(0.1)
    gantry.stop_lift()
    gantry.position_mm()


def aborted_from_another_thread(gantry, controller, clock):
    gantry.home()
    aborting = threading.Timer(0.1, gantry.abort)
    aborting.start()
    with pytest.raises(DeviceError):
        gantry.move_to(300, 1300, 120, speed_mm_per_s=50)
    aborting.join()
    gantry.move_to(z_mm=150)


def held_and_resumed(gantry, controller, clock):
    gantry.home()
    gantry.start_lift(-20, 5)
    clock.sleep(1.0)
    gantry.hold()
    gantry.resume()
    gantry.move_to(z_mm=150)
    gantry.abort()


def limit_switch(gantry, controller, clock):
    gantry.home()
    call_after(clock, 0.4, lambda: controller.inject("limit", axis="x"))
    with pytest.raises(DeviceError):
        gantry.move_to(1000, 1300, 120)
    controller.clear("limit", axis="x")
    gantry.home()
    gantry.move_to(z_mm=150)


def restart_in_motion(gantry, controller, clock):
    gantry.home()
    call_after(clock, 0.4, lambda: controller.inject("reset"))
    with pytest.raises(DeviceError):
        gantry.move_to(1000, 1300, 120)
    gantry.home()


def reconnected(gantry, controller, clock):
    gantry.home()
    gantry.connect()
    gantry.home()
    gantry.move_to(z_mm=150)


def interrupted(gantry, controller, clock):
    def ctrl_c():
        raise KeyboardInterrupt

    gantry.home()
    call_after(clock, 0.4, ctrl_c)
    with pytest.raises(KeyboardInterrupt):
        gantry.move_to(1000, 1300, 120)
    gantry.hold()
    gantry.close()


def dead_switch(gantry, controller, clock):
    controller.inject("limit_dead", axis="y")
    with pytest.raises(DeviceError):
        gantry.home()


SCENARIOS = [
    ordinary,
    held_and_resumed,
    limit_switch,
    restart_in_motion,
    reconnected,
    interrupted,
    dead_switch,
]


def recorded(scenario, clock=None):
    clock = clock or VirtualClock()
    with VirtualGrbl(clock, start_mm=NEAR_HOME_MM) as controller:
        gantry = Gantry(SerialTransport(controller.port), clock)
        with gantry:
            scenario(gantry, controller, clock)
    return gantry.wire_log.entries()


def sent_pieces(entries):
    pieces, _ = split(b"".join(entry.data for entry in entries if entry.direction == "sent"))
    return [piece for piece in pieces if piece != b"?"]


@pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.__name__)
def test_the_driver_does_again_what_it_did(scenario):
    entries = recorded(scenario)
    outcome = replay_grbl(entries)
    assert outcome.difference is None, outcome.difference.as_text()
    assert outcome.n_compared == len(sent_pieces(entries))
    assert outcome.n_polls > 0


@pytest.mark.parametrize("scenario", [ordinary, aborted_from_another_thread], ids=["ordinary", "aborted"])
def test_a_log_of_a_clock_that_runs_by_itself(scenario):
    entries = recorded(scenario, ScaledClock(10.0))
    outcome = replay_grbl(entries)
    assert outcome.difference is None, outcome.difference.as_text()
    assert outcome.n_compared == len(sent_pieces(entries))
    assert outcome.errors == []


def changed(entries, old, new):
    assert any(old in entry.data for entry in entries)
    return [entry._replace(data=entry.data.replace(old, new)) for entry in entries]


@pytest.mark.parametrize(
    ("old", "new", "doing", "text"),
    [
        (b"$I\n", b"$i\n", "connecting", "recorded  24 69 0a   b'$i\\n'\n  now sent  24 49 0a   b'$I\\n'"),
        (b" F1200.000", b" F1200.00", "moving", "F1200.00\\n'\n  now sent"),
        (b"$J=G91 G21 Z20", b"$J=G21 G91 Z20", "looking", "now sent  nothing"),
        (b"G4 P0.01", b"G4 P0.02", "moving", "P0.02\\n'\n  now sent  47 34"),
    ],
)
def test_the_first_difference_is_named(old, new, doing, text):
    entries = recorded(ordinary)
    difference = replay_grbl(changed(entries, old, new)).difference
    assert difference is not None
    assert difference.doing.startswith(doing)
    place = [entry.time_s for entry in changed(entries, old, new) if new in entry.data]
    assert abs(difference.time_s - place[0]) < 0.5
    assert text in difference.as_text()


def test_a_device_that_answers_otherwise_shows_in_what_the_driver_does_next():
    entries = recorded(ordinary)
    outcome = replay_grbl(changed(entries, b"$132=186.000", b"$132=187.000"))
    assert "differ from the profile: $132 is 187, profile 186" in outcome.errors[0]
    assert outcome.difference is not None


def test_a_refused_profile_is_no_difference():
    clock = VirtualClock()
    with VirtualGrbl(clock, profile=GrblProfile().with_settings({110: 500}), start_mm=NEAR_HOME_MM) as controller:
        gantry = Gantry(SerialTransport(controller.port), clock)
        with pytest.raises(DeviceError):
            gantry.connect()
    outcome = replay_grbl(gantry.wire_log.entries())
    assert outcome.difference is None
    assert "$110 is 500, profile 12000" in outcome.errors[0]


@pytest.mark.parametrize("share", [0.2, 0.23, 0.26, 0.55, 0.9])
def test_a_log_that_ends_anywhere(share):
    entries = recorded(ordinary)
    outcome = replay_grbl(entries[: int(share * len(entries))])
    assert outcome.difference is None
    assert not any("replay" in thread.name for thread in threading.enumerate())


def test_an_empty_log():
    assert replay_grbl([]).n_compared == 0
