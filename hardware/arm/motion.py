"""An arm's single motions, waits and outputs; each is a moment at which a person's stop is heard."""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from fast.hardware.arm.link import ArmLink, ArmState, write_output
from fast.hardware.arm.settings import ArmSettings, Point
from fast.hardware.grasp_bench import Leave
from fast.hardware.parts.safe_state import StopAskedError, Verb
from fast.models.errors import DeviceError, FastError

logger = logging.getLogger(__name__)

SETTLE_S = 0.3  # after travelling, before the tare
LOW_MM = 0.5  # below travel height


class ArmMotion:
    """A connected arm; what it does ends early where a person asks for a stop.

    Args:
        settings: where it is and how fast it moves.
        remedy: what a person does after a stop that was asked for.
    """

    def __init__(self, settings: ArmSettings, remedy: str) -> None:
        self.settings = settings
        self.link = ArmLink(settings, self._hear)
        self.leave: Leave = lambda: None
        self.asked: Verb | None = None
        self._remedy = remedy
        self._at_work: int | None = None  # thread that hears what a person asks

    def ask(self, verb: Verb) -> None:
        """Stop or abort now, from any thread."""
        if Verb(verb).commands_safe_state:
            self.asked = verb

    def _hear(self) -> None:
        if self.asked is not None and self._at_work == threading.get_ident():
            raise StopAskedError(self.asked, self._remedy)

    @contextmanager
    def guarded(self) -> Iterator[None]:
        """Go to the safe state whatever ends the work early: motion stops, grip and lock stay as they are."""
        self._at_work = threading.get_ident()
        try:
            yield
        except BaseException as error:
            logger.warning("The arm stops: %s", error)
            self._at_work = None  # a person was heard; the stop itself is not to be interrupted
            try:
                self.link.halt()
            except FastError as silent:
                logger.warning("The arm did not take the stop: %s", silent)
            raise
        finally:
            self._at_work = None

    def move(self, place_mm: Point, speed_mm_per_s: float, yaw_deg: float = 0.0) -> ArmState:
        """Go straight there; returns the state at the end."""
        self.leave()
        here = self.link.read().position_mm
        distance_mm = float(np.linalg.norm(np.array(place_mm) - here))
        return self.link.run([self.link.write_move(place_mm, speed_mm_per_s, yaw_deg)], distance_mm / speed_mm_per_s)

    def shift(self, axis: int, distance_mm: float, speed_mm_per_s: float) -> None:
        """Go straight along an axis of the base frame; the flange keeps its direction, whatever that is."""
        self.leave()
        state = self.link.read()
        x_mm, y_mm, z_mm = (state.target_mm + distance_mm * np.eye(3)[axis]).tolist()
        line = self.link.write_line((x_mm, y_mm, z_mm), state.rotation_rad.tolist(), speed_mm_per_s)
        self.link.run([line], abs(distance_mm) / speed_mm_per_s)

    def travel(self, x_mm: float, y_mm: float, yaw_deg: float = 0.0) -> None:
        """Go up to travel height, then over the place."""
        here = self.link.read().position_mm
        if here[2] < self.settings.travel_z_mm - LOW_MM:
            up_mm = (float(here[0]), float(here[1]), self.settings.travel_z_mm)
            self.move(up_mm, self.settings.travel_speed_mm_per_s)
        self.move((x_mm, y_mm, self.settings.travel_z_mm), self.settings.travel_speed_mm_per_s, yaw_deg)

    def switch(self, output: int, is_on: bool) -> None:
        """Set a digital output."""
        self.leave()
        self.link.run([write_output(output, is_on)], 1.0)

    def wait(self, duration_s: float) -> list[ArmState]:
        """Wait, and return all states of the next seconds of the arm's time."""
        state = self.link.read()
        states, end_s = [], state.time_s + duration_s
        while state.time_s < end_s:
            state = self.link.next(state.time_s)
            states.append(state)
        return states

    def feel_n(self, duration_s: float) -> np.ndarray:
        """Return downward pulls on the flange over some time, N."""
        return np.array([-state.force_n[2] for state in self.wait(duration_s)])

    def grip(self) -> Iterator[ArmState]:
        """Close the gripper; gives the states from the order on until its line has pressure, the first one before it.

        Raises:
            DeviceError: there is no pressure in time.
        """
        settings = self.settings
        self.leave()
        number = self.link.start([write_output(settings.grip_output, True)])
        start = state = self.link.read()
        yield start
        while state.done != number or not self._has_air(state, start):
            if state.time_s - start.time_s > settings.pressure_time_out_s + settings.air_s:
                limit_s, output = settings.pressure_time_out_s, settings.grip_output
                raise DeviceError(
                    f"The gripper's line has no pressure {limit_s:g} s after output {output} was switched on; look at "
                    f"the air and at input {settings.pressure_input}."
                )
            state = self.link.next(state.time_s)
            yield state

    def _has_air(self, state: ArmState, start: ArmState) -> bool:
        if self.settings.pressure_input is None:
            return state.time_s - start.time_s >= self.settings.air_s
        return state.is_input_on(self.settings.pressure_input)
