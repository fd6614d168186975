"""FAST from Python: one grasp, a campaign on a bench of one's own, the search for a gap. `import fast` offers them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.util import find_spec
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from fast.models.errors import UsageError

if TYPE_CHECKING:
    import torch
    from rich.console import Console

    from fast.flows.campaign.ask_tell import AskedBatch
    from fast.flows.simulation.many_designs import SimulatedGrasps
    from fast.lake.store import Lake
    from fast.models.gap.findings import Findings
    from fast.models.objects.rigid import RigidObject
    from fast.models.records import Design, GraspSetup, GraspSimulation, Record
    from fast.models.simulation.version import SimulatorVersion
    from fast.tasks.bench.told import Taken

R = TypeVar("R", bound="Record")


def simulate(
    design: "Design",
    grasped: "RigidObject | int | str",
    version: "SimulatorVersion | None" = None,
    setup: "GraspSetup | None" = None,
    *,
    along: "Sequence[str] | str" = (),
    lake: Path | str = "lake-data",
) -> "GraspSimulation":
    """Simulate one grasp, as `fast simulate` does: closing, lift and pull-off by both fingers.

    `grasped`: an object, or its number, name or file; own objects by name come from `lake`. `version`: theta, mesh and
    effects; default: the paper's theta on the production mesh. `setup`: gaps, heights and speeds. The result has
    `trace`, `peak_force_n`, `contact_force_n` and `work_j`, and `slopes` by the parameters named in `along`, such as
    `("friction", "length_mm")`; `"all"`: those of finger, material and closing.

    Raises:
        UsageError: there is no such object, a value is out of its range, or a parameter is unknown or has no slope.
        MeshingFailed, SimulationFailed: this finger cannot be meshed, or the grasp does not converge.
    """
    from fast.models.records import Design
    from fast.models.simulation.grasp import simulate_grasp

    met, names = _find_object(grasped, lake), _check_names(() if along is None else along, "along")
    return simulate_grasp(_check(design, Design, "design"), met, *_read_given(version, setup), along=names)


def grasp_function(
    grasped: "RigidObject | int | str",
    design: "Design | None" = None,
    version: "SimulatorVersion | None" = None,
    setup: "GraspSetup | None" = None,
    *,
    names: "Sequence[str] | str | None" = None,
    lake: Path | str = "lake-data",
) -> "Callable[[torch.Tensor], torch.Tensor]":
    """Return the peak pull-off force in N as a function for torch that knows its slopes (a `torch.autograd.Function`).

    It takes a tensor (... x d) of values of the parameters `names` and gives a tensor (...). `names` default to the
    numbers of the design in their order, of which whole ones are rounded and have slope 0; all that is not named is as
    in `design` (default: the best published one), `version` and `setup`. What has no slope here has slope 0 with a
    warning. There are no second derivatives. A value out of its range is a `UsageError` of the call.

    Raises:
        UsageError: there is no such object, a value is out of its range, or a name is of no parameter, of one without a
            slope (a whole number), or there twice.
    """
    from fast.models.design.space import BEST_PUBLISHED
    from fast.models.records import Design
    from fast.models.simulation.inputs import GraspInputs
    from fast.models.simulation.slopes.torch_function import PeakFunction

    met = _find_object(grasped, lake)
    finger = BEST_PUBLISHED if design is None else _check(design, Design, "design")
    named = None if names is None else _check_names(names, "names")
    return PeakFunction(GraspInputs(finger, met, *_read_given(version, setup)), named)


def simulate_many(
    designs: "Iterable[Design] | Design",
    objects: "Iterable[RigidObject | int | str] | RigidObject | int | str",
    version: "SimulatorVersion | None" = None,
    setup: "GraspSetup | None" = None,
    *,
    workers: int = 2,
    lake: Path | str = "lake-data",
    show_progress: bool = True,
) -> "SimulatedGrasps":
    """Simulate every design on every object in `workers` processes, with a progress bar; see `simulate`.

    One design or object may come without a list. A grasp that fails is a gap in the result, and does not stop the
    others. In a script, call it under `if __name__ == "__main__":`, because each process reads the script again.

    Raises:
        UsageError: no design or object is given, an object does not exist, a value is out of its range, `workers` is
            not from 1 to 256, or no process can be started.
    """
    from multiprocessing import current_process

    from rich.progress import Progress

    from fast.flows.progress import ProgressReporter
    from fast.flows.simulation.many_designs import SimulatedGrasps, simulate_designs
    from fast.models.objects.rigid import RigidObject
    from fast.models.records import Design, Placement
    from fast.tasks.campaign.own_designs import OwnDesign

    if getattr(current_process(), "_inheriting", False):  # a worker that reads an unguarded script: its parent says so
        raise SystemExit(1)
    wanted = [designs] if isinstance(designs, Design) or not isinstance(designs, Iterable) else designs
    own = [OwnDesign("", f"design {i}", _check(one, Design, f"design {i}")) for i, one in enumerate(wanted)]
    listed = [objects] if isinstance(objects, RigidObject | str) or not isinstance(objects, Iterable) else objects
    met = [_find_object(one, lake) for one in listed]
    if not own or not met:
        raise UsageError(f"{len(own)} designs and {len(met)} objects are given; give at least one of each.")
    if not isinstance(workers, Integral) or not 1 <= workers <= 256:
        raise UsageError(f"workers is {workers!r}, it must be a whole number from 1 to 256; change it.")
    with Progress(console=_make_console(), transient=True, disable=not show_progress) as display:
        bar = display.add_task("simulated", total=len(own) * len(met))
        reporter = ProgressReporter(print, print, lambda what, bars: display.update(bar, completed=bars[0].done))
        given = (*_read_given(version, setup), Placement())
        return SimulatedGrasps(tuple(simulate_designs(own, met, *given, workers, reporter)))


def _make_console() -> "Console":
    """Make what a bar is drawn on; in a notebook without ipywidgets nothing: Rich would show a warning instead."""
    from rich.console import Console

    return Console(stderr=True, force_jupyter=None if find_spec("ipywidgets") else False)


def _find_object(given: Any, lake: Path | str) -> "RigidObject":
    """Return the object itself, or find the one of this number, name or file.

    Raises:
        UsageError: it is none of these, or there is no such object.
    """
    from fast.models.objects.rigid import RigidObject
    from fast.models.validation import plain
    from fast.tasks.objects import find_object

    if isinstance(given, RigidObject):
        return given
    named = plain(given)
    if isinstance(named, float) and named.is_integer():  # so a row of a data frame has whole numbers
        named = int(named)
    if isinstance(named, bool) or not isinstance(named, int | str | Path):
        raise UsageError(
            f"the object is {given!r}, it must be a fast.RigidObject, a number, a name or a file; change it."
        )
    return find_object(str(named), lake)


def _read_given(
    version: "SimulatorVersion | None", setup: "GraspSetup | None"
) -> "tuple[SimulatorVersion, GraspSetup]":
    """Read the version and the setup that were given, their values checked; else the usual ones.

    Raises:
        UsageError: a value is out of its range, or the version is of code that this program does not have.
    """
    from fast.models.records import GraspSetup
    from fast.models.simulation.version import IN_ROWS, SimulatorVersion

    usual = SimulatorVersion()
    checked = usual if version is None else _check(version, SimulatorVersion, "version")
    if checked.fem_version not in (usual.fem_version, IN_ROWS):
        raise UsageError(
            f"version: `fem_version` is {checked.fem_version!r}, this program simulates by the code "
            f"{usual.fem_version!r} or {IN_ROWS!r}; leave it out."
        )
    closing = GraspSetup() if setup is None else _check(setup, GraspSetup, "setup")
    closing.check_stroke()
    return checked, closing


def _check(given: R, kind: type[R], name: str) -> R:
    """Return the record that was given, its values checked again: `model_copy(update=...)` does not.

    Raises:
        UsageError: it is of another kind, or a value is out of its range.
    """
    from fast.models.validation import check_again, check_type

    check_type(given, kind, name)
    return check_again(given, name)


def _check_names(given: Any, what: str) -> tuple[str, ...]:
    """Return the names of parameters, of which one may come without a list.

    Raises:
        UsageError: it is something else.
    """
    names = tuple(given) if isinstance(given, Iterable) and not isinstance(given, str) else (given,)
    if not all(isinstance(name, str) for name in names):
        raise UsageError(f'{what} is {given!r}, it must be names of parameters, such as ("friction",); change it.')
    return names


class Campaign:
    """A campaign whose grasps a bench of one's own makes (`bench.kind = "folder"` in the config).

    All that it knows is in the lake: another process, `fast ask` and `fast tell`, or `fast campaign run` may go on.
    """

    def __init__(self, config: Path | str, lake: "Path | str" = "lake-data") -> None:
        from fast.models.errors import UsageError

        if not isinstance(config, str | Path):
            raise UsageError(f"the config is {config!r}, it must be the path of a file; change it.")
        self.config = Path(config)
        self.lake = lake

    def ask(self, out: Path | str | None = None, say: Callable[[str], None] = print) -> "AskedBatch | None":
        """Return the batch to measure next: its designs by tool and its grasps; None when the schedule is complete.

        `out`: a new folder for the files of printer and bench. `say` hears how far simulations are.

        Raises:
            UsageError: the config cannot be used, or the folder is there; nothing was written.
        """
        from fast.flows.campaign.ask_tell import ask

        return ask(self.config, self.lake, out, say)

    def tell(
        self,
        told: "Iterable[Mapping[str, Any]] | Iterable[Path | str]",
        *,
        operator: str = "unknown",
        is_dry: bool = False,
        may_replace: bool = False,
    ) -> "Taken":
        """Take measured grasps: mappings, a data frame, tables of peaks or folders with traces; how many were written.

        A mapping has `tool_id`, `object_id`, `repeat`, and `peak_force_n`, `trace` (a `Trace`) or `reason`. `is_dry`:
        only check. `may_replace`: correct what was told before.

        Raises:
            UsageError: something cannot be used; nothing was written.
        """
        from fast.flows.campaign.ask_tell import tell
        from fast.tasks.bench.told import Telling

        return tell(self.config, self.lake, told, Telling(operator, is_dry, may_replace))


def find_gap(
    lake: "Lake | Path | str",
    campaign: str | None = None,
    *,
    n_designs: int | None = None,
    n_objects: int | None = None,
    budget_minutes: float | None = None,
    n_workers: int = 2,
    on_progress: Callable[[str], None] = lambda sentence: None,
) -> "Findings":
    """Find where simulation and measurement disagree, as `fast gap` does, and return what was found.

    `lake`: an open lake or its address. `campaign`: whose measurements count; default: all of the lake. `n_designs`,
    `n_objects`: search with so many, spread over those measured. `budget_minutes`: of simulating. `on_progress` gets
    a sentence now and then. What was simulated stays in the lake, so the same call continues a search that was
    killed; a search that has ended is told again at once.

    Raises:
        UsageError: measurements are missing, too few, not of one kind, or not in N.
        FastError: the budget ended before the simulations were complete, or another process searches in this lake.
    """
    from fast.flows.gap.search import GapRequest, run_gap
    from fast.flows.progress import ProgressReporter
    from fast.lake.store import Lake
    from fast.tasks.gap.panel import PanelSize

    found = lake if isinstance(lake, Lake) else Lake.open(lake)
    order = GapRequest(campaign, budget_minutes=budget_minutes, panel=PanelSize(n_designs, n_objects))
    outcome = run_gap(found, order.with_workers(n_workers), ProgressReporter(on_progress, on_progress))
    return outcome.run.findings
