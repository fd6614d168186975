"""Calibration on traces of what the lake has: what to simulate for it, and what is inferred from.

Two thetas come of it. What is quoted, Table 2 and the draws, is theta of the bench, with what the mesh of the simulator
is worth in theta added to its uncertainty. The simulator version gets the medians without it: the theta with which this
simulator, on its own mesh, answers like the bench.
"""

from dataclasses import dataclass

from lake.store import Lake
from models.calibration.inference.settings import CalibrationSettings
from models.records import SimulatorVersion
from tasks.calibration.calibrate import CalibrationSource, Learned, Progress, new_version
from tasks.calibration.mean_data import base_version
from tasks.calibration.trace_data import TraceData, grid_plan, measured_campaigns, trace_data
from tasks.simulation.plan import SimulationPlan


@dataclass(frozen=True, eq=False)
class TraceCalibrationData(CalibrationSource):
    """Features of traces by tool and object; every measured design is learned from."""

    data = "trace"

    traces: TraceData

    @property
    def grasp_ids(self) -> tuple[str, ...]:
        """Ids of the grasps that went in."""
        return self.traces.grasp_ids

    @property
    def simulation_ids(self) -> tuple[str, ...]:
        """Ids of the simulations that went in."""
        return self.traces.simulation_ids

    @property
    def warnings(self) -> tuple[str, ...]:
        """Designs, objects and grasps that were left out."""
        return self.traces.warnings

    @property
    def summary(self) -> str:
        """How much there is to learn from."""
        problem = self.traces.problem
        return (
            f"{len(self.grasp_ids)} traces of {len(problem.tools)} tools on {len(problem.objects)} objects, "
            f"{len(self.simulation_ids)} simulated grasps around them"
        )

    def learn(self, settings: CalibrationSettings, progress: Progress | None) -> Learned:
        """Infer theta.

        Raises:
            UsageError: forces are a thousand times what theta can explain, or grid and priors do not meet.
        """
        from models.calibration.traces.calibrate import calibrate_traces, of_bench  # ArviZ takes seconds to import

        problem = self.traces.problem
        result = calibrate_traces(problem, settings, progress, theta_of="simulator")
        columns = {
            "n_designs": len(problem.tools),
            "n_objects": len(problem.objects),
            "n_simulations": len(self.simulation_ids),
            "n_held_out": 0,
        }
        return Learned(of_bench(result, problem), new_version(self.base, result), columns)


def gather_traces(lake: Lake, campaign_id: str | None, version_id: str | None) -> TraceCalibrationData:
    """Read what a calibration on traces compares.

    Raises:
        UsageError: it is not there, too little, or of several benches, setups, simulators.
    """
    base = _base(lake, campaign_id, version_id)
    return TraceCalibrationData(campaign_id, base, trace_data(lake, base, campaign_id))


def grid_simulations(lake: Lake, campaign_id: str | None, version_id: str | None) -> SimulationPlan:
    """Everything that `gather_traces` wants simulated, whether or not the lake has it.

    Raises:
        UsageError: nothing that can be compared was measured, or forces do not scale with Young's modulus.
    """
    return grid_plan(lake, _base(lake, campaign_id, version_id), campaign_id)


def _base(lake: Lake, campaign_id: str | None, version_id: str | None) -> SimulatorVersion:
    return base_version(lake, measured_campaigns(lake, campaign_id), version_id)
