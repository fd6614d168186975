"""What the scenario tests share: a quick world, and moments of a grasp at which something goes wrong."""

import numpy as np

from fast.hardware.bench import open_virtual_bench
from fast.hardware.tools.mounted import MountedTool
from fast.hardware.virtual.world.file import Sensor, World
from fast.models.design.fin_ray import FinRay
from fast.models.records import GraspSetup, GraspSimulation, Trace

DESIGN = FinRay(
    length_mm=30, width_mm=30, height_mm=110, tip_length_mm=25, front_thickness_mm=2.5, back_thickness_mm=2.5,
    rib_thickness_mm=2.5, rib_count=5, rib_angle_deg=0,
)  # fmt: skip
TOOLS = {0: MountedTool("a/B01T0", DESIGN), 3: MountedTool("a/B01T3", DESIGN)}
WORLD = World(seed=7, sensor=Sensor(noise_sd_n=0.12))
SETUP = GraspSetup()
REST_Z_MM = 78.0  # height of a grasp with this design


def physics(request):
    """An analytic grasp: pulled with up to 8 N, released at 48 mm."""
    setup = request.setup
    closing_s = (setup.open_gap_mm - setup.closed_gap_mm) / 2 / setup.close_speed_mm_per_s
    closing = np.linspace(0, 1, 30)
    lift_mm = np.linspace(0, setup.max_lift_mm, 321)[1:]
    force_n = np.where(lift_mm < 48.0, 8.0 * np.sin(np.pi * lift_mm / 48.0) ** 2 + lift_mm / 48.0, 0.0)
    trace = Trace(
        np.concatenate([closing * closing_s, closing_s + lift_mm / setup.lift_speed_mm_per_s]),
        np.concatenate([np.zeros(30), lift_mm]),
        np.concatenate([-(closing**3), force_n]),
    )
    return GraspSimulation(trace, 8.0, 5.0, 0.2, 1, 1, 1, 0.0)


def open_bench(wires="memory"):
    """The quick world on a bench; wires in memory carry the same bytes as lines, at a tenth of the price."""
    return open_virtual_bench(WORLD, TOOLS, physics, wires=wires)


def is_travelling(virtual):
    """On the way from the dock to the first object."""
    _, y_mm, z_mm = virtual.grbl.position_mm()
    return virtual.state.tool is not None and y_mm < 1000 and z_mm > 170


def is_down(virtual):
    """Open at the height of the grasp."""
    return virtual.state.tool is not None and virtual.grbl.position_mm()[2] < REST_Z_MM + 0.01


def is_pulling(virtual):
    """In the middle of a lift."""
    return virtual.state.grasp_force_n() > 4.0


def is_free(virtual):
    """Lifted until the object has let go, the gripper still closed."""
    return virtual.state.outputs[1] and virtual.grbl.position_mm()[2] > REST_Z_MM + 49.0


def when(bench, is_moment, act, virtual=None):
    """Do something, once, at a moment; `virtual` where the bench does not know that it is one."""
    virtual = virtual or bench.virtual

    def watch(_now_s):
        if is_moment(virtual):
            bench.clock.remove_listener(watch)
            act()

    bench.clock.add_listener(watch)
