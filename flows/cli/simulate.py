"""`fast simulate`: one grasp of one design on one object, new or repeated from a lake."""

import json as json_module
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from fast.flows.cli.campaign import open_lake
from fast.flows.cli.common import DEFAULT_LAKE, OBJECT_HELP, AsJson, LakePath, say, show, table_text
from fast.flows.cli.live import open_reporter
from fast.flows.cli.simulate_output import make_folder, write_outputs, write_table
from fast.models.errors import ConfigError, UsageError
from fast.models.units import spell_name

if TYPE_CHECKING:
    from fast.models.objects.rigid import RigidObject
    from fast.models.records import Design, GraspSetup, GraspSimulation, Placement
    from fast.models.simulation.inputs import GraspInputs
    from fast.models.simulation.tolerances import Tolerances
    from fast.models.simulation.version import SimulatorVersion

    Grasp = tuple[Design, RigidObject, SimulatorVersion, GraspSetup, Placement]

BEST = Path("best")

NUMBERED = re.compile(r"random-(\d{1,6})")


@Parameter(name="*")
@dataclass(frozen=True)
class Asked:
    """Which grasp: a design on an object by a simulator version, or one of the lake."""

    design: Annotated[
        Path | None,
        Parameter(
            help="JSON file with the nine parameters, or random-N: design N of the benchmarks; "
            "`best`, as without it: the best published design."
        ),
    ] = None
    object: Annotated[str | None, Parameter(help=OBJECT_HELP)] = None
    version: Annotated[
        str | None, Parameter(help="Simulator version (V...) of the lake; default: the program's own values.")
    ] = None
    tier: Annotated[str | None, Parameter(help="production or reference, each with its own mesh.")] = None
    simulation: Annotated[
        str | None, Parameter(help="Simulation (S...) of the lake: repeat it, in place of all the options above.")
    ] = None
    set: Annotated[
        list[str] | None,
        Parameter(
            negative="",
            help="One value of theta, grasp, mesh or placement, e.g. friction=0.5 or yaw_deg=5; may be given several "
            "times.",
        ),
    ] = None

    def read(self, lake: Path) -> "Grasp":
        """Read design, object, simulator version, setup and placement.

        Raises:
            UsageError: no object, options that exclude each other, or an id that the lake does not have.
            ConfigError: a design file or a setting that cannot be used.
        """
        from fast.models.records import Placement
        from fast.tasks.objects import find_object

        if self.simulation is not None:
            refuse_beside("simulation", {name: value for name, value in vars(self).items() if name != "simulation"})
            return *read_simulation(lake, self.simulation), Placement()
        if self.object is None:
            raise UsageError(f"`fast simulate` needs --object: {OBJECT_HELP} See `fast simulate --help`.")
        base = _base_version(lake, self.version, self.tier)
        return read_design(self.design), find_object(self.object, lake), *apply_settings(self.set or [], base)


