"""Grasps that a worker process elsewhere makes up: little to import, and quick."""

import os
import time

import numpy as np

from fast.models.records import GraspSimulation, Trace
from fast.tasks.simulation.attempt import Attempt, GraspJob

BAD_OBJECT = 14
SLOW_S = 1.5


def made_up(job: GraspJob) -> Attempt:
    """Succeeds on every object but one."""
    if job.object_id == BAD_OBJECT:
        return Attempt(None, "no_convergence", "No equilibrium.", cpu_s=0.1, mesh_cpu_s=0.0, wall_s=0.1)
    lift_mm = np.linspace(0.0, 10.0, 11)
    trace = Trace(time_s=lift_mm / 5, lift_mm=lift_mm, force_n=np.sin(lift_mm))
    numbers = {"peak_force_n": 1.0, "contact_force_n": 2.0, "work_j": 0.1, "cpu_s": 0.1}
    result = GraspSimulation(trace=trace, **numbers, n_steps=3, n_newton=9, n_dof=30)
    return Attempt(result, "", "", cpu_s=0.1, mesh_cpu_s=0.0, wall_s=0.1)


def slowly_made_up(job: GraspJob) -> Attempt:
    """The same, in a while in which a worker can be killed."""
    time.sleep(SLOW_S)
    return made_up(job)


def pid_after(seconds: float) -> int:
    """Id of the process that has waited."""
    time.sleep(seconds)
    return os.getpid()
