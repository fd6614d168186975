"""The hooks by which an effect reaches into the grasp simulator, one per layer of physics.

Every method's default is "changes nothing", so an effect overrides only what it touches and a list of
effects is applied by calling each in order. Amplitude zero must reproduce the simulator without the effect.
"""

import numpy as np
from shapely.geometry import Polygon

from models.records import Design, GraspSetup, Theta, Trace


class Effect:
    """An effect that changes nothing; subclasses override the hooks of their layer."""

    def modify_profile(self, profile: Polygon, design: Design) -> Polygon:
        """Geometry: the planar profile (mm) that is really printed."""
        return profile

    def modify_theta(self, theta: Theta, design: Design) -> Theta:
        """Material: elastic constants of this tool."""
        return theta

    def modify_setup(self, setup: GraspSetup, design: Design) -> GraspSetup:
        """Actuation: the stroke, heights and speeds that really happen."""
        return setup

    def closing_force_limit_n(self) -> float:
        """Actuation: closing-direction force at which one jaw stalls, N; it then holds its place in the lift."""
        return np.inf

    def friction_factor(self, slip_mm: np.ndarray, pressure_mpa: np.ndarray) -> np.ndarray | float:
        """Contact: factor on the friction coefficient per contact point (n), frozen over a time step.

        `slip_mm`: accumulated slip of each point; `pressure_mpa`: its last converged contact pressure.
        """
        return 1.0

    def modify_trace(self, trace: Trace) -> Trace:
        """Sensor: what the load-cell chain reports of the true force."""
        return trace