def simulate(
    *,
    asked: Asked = Asked(),
    along: Annotated[
        list[str] | None,
        Parameter(
            negative="",
            help="Slopes of force and peak by parameters, e.g. friction,length_mm; `all`: those of finger, material "
            "and closing; with commas or several times.",
        ),
    ] = None,
    tolerance: Annotated[
        list[str] | None,
        Parameter(
            negative="",
            help="Standard deviation between prints and mountings, for that of the peak, e.g. wall_offset_mm=0.15, "
            "offset_z_mm, closed_gap_mm; 0 leaves one out; with commas or several times.",
        ),
    ] = None,
    out: Annotated[Path | None, Parameter(help="Folder for numbers, trace, pictures and a Rerun recording.")] = None,
    designs: Annotated[
        Path | None,
        Parameter(help="CSV file of designs, in place of --design: each on --object, or on all objects; one table."),
    ] = None,
    family: Annotated[str, Parameter(help="Family of --designs: fin-ray, graded-fin-ray, free-form, module:Class.")] = (
        "fin-ray"
    ),
    workers: Annotated[int, Parameter(help="Processes that simulate --designs.")] = 2,
    lake: LakePath = DEFAULT_LAKE,
    json: AsJson = False,
) -> None:
    """Simulate one grasp: closing, lift and pull-off. Without --out, nothing is written."""
    if designs is not None:
        others = {"simulation": asked.simulation, "along": along, "tolerance": tolerance}
        refuse_beside("designs", {"design": asked.design, **others})
        simulate_file(designs, family, asked, workers, out, lake, json)
        return
    from fast.models.simulation.grasp import simulate_grasp
    from fast.models.simulation.inputs import GraspInputs
    from fast.models.simulation.output.recording import GraspRecording

    design, met, simulator, setup, placement = asked.read(lake)
    if out is not None:
        make_folder(out)
    recording = GraspRecording()
    recorder = None if out is None else recording.add
    tolerances, names = read_tolerances(tolerance or []), split_commas(along or [])
    result = simulate_grasp(design, met, simulator, setup, placement=placement, recorder=recorder, along=names)
    inputs = GraspInputs(design, met, simulator, setup, placement)
    scatter = _scatter_of(inputs, tolerances) if tolerances.stated else {}
    ids = {"design_id": design.design_id, "object_id": met.object_id, "version_id": simulator.version_id}
    data = {**ids, "placement": placement.model_dump(), **_numbers_of(result), **scatter, **_slopes_of(result)}
    show(data, describe_grasp(data), json)
    files = [] if out is None else write_outputs(out, design, met, placement, data, result, recording)
    if files and not json:
        say("wrote " + ", ".join(map(str, files)))


def simulate_file(
    designs: Path, family: str, asked: Asked, workers: int, out: Path | None, lake: Path, as_json: bool
) -> None:
    """Simulate a file of designs and show them as a table, the best first; with `out` also as CSV files."""
    from fast.flows.simulation.many_designs import simulate_designs
    from fast.models.design.families import find_family
    from fast.models.objects.catalogue import OBJECTS
    from fast.tasks.campaign.own_designs import read_designs
    from fast.tasks.objects import find_object

    if not 1 <= workers <= 256:
        raise UsageError(f"--workers is {workers}, it must be from 1 to 256; change it.")
    found = read_designs(designs, family=find_family(family))
    objects = OBJECTS if asked.object is None else (find_object(asked.object, lake),)
    version, setup, placement = apply_settings(asked.set or [], _base_version(lake, asked.version, asked.tier))
    if out is not None:
        make_folder(out)
    with open_reporter() as reporter:
        done = simulate_designs(found, objects, version, setup, placement, workers, reporter)
    done.sort(key=lambda one: -float(str(one.row["mean_n"] or 0.0)))  # the one with the largest mean force first
    rows = [one.row for one in done]
    grasps = [
        {
            "name": one.own.name,
            "object_id": obj.object_id,
            "object": f"{obj.name} ({obj.object_id})",
            "peak_force_n": force_n,
        }
        for one in done
        for obj, force_n in zip(one.objects, one.forces_n, strict=True)
    ]
    show({"version_id": version.version_id, "designs": rows, "grasps": grasps}, table_text(rows), as_json)
    if out is not None:
        files = [write_table(out / "designs.csv", rows), write_table(out / "grasps.csv", grasps)]
        if not as_json:
            say("wrote " + ", ".join(map(str, files)))


def _numbers_of(result: "GraspSimulation") -> dict[str, Any]:
    names = ("peak_force_n", "contact_force_n", "work_j", "pressure_kpa", "twist_deg", "n_steps", "n_dof", "cpu_s")
    return {name: getattr(result, name) for name in names}


def split_commas(values: list[str]) -> list[str]:
    """Split what an option was given, which may stand there several times and have commas."""
    return [word.strip() for value in values for word in value.split(",")]


def read_tolerances(values: list[str]) -> "Tolerances":
    """Read tolerances, the usual ones but for those that are given as NAME=MM, or several with commas.

    Raises:
        UsageError: no NAME=MM, an unknown name, or a value out of its range.
    """
    from fast.models.simulation.tolerances import Tolerances
    from fast.models.validation import load_record

    pairs = [word.partition("=") for word in split_commas(values)]
    try:
        return load_record(Tolerances, {name.strip(): number for name, _, number in pairs}, "--tolerance")
    except ConfigError as error:
        raise UsageError(str(error)) from error


