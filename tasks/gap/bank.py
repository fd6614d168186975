"""The bank of gap discovery in the lake: what to simulate for it, and the simulations as arrays."""

import json
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from lake.provenance import current_provenance
from lake.store import Lake
from lake.tables.campaign import EventRow, SimTraceRow, SimulationRow
from models.calibration.traces.theta_grid import ThetaGrid
from models.errors import UsageError
from models.gap.bank.bank import (
    AMPLITUDES,
    NUMERICAL_MESHES,
    WIDE,
    WIDER_MM,
    Bank,
    BankPlan,
    EffectRuns,
    list_placed_setups,
    list_versions,
    list_wider_setups,
)
from models.gap.bank.sensor_effects import N_LEAD, read_lead
from models.gap.fit.theta import make_grid_bank
from models.ids import canonical_json, content_id
from models.records import Design, GraspSetup, SimulatorVersion, Theta, Trace
from models.traces.step_features import N_STEPS, is_usable, step_means
from tasks.gap.trace_rows import read_traces
from tasks.simulation.plan import SimulationPlan

BANK = "gap_bank"  # kind of the events that name banks around a fitted theta
# What a search simulates, in words.
WIDE_BANK, LOCAL_BANK, HELD_OUT = "the bank", "the bank around the fitted theta", "the set of held-out grasps"
_AT_ONCE = 4000  # traces held while they are averaged


def plan_bank(
    base: SimulatorVersion,
    designs: Sequence[Design],
    objects: Sequence[int],
    setup: GraspSetup,
    bank_plan: BankPlan = WIDE,
) -> tuple[SimulationPlan, ...]:
    """Simulations of a bank, for `tasks.simulation.plan.simulate_plan`, which makes what the lake lacks.

    Version by version over all designs, the centre first: a bank that is not complete lacks effects, not designs.
    """
    unique, versions = list(dict.fromkeys(designs)), list_versions(base, bank_plan)
    centre = versions[len(bank_plan.grid.points)]
    order = {version.version_id: version for version in (centre, *versions)}.values()
    points = tuple((design, version) for version in order for design in unique)
    at_centre = tuple((design, centre) for design in unique)
    others = (*list_placed_setups(setup), *list_wider_setups(setup))
    plans = [SimulationPlan(points, tuple(objects), setup)]
    return (*plans, *(SimulationPlan(at_centre, tuple(objects), other) for other in others))


def read_bank(
    lake: Lake,
    base: SimulatorVersion,
    designs: Sequence[Design],
    objects: Sequence[int],
    setup: GraspSetup,
    bank_plan: BankPlan = WIDE,
) -> Bank:
    """A bank of t designs on o objects, of what the lake has; NaN where a simulation failed or is missing.

    Raises:
        UsageError: no simulation at the centre of theta is there.
    """
    grid, versions = np.array(bank_plan.grid.points), list_versions(base, bank_plan)
    n_grid = len(grid)
    steps_n = read_simulated_steps(lake, versions, designs, objects, setup)
    placed_steps_n, wider_steps_n = (
        np.concatenate(
            [read_simulated_steps(lake, versions[n_grid : n_grid + 1], designs, objects, other) for other in others],
            axis=2,
        )
        for others in (list_placed_setups(setup), list_wider_setups(setup))
    )
    at_centre = steps_n[:, :, n_grid]
    if not np.isfinite(at_centre).any():
        raise UsageError(
            f"the lake {lake.address} has no simulation of the bank for these {len(designs)} designs on "
            f"{len(objects)} objects; `fast gap` makes them."
        )
    after = n_grid + 1 + len(NUMERICAL_MESHES)
    of_lead = partial(read_lead, setup=setup)
    lead_n = read_simulated_steps(lake, versions[:n_grid], designs, objects, setup, of_trace=of_lead, n=N_LEAD)
    parts = [values[..., 0] for values in (steps_n, placed_steps_n, wider_steps_n)]
    return Bank(
        centre=bank_plan.centre,
        grid=grid,
        grid_steps_n=steps_n[:, :, :n_grid],
        grid_lead_n=lead_n,
        centre_steps_n=at_centre,
        numerical_steps_n=steps_n[:, :, n_grid + 1 : after],
        placed_steps_n=placed_steps_n,
        wider_mm=np.array(WIDER_MM),
        wider_steps_n=wider_steps_n,
        effects=_part_effects(steps_n[:, :, after:], bank_plan.effects),
        failed_share=float(sum(np.isnan(part).sum() for part in parts) / sum(part.size for part in parts)),
    )


def list_bank_ids(
    base: SimulatorVersion,
    designs: Sequence[Design],
    objects: Sequence[int],
    setup: GraspSetup,
    bank_plan: BankPlan = WIDE,
) -> list[str]:
    """Ids of all simulations of a bank."""
    return list_plan_ids(plan_bank(base, designs, objects, setup, bank_plan))


