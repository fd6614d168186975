"""What a calibration compares, from the lake: measured tools, and simulated designs with a theta of their own."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fast.lake.store import Lake
from fast.lake.tables.campaign import CalibrationRow, CampaignRow, SimulatorVersionRow, ToolRow
from fast.lake.tables.imported import is_imported
from fast.models.calibration.means.hypercube import HypercubePlan, draw_hypercube
from fast.models.calibration.means.problem import MIN_DESIGNS, MIN_SIMULATIONS, CalibrationProblem
from fast.models.design.space import FIN_RAYS, to_unit
from fast.models.errors import UsageError
from fast.models.ids import canonical_json
from fast.models.records import Design, GraspSetup, Theta
from fast.models.scientist.surrogate.imputation import mean_over_objects
from fast.models.simulation.effects.scaling import scales_with_modulus
from fast.models.simulation.version import SimulatorVersion
from fast.models.units import spell_count
from fast.models.validation import closest, load_record
from fast.tasks.campaign.config import CampaignConfig, read_stored_config
from fast.tasks.campaign.state import THICKNESSES, ProposedTool, load_designs, tuples
from fast.tasks.gap.bank import read_bank_thetas
from fast.tasks.gap.trace_rows import require_one_bench
from fast.tasks.simulation.plan import SimulationPlan

LEAST_SHARE = 0.5  # of the objects a tool must have been measured on to count


class TooLittleDataError(UsageError):
    """The lake has not enough yet to calibrate with; later it may."""


@dataclass(frozen=True, eq=False)
class MeasuredTools:
    """Measured tools, in the order in which they were first measured."""

    campaign_id: str | None
    """That was asked for; None: all that are in the lake."""
    campaign_ids: tuple[str, ...]
    """That they are of."""
    setup: GraspSetup
    """How all were grasped."""
    object_ids: tuple[int, ...]
    """Of the columns of `forces_n`."""
    tool_ids: tuple[str, ...]
    """Of its rows."""
    designs: tuple[Design, ...]
    """The fingers as they were printed, m."""
    design_ids: tuple[str, ...]
    """What each tool was printed from, m."""
    points: np.ndarray
    """The fingers as they were printed, m x 9, in the unit cube."""
    forces_n: np.ndarray
    """m x n_objects, mean peak over the repeats, NaN where there is none."""
    grasp_ids: tuple[str, ...]
    """Of all grasps behind them."""
    warnings: tuple[str, ...] = ()
    """What a person should know of them, in sentences."""


@dataclass(frozen=True, eq=False)
class SimulatedPoints:
    """Designs simulated at thetas of their own. points: n x 9. theta: n x 3. forces_n: n x n_objects, NaN if failed.

    is_imported: by another lab's simulator, of which only theta is known.
    """

    points: np.ndarray
    theta: np.ndarray
    forces_n: np.ndarray
    simulation_ids: tuple[str, ...]
    is_imported: bool = False


def read_measured_tools(lake: Lake, campaign_id: str | None, only: Collection[str] | None = None) -> MeasuredTools:
    """Read the measured tools of a campaign, or of the whole lake; by grasps with these ids, if some are given.

    Raises:
        TooLittleDataError: nothing, or of too few tools, was measured.
        UsageError: what was measured cannot be compared with one simulator.
    """
    where = f"campaign {campaign_id}" if campaign_id else f"the lake {lake.address}"
    sql = f"""SELECT grasp_id, campaign_id, tool_id, design_id, object_id, peak_force_n, setup_json,
            coalesce(lab, ''), bench || ' ' || coalesce(world_hash, ''), setup_id, request_id FROM grasps
        WHERE status = 'ok' {"AND campaign_id = ?" if campaign_id else ""}
        ORDER BY sequence, created_at, "order", tool_id, grasp_id"""
    every = [
        row for row in tuples(lake, sql, *([campaign_id] if campaign_id else [])) if only is None or row[0] in only
    ]
    rows, warnings = _keep_base(every)
    if not rows:
        raise TooLittleDataError(
            f"{where} has no measured grasps, so there is nothing to calibrate with; measure tools with "
            "`fast campaign run` or import data with `fast lake import`."
        )
    grasp_ids, campaigns, tools, designs, objects, peaks_n, setup_texts, labs, benches = map(
        list, zip(*rows, strict=True)
    )
    require_one_bench(zip(labs, benches, strict=True), where)
    object_ids = _common_objects(lake, campaigns, objects)
    forces_n = _mean_table(tools, objects, peaks_n, object_ids)
    tool_ids = list(dict.fromkeys(tools))
    is_enough = np.isfinite(forces_n).mean(axis=1) >= LEAST_SHARE
    kept = [tool_id for tool_id, enough in zip(tool_ids, is_enough, strict=True) if enough]
    left_out = [tool_id for tool_id in tool_ids if tool_id not in set(kept)]
    design_of = dict(zip(tools, designs, strict=True))
    design_ids = tuple(design_of[tool_id] for tool_id in kept)
    found = _designs(lake, design_ids)
    if len(kept) < MIN_DESIGNS:
        raise TooLittleDataError(
            f"{where} has {spell_count(len(kept), 'measured tool')}, a calibration needs at least {MIN_DESIGNS}; "
            "measure more."
        )
    return MeasuredTools(
        campaign_id=campaign_id,
        campaign_ids=tuple(dict.fromkeys(campaigns)),
        setup=GraspSetup.model_validate_json(setup_texts[0]),
        object_ids=object_ids,
        tool_ids=tuple(kept),
        designs=tuple(found),
        design_ids=design_ids,
        points=_printed_points(lake, kept, found),
        forces_n=forces_n[is_enough],
        grasp_ids=tuple(g for g, tool_id in zip(grasp_ids, tools, strict=True) if tool_id in set(kept)),
        warnings=(*warnings, *_left_out_warning(left_out)),
    )


def find_base_version(lake: Lake, campaign_ids: Iterable[str], version_id: str | None) -> SimulatorVersion:
    """Find the simulator that is to be calibrated: the one asked for, else the one that these campaigns consult.

    Imported campaigns consult none; with them alone it is the program's own.

    Raises:
        UsageError: there is no such version, or campaigns consult simulators that differ in more than theta.
    """
    if version_id is not None:
        rows = {row.version_id: row for row in lake.records(SimulatorVersionRow) if row.tier != "imported"}
        if version_id not in rows:
            raise UsageError(
                f"simulator version `{version_id}` is not in {lake.address}; {closest(version_id, list(rows))}"
            )
        return rows[version_id].version
    versions = _consulted(lake, set(campaign_ids))
    if len({describe_family(version) for version in versions.values()}) > 1:
        raise UsageError(
            f"campaigns {', '.join(versions)} consult simulators that differ in more than theta; "
            "give one --campaign or the --version to calibrate."
        )
    return list(versions.values())[-1] if versions else SimulatorVersion()


def describe_family(version: SimulatorVersion) -> str:
    """Describe everything of a simulator version but theta: versions of one family differ in theta alone."""
    return canonical_json(version.model_dump(exclude={"theta"}))


def read_simulated_points(
    lake: Lake, base: SimulatorVersion, measured: MeasuredTools, only: Collection[str] | None = None
) -> SimulatedPoints:
    """Read designs simulated by the family of `base` on the measured objects, each with a theta that was drawn.

    By simulations with these ids, if some are given.

    Versions that somebody believes in (campaigns consult them, calibrations found them) are left out: what is simulated
    with them grows with every calibration. So are those of the grid of a calibration on traces and of the bank of a gap
    search, which are measured designs at a dozen thetas, and designs that miss an object, and those that failed on all.
    Without any of this family, simulations that were imported with their theta count.

    Raises:
        TooLittleDataError: there are none.
    """
    own = {version_id: version.theta for version_id, version in _drawn_versions(lake, base).items()}
    if found := _read_points(lake, own, measured, only):
        return found
    if found := _read_points(lake, _imported_thetas(lake), measured, only):
        return replace(found, is_imported=True)
    raise TooLittleDataError(_nothing_simulated(lake, base, measured))


def _read_points(
    lake: Lake, thetas: Mapping[str, Theta], measured: MeasuredTools, only: Collection[str] | None
) -> SimulatedPoints | None:
    """Read the designs simulated on all measured objects by these versions; None if there are none."""
    sql = f"""SELECT simulation_id, version_id || '/' || design_id, design_id, version_id, object_id,
            CASE WHEN status = 'ok' THEN peak_force_n END FROM simulations
        WHERE setup_id = ? AND object_id IN ({", ".join(map(str, measured.object_ids))})
        ORDER BY version_id, design_id, object_id"""
    rows = [row for row in tuples(lake, sql, measured.setup.setup_id) if row[3] in thetas]
    rows = [row for row in rows if only is None or row[0] in only]
    objects_of: dict[str, set[int]] = {}
    for row in rows:
        objects_of.setdefault(row[1], set()).add(row[4])
    rows = [row for row in rows if len(objects_of[row[1]]) == len(measured.object_ids)]
    if not rows:
        return None
    simulation_ids, keys, designs, version_ids, objects, peaks_n = map(list, zip(*rows, strict=True))
    forces_n = _mean_table(keys, objects, peaks_n, measured.object_ids)
    has_value = np.isfinite(forces_n).any(axis=1)
    first = [keys.index(key) for key in dict.fromkeys(keys)]
    known = load_designs(lake)
    theta = np.array([list(thetas[version_ids[i]].model_dump().values()) for i in first])
    return SimulatedPoints(
        points=to_unit([known[designs[i]] for i in first])[has_value],
        theta=theta[has_value],
        forces_n=forces_n[has_value],
        simulation_ids=tuple(simulation_ids),
    )


def check_enough(lake: Lake, base: SimulatorVersion, measured: MeasuredTools, plan: HypercubePlan) -> None:
    """Refuse a hypercube after which there would still be too few simulated designs.

    Raises:
        UsageError: it has too few points.
    """
    try:
        n_known = len(read_simulated_points(lake, base, measured).theta)
    except TooLittleDataError:
        n_known = 0
    if n_known + plan.n < MIN_SIMULATIONS:
        raise UsageError(
            f"--simulate {plan.n} would make {n_known + plan.n} simulated designs, a calibration needs at least "
            f"{MIN_SIMULATIONS}; ask for --simulate {MIN_SIMULATIONS - n_known} or more. Nothing was simulated."
        )


def plan_hypercube(plan: HypercubePlan, base: SimulatorVersion, measured: MeasuredTools) -> SimulationPlan:
    """Plan the points of a plan as simulations by the family of `base`, grasped as the measured tools were."""
    points = tuple((p.design, base.model_copy(update={"theta": p.theta})) for p in draw_hypercube(plan))
    return SimulationPlan(points, measured.object_ids, measured.setup, plan.plan_id, plan.seed)


def make_problem(
    measured: MeasuredTools, simulated: SimulatedPoints, base: SimulatorVersion, print_scatter: float = 0.0
) -> CalibrationProblem:
    """Make the means over the objects, missing ones predicted from the others.

    `print_scatter`, relative, adds to the variance of a measured mean what the stiffness of prints scatters: force is
    proportional to it, so the strongest tools are the least certain.

    Where forces scale with Young's modulus, simulated ones are filled in N per MPa: over designs of 2 to 200 MPa,
    what objects have in common would be their modulus alone.

    Raises:
        UsageError: there is too little to learn from.
    """
    scales = scales_with_modulus(base) and not simulated.is_imported
    modulus_mpa = simulated.theta[:, 0] if scales else np.ones(len(simulated.theta))
    y_sim, variance_sim = mean_over_objects(simulated.forces_n / modulus_mpa[:, None])
    y_real, variance_real = mean_over_objects(measured.forces_n)
    return CalibrationProblem(
        x_sim=simulated.points,
        theta_sim=simulated.theta,
        y_sim=y_sim * modulus_mpa,
        variance_sim=variance_sim * modulus_mpa**2,
        x_real=measured.points,
        y_real=y_real,
        variance_real=variance_real + (print_scatter * y_real) ** 2,
        scales_with_modulus=scales,
    )


def _keep_base(rows: Sequence[tuple[Any, ...]]) -> tuple[list[tuple[Any, ...]], tuple[str, ...]]:
    """Keep ordinary grasps at the setup of most of them, without setup and request; add a sentence on the others."""
    ordinary = [row for row in rows if row[-1] is None]
    counts = Counter(sorted(row[-2] for row in ordinary))
    base = [row[:-2] for row in ordinary if row[-2] == counts.most_common(1)[0][0]]
    n_others = len(rows) - len(base)
    if not n_others:
        return base, ()
    return base, (
        f"means are compared at one grasp setup: {n_others} of {len(rows)} grasps were made at another or asked for by "
        "a search, and are left out.",
    )


def _common_objects(lake: Lake, campaigns: Sequence[str], objects: Sequence[int]) -> tuple[int, ...]:
    """Return the objects that the campaigns have in common: every one measured them or has them in its config.

    A campaign that was stopped early has reached a few of its objects; its tools miss the others as tools do that a
    person left unfinished.

    Raises:
        UsageError: campaigns are of different ones, so that their means differ by more than the tools.
    """
    by_campaign: dict[str, set[int]] = {}
    for campaign, object_id in zip(campaigns, objects, strict=True):
        by_campaign.setdefault(campaign, set()).add(object_id)
    every = set(objects)
    if any(found != every for found in by_campaign.values()):
        for name, config in _stored_configs(lake, set(by_campaign)).items():
            by_campaign[name] |= every & set(config.objects.object_ids)
    if any(found != every for found in by_campaign.values()):
        counts = ", ".join(f"{name}: {len(found)}" for name, found in by_campaign.items())
        raise UsageError(f"campaigns were measured on different objects ({counts}); give one --campaign.")
    return tuple(sorted(every))


def _mean_table(
    keys: Sequence[str], objects: Sequence[int], forces_n: Sequence[float | None], object_ids: Sequence[int]
) -> np.ndarray:
    """Compute the mean force of each key (in order of appearance) on each object, N, NaN where there is none."""
    row_of = {key: i for i, key in enumerate(dict.fromkeys(keys))}
    column_of = {object_id: i for i, object_id in enumerate(object_ids)}
    total, count = np.zeros((2, len(row_of), len(column_of)))
    for key, object_id, force_n in zip(keys, objects, forces_n, strict=True):
        if force_n is not None:
            total[row_of[key], column_of[object_id]] += force_n
            count[row_of[key], column_of[object_id]] += 1
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _designs(lake: Lake, design_ids: Sequence[str]) -> list[Design]:
    known = load_designs(lake)
    unknown = [design_id for design_id in dict.fromkeys(design_ids) if design_id not in known]
    if unknown:
        raise UsageError(
            f"{len(unknown)} measured designs ({', '.join(unknown[:3])}) are not in the table of designs, so their "
            "nine parameters are unknown; import them with their designs.csv."
        )
    return [known[design_id] for design_id in design_ids]


def _printed_points(lake: Lake, tool_ids: Sequence[str], designs: Sequence[Design]) -> np.ndarray:
    """Return fingers as they were printed, m x 9: thicknesses as measured where a person measured them."""
    printed = {row["tool_id"]: row for row in lake.rows(ToolRow, tool_id=list(tool_ids))}
    points = []
    for tool_id, design in zip(tool_ids, designs, strict=True):
        said = printed.get(tool_id, {})
        thicknesses = {name: said.get(f"measured_{name}") for name in THICKNESSES}
        measured_mm = {name: value for name, value in thicknesses.items() if value is not None}
        points.append(ProposedTool(tool_id, 0, 0, design, measured_mm=measured_mm).mounted_point(FIN_RAYS))
    return np.array(points)


def _left_out_warning(tool_ids: Sequence[str]) -> tuple[str, ...]:
    if not tool_ids:
        return ()
    words = f"tool {tool_ids[0]} is" if len(tool_ids) == 1 else f"{len(tool_ids)} tools ({tool_ids[0]}, ...) are"
    return (f"{words} measured on fewer than half of the objects and left out.",)


def _consulted(lake: Lake, campaign_ids: set[str]) -> dict[str, SimulatorVersion]:
    """Return the simulator in the config of each campaign that has one, oldest first."""
    return {name: config.simulator.version for name, config in _stored_configs(lake, campaign_ids).items()}


def _stored_configs(lake: Lake, campaign_ids: set[str]) -> dict[str, CampaignConfig]:
    """Return the config of each campaign that has one, oldest first; imported ones have none."""
    rows = [row for row in lake.records(CampaignRow) if row.campaign_id in campaign_ids]
    configured = [row for row in rows if not is_imported(row.config_toml)]
    return {row.campaign_id: read_stored_config(row.config_toml, row.campaign_id) for row in configured}


def _drawn_versions(lake: Lake, base: SimulatorVersion) -> dict[str, SimulatorVersion]:
    """Return simulator versions with a theta drawn for a calibration: of no belief, trace grid or bank of a gap."""
    believed = [base, *_consulted(lake, {row.campaign_id for row in lake.records(CampaignRow)}).values()]
    calibrated = {row.version_id for row in lake.records(CalibrationRow)}
    rows = lake.records(SimulatorVersionRow, tier=base.tier)
    # By theta, not id: held-out grasps are also simulated with a calibrated theta less some of its effects.
    known = read_bank_thetas(lake) | {version.theta for version in believed}
    known |= {row.version.theta for row in rows if row.version_id in calibrated}
    wanted = describe_family(base)
    return {
        row.version_id: row.version
        for row in rows
        if row.version.theta not in known and describe_family(row.version) == wanted
    }


def _imported_thetas(lake: Lake) -> dict[str, Theta]:
    """Return the thetas of imported simulations, by version; of those that told all three."""
    rows = lake.rows(SimulatorVersionRow, tier="imported")
    told = {row["version_id"]: {name: row[name] for name in Theta.model_fields} for row in rows}
    return {
        version_id: load_record(Theta, values, f"theta of {version_id}")
        for version_id, values in told.items()
        if None not in values.values()
    }


def _nothing_simulated(lake: Lake, base: SimulatorVersion, measured: MeasuredTools) -> str:
    versions = [row.version for row in lake.records(SimulatorVersionRow) if row.tier != "imported"]
    n_others = sum(describe_family(version) != describe_family(base) for version in versions)
    others = f" ({n_others} simulator versions of another mesh, tier, effect or code are there)" if n_others else ""
    return (
        f"{lake.address} has no design that is simulated with a theta of its own on the {len(measured.object_ids)} "
        f"measured objects, grasped alike, by the simulator of {base.version_id}{others}; add --simulate 100."
    )