def _scatter_of(inputs: "GraspInputs", tolerances: "Tolerances") -> dict[str, Any]:
    from fast.models.simulation.scatter import find_scatter

    sd_n, missing = find_scatter(inputs, tolerances)
    return {"peak_sd_n": sd_n, "sd_is_of": tolerances.describe(missing), "sd_is_without": list(missing)}


def _slopes_of(result: "GraspSimulation") -> dict[str, Any]:
    """List the slopes of the peak, the one whose usual change matters most first; nothing if not asked for."""
    from fast.flows.report.slopes import peak_changes

    if result.slopes is None:
        return {}
    rows = [
        {
            "parameter": name,
            "peak_slope": slope.peak_n,
            "unit": slope.unit,
            "usual_change": slope.usual,
            "peak_change_n": change_n,
            "finite_step": slope.step,
        }
        for name, slope, change_n in peak_changes(result.slopes)
    ]
    return {"slopes": rows, "slopes_trusted_mm": result.slopes.trusted_mm, "slopes_lost": result.slopes.lost}


def read_design(path: Path | None) -> "Design":
    """Read a design from a JSON file, a numbered random design (`random-N`), or the best published one.

    Raises:
        ConfigError: missing file, no JSON, or a value out of its range.
    """
    from fast.models.design.families import read_design as read_family_design
    from fast.models.design.fin_ray import FinRay
    from fast.models.design.space import BEST_PUBLISHED, numbered_design
    from fast.models.validation import load_record, parse_json

    if path is None or path == BEST:
        return BEST_PUBLISHED
    if numbered := NUMBERED.fullmatch(str(path)):
        return numbered_design(int(numbered[1]))
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(f"design file `{path}` cannot be read: {error.strerror}; give an existing file.") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"design file `{path}` is not JSON: {error}; correct it.") from error
    values = parse_json(text, f"design file `{path}`")
    if not isinstance(values, dict):
        return load_record(FinRay, values, str(path))
    family = values.pop("family", None)
    if not isinstance(family, str | None):
        raise ConfigError(f"{path}: `family` is {family!r}, it must be the name of a design family; change it.")
    return read_family_design(family, values, str(path))


def read_simulation(lake: Path, simulation_id: str) -> "tuple[Design, RigidObject, SimulatorVersion, GraspSetup]":
    """Read design, object, simulator version and setup of a simulation (S...) of the lake, failed ones too.

    Raises:
        UsageError: the lake has no such simulation, or it is another lab's.
    """
    from fast.lake.tables.campaign import DesignRow, SimulationRow, SimulatorVersionRow
    from fast.models.objects.catalogue import get_object
    from fast.models.records import GraspSetup
    from fast.models.validation import closest

    found = open_lake(lake)
    rows = found.records(SimulationRow, simulation_id=simulation_id)
    if not rows:
        known = closest(simulation_id, sorted(found.ids(SimulationRow)))
        raise UsageError(f"simulation `{simulation_id}` is not in {lake}; {known}")
    (row,) = rows
    designs = found.records(DesignRow, design_id=row.design_id)
    versions = found.records(SimulatorVersionRow, version_id=row.version_id)
    if not designs or not versions or versions[0].tier == "imported":
        raise UsageError(f"simulation `{simulation_id}` was made elsewhere; only this program's can be repeated.")
    setup = GraspSetup.model_validate_json(row.setup_json)
    return designs[0].design, get_object(row.object_id), versions[0].version, setup


def refuse_beside(option: str, others: dict[str, Any]) -> None:
    """Refuse options that another one has already decided.

    Raises:
        UsageError: naming the first of them that was given.
    """
    for name, value in others.items():
        if value is not None:
            raise UsageError(f"--{option} already says what --{name} would; leave one of them out.")


def _base_version(lake: Path, version_id: str | None, tier: str | None) -> "SimulatorVersion":
    from fast.models.simulation.version import find_tier

    if tier is None:
        return read_version(lake, version_id)
    refuse_beside("tier", {"version": version_id})
    return find_tier(tier)