def note_bank(lake: Lake, gap_id: str, campaign_id: str | None, bank_plan: BankPlan) -> None:
    """Write down that a search simulates a bank of its own, so that its thetas are known for what they are."""
    thetas = [theta.model_dump(mode="json") for theta in (bank_plan.centre, *bank_plan.grid_thetas)]
    centre, grid = bank_plan.centre, bank_plan.grid
    row = EventRow(
        event_id=content_id("E", [BANK, gap_id, thetas]),
        campaign_id=campaign_id or "",
        kind=BANK,
        message=(
            f"gap search {gap_id} simulates a bank around {centre.young_modulus_mpa:g} MPa, friction "
            f"{centre.friction:g} ({grid.friction[0]:g} to {grid.friction[1]:g}), Poisson ratio "
            f"{centre.poisson_ratio:g} ({grid.poisson_ratio[0]:g} to {grid.poisson_ratio[1]:g})"
        ),
        payload_json=canonical_json({"gap_id": gap_id, "thetas": thetas}),
    )
    if not lake.has(EventRow, row.event_id):
        lake.append([row], current_provenance())


def read_bank_thetas(lake: Lake) -> set[Theta]:
    """Every theta that a bank of gap discovery in this lake was simulated at, the wide bank's too."""
    payloads = (json.loads(row["payload_json"]) for row in lake.rows(EventRow, kind=BANK))
    own = {Theta.model_validate(theta) for payload in payloads for theta in payload["thetas"]}
    return {WIDE.centre, *WIDE.grid_thetas} | own


def list_plan_ids(plans: Sequence[SimulationPlan]) -> list[str]:
    """Ids of all simulations of plans."""
    return [
        SimulationRow.make_id(design.design_id, object_id, version.version_id, plan.setup.setup_id)
        for plan in plans
        for design, version in plan.points
        for object_id in plan.object_ids
    ]


def plan_theta_grid(
    base: SimulatorVersion, designs: Sequence[Design], objects: Sequence[int], setup: GraspSetup
) -> SimulationPlan:
    """The part of the bank that theta alone needs: the grid of friction and Poisson ratio."""
    versions = list_versions(base)[: len(ThetaGrid().points)]
    points = tuple((design, version) for design in dict.fromkeys(designs) for version in versions)
    return SimulationPlan(points, tuple(objects), setup)


def read_grid_bank(
    lake: Lake, base: SimulatorVersion, designs: Sequence[Design], objects: Sequence[int], setup: GraspSetup
) -> Bank:
    """The bank for theta alone: the grid of t designs on o objects, of what the lake has.

    Raises:
        UsageError: no cell has enough of the grid.
    """
    versions = list_versions(base)[: len(ThetaGrid().points)]
    of_lead = partial(read_lead, setup=setup)
    return make_grid_bank(
        read_simulated_steps(lake, versions, designs, objects, setup),
        read_simulated_steps(lake, versions, designs, objects, setup, of_trace=of_lead, n=N_LEAD),
    )


def _part_effects(steps_n: np.ndarray, effects: Sequence[str]) -> dict[str, EffectRuns]:
    """Effects of a bank from their simulations (t x o x n x 120), in order."""
    found, start = {}, 0
    for effect in effects:
        parameters = AMPLITUDES[effect]
        end = start + len(parameters)
        found[effect] = EffectRuns(effect, parameters, steps_n[:, :, start:end])
        start = end
    return found


def read_simulated_steps(
    lake: Lake,
    versions: Sequence[SimulatorVersion],
    designs: Sequence[Design],
    objects: Sequence[int],
    setup: GraspSetup,
    *,
    of_trace: Callable[[Trace], np.ndarray] = step_means,
    n: int = N_STEPS,
) -> np.ndarray:
    """Step means of simulations, t x o x v x 120; NaN where there is no usable trace.

    of_trace: another reading of a trace instead, of `n` numbers.
    """
    setup_id, columns_of = setup.setup_id, defaultdict[str, list[int]](list)
    for v, version in enumerate(versions):
        columns_of[version.version_id].append(v)
    places: dict[str, tuple[list[int], int, list[int]]] = {}
    for design in dict.fromkeys(designs):
        rows = [t for t, other in enumerate(designs) if other == design]
        for o, object_id in enumerate(objects):
            for version_id, columns in columns_of.items():
                places[SimulationRow.make_id(design.design_id, object_id, version_id, setup_id)] = rows, o, columns
    steps_n = np.full((len(designs), len(objects), len(versions), n), np.nan)
    ids = list(places)
    for start in range(0, len(ids), _AT_ONCE):
        for simulation_id, trace in read_traces(lake, SimTraceRow, ids[start : start + _AT_ONCE]):
            if is_usable(trace):
                rows, o, columns = places[simulation_id]
                steps_n[np.ix_(rows, [o], columns)] = of_trace(trace)
    return steps_n