def read_version(lake: Path, version_id: str | None) -> "SimulatorVersion":
    """Read a simulator version of the lake, or the default one.

    Raises:
        UsageError: the lake has no such version, or it is another lab's simulator.
    """
    from fast.models.simulation.version import SimulatorVersion
    from fast.models.validation import closest, load_record

    if version_id is None:
        return SimulatorVersion()
    from fast.lake.tables.campaign import SimulatorVersionRow

    found = open_lake(lake)
    rows = found.rows(SimulatorVersionRow)
    known = {row["version_id"]: row["version_json"] for row in rows if row["tier"] != "imported"}
    if version_id not in known:
        raise UsageError(
            f"simulator version `{version_id}` is not in {found.address}; {closest(version_id, list(known))}"
        )
    return load_record(SimulatorVersion, json_module.loads(known[version_id]), f"simulator version {version_id}")


def apply_settings(settings: list[str], base: "SimulatorVersion") -> "tuple[SimulatorVersion, GraspSetup, Placement]":
    """Apply `name=value` settings to the base version, the default setup and the nominal placement, and return them.

    Raises:
        ConfigError: unknown name or value out of range.
        UsageError: the jaws would not close.
    """
    from fast.models.records import GraspSetup, Placement, Theta
    from fast.models.simulation.version import MeshSettings
    from fast.models.validation import closest, load_record

    sections: dict[Any, dict[str, Any]] = {
        Theta: base.theta.model_dump(),
        GraspSetup: {},
        MeshSettings: base.mesh.model_dump(),
        Placement: {},
    }
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals:
            raise ConfigError(f"--set `{setting}` has no value; write it like --set friction=0.5.")
        owner = next((record for record in sections if name in record.model_fields), None)
        if owner is None:
            known = [field for record in sections for field in record.model_fields]
            raise ConfigError(f"--set {setting}: unknown name `{name}`; {closest(name, known)}")
        sections[owner][name] = value
    theta, setup, mesh, placement = (load_record(record, values, "--set") for record, values in sections.items())
    setup.check_stroke()
    return base.model_copy(update={"theta": theta, "mesh": mesh}), setup, placement


def describe_grasp(data: dict[str, Any]) -> str:
    """Describe a grasp as `fast simulate` prints it."""
    lines = [
        f"peak pull-off force  {data['peak_force_n']:.2f} N{_scatter_words(data)}",
        f"contact force        {data['contact_force_n']:.2f} N",
        f"work                 {1000 * data['work_j']:.1f} mJ",
        *([f"largest pressure     {data['pressure_kpa']:.0f} kPa"] if data.get("pressure_kpa") else []),
        *([f"largest twist        {data['twist_deg']:.1f} deg"] if data.get("twist_deg") else []),
        f"{data['n_steps']} steps, {data['n_dof']} degrees of freedom, {data['cpu_s']:.1f} s of CPU",
    ]
    return "\n".join(lines + (_slope_lines(data) if "slopes" in data else []))


def _scatter_words(data: dict[str, Any]) -> str:
    """Tell the scatter of the peak between prints and mountings, and of what; nothing where it was not asked for."""
    if "peak_sd_n" not in data:
        return ""
    without = ", ".join(map(spell_name, data["sd_is_without"]))
    if data["peak_sd_n"] is None:
        return f" (scatter not known by {without})"
    rest = f"; not known by {without}" if without else ""
    return f" (sd {data['peak_sd_n']:.2f} N between prints and mountings: {data['sd_is_of']}{rest})"


def _slope_lines(data: dict[str, Any]) -> list[str]:
    """Write the slopes of the peak as a table, up to where those of the trace are good, and what has none."""
    rows = [
        {
            "parameter": row["parameter"],
            "slope of the peak": f"{row['peak_slope']:.4g} {row['unit']}",
            "a change of": f"{row['usual_change']:.3g}",
            "changes the peak by": f"{row['peak_change_n']:+.2f} N",
            "": "" if row["finite_step"] is None else f"finite difference, +-{row['finite_step']:.3g}",
        }
        for row in data["slopes"]
    ]
    good = f"slopes of the trace are good up to {data['slopes_trusted_mm']:.1f} mm of lift"
    lost = [f"no slope by {name}: {why}" for name, why in data["slopes_lost"].items()]
    return ["", *([table_text(rows)] if rows else []), good, *lost]
