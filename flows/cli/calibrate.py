"""`fast calibrate`: theta of the simulator from the measurements of a lake."""

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from fast.flows.cli.campaign import open_lake, resolve_campaign
from fast.flows.cli.common import DEFAULT_LAKE, AsJson, LakePath, show, table_text
from fast.flows.cli.live import open_reporter

if TYPE_CHECKING:
    from fast.lake.tables.campaign import CalibrationRow
    from fast.models.calibration.means.hypercube import HypercubePlan
    from fast.tasks.calibration.calibrate import CalibrationOutcome

AT_LEAST_ONE = Number(gte=1)
_COLUMNS = ("mean", "sd", "q05", "median", "q95", "mode")
_UNITS = {"young_modulus": "_mpa", "friction": "", "poisson_ratio": ""}


@Parameter(name="*")
@dataclass(frozen=True)
class Compared:
    """What is compared with what."""

    campaign: Annotated[str | None, Parameter(help="Campaign whose measurements count; default: all of the lake.")] = (
        None
    )
    version: Annotated[
        str | None, Parameter(help="Simulator version (V...) to calibrate; default: the campaigns' own.")
    ] = None
    data: Annotated[
        Literal["mean", "trace"],
        Parameter(
            help="What is compared: mean forces of tools, as in the paper, or force traces by tool and object, for "
            "which the missing grid of theta around the measured designs is simulated first."
        ),
    ] = "mean"
    simulate: Annotated[
        int | None,
        Parameter(
            help="First simulate this many designs of a Latin hypercube with theta; of means alone.",
            validator=AT_LEAST_ONE,
        ),
    ] = None
    spread: Annotated[
        Literal["log-uniform", "uniform"],
        Parameter(
            help="With --simulate: how Young's modulus is spread over 2 to 200 MPa and friction over 0.02 to 2; the "
            "paper: uniform."
        ),
    ] = "log-uniform"
    lot: Annotated[
        str | None,
        Parameter(
            help="Material lot whose measurements become priors of Young's modulus and friction: its name, or the "
            "path of its file, which is read into the lake; `none`: Table 3. Default: the lot that the campaigns name."
        ),
    ] = None
    verify: Annotated[
        bool, Parameter(negative="", help="Simulate the held-out designs with theta before and after; of means alone.")
    ] = False


@Parameter(name="*")
@dataclass(frozen=True)
class Sampling:
    """How theta is inferred; fields as in `CalibrationSettings`."""

    chains: Annotated[int, Parameter(help="Chains; the paper: 8.")] = 4
    draws: Annotated[int, Parameter(help="Draws kept per chain; the paper: 8000.")] = 1000
    tune: Annotated[int, Parameter(help="Draws dropped per chain; the paper: 8000.")] = 1000
    seed: Annotated[int, Parameter(help="Seed of hypercube, held-out designs and chains.")] = 0
    method: Annotated[
        Literal["auto", "factorised", "joint"], Parameter(help="Algorithm; auto checks and falls back.")
    ] = "auto"
    rho: Annotated[
        Literal["fixed", "free"], Parameter(help="Scale between simulation and measurement: 1, or inferred.")
    ] = "fixed"
    print_scatter: Annotated[
        float,
        Parameter(help="Relative scatter of stiffness between prints, e.g. 0.04; of means alone."),
    ] = 0.0
    workers: Annotated[int, Parameter(help="Worker processes; changes no result.", validator=AT_LEAST_ONE)] = 2


_COMPARED, _SAMPLING = Compared(), Sampling()


def calibrate(
    *,
    lake: LakePath = DEFAULT_LAKE,
    compared: Compared = _COMPARED,
    sampling: Sampling = _SAMPLING,
    out: Annotated[
        Path | None,
        Parameter(help="Folder for the page: Table 2, figures, ArviZ file; `fast report C...` writes it later."),
    ] = None,
    json: AsJson = False,
) -> None:
    """Infer Young's modulus, friction and Poisson's ratio from measurements and simulations (Table 2 of the paper).

    Writes calibration, draws and a new simulator version to the lake. The same data and settings are not calibrated
    twice; a killed command continues when it is given again.
    """
    from fast.flows.calibration.calibrate import CalibrationRequest, run_calibration, write_page
    from fast.models.calibration.inference.settings import CalibrationSettings
    from fast.models.validation import load_record
    from fast.tasks.calibration.means import OF_IMPORTED

    settings = load_record(CalibrationSettings, asdict(sampling), "fast calibrate")
    plan = _hypercube_plan(compared, sampling.seed)
    found = open_lake(lake)
    name = resolve_campaign(found, compared.campaign) if compared.campaign is not None else None
    order = CalibrationRequest(settings, name, compared.version, plan, compared.verify, compared.data, compared.lot)
    with open_reporter() as reporter:
        outcome = run_calibration(found, order, reporter)
    page = str(write_page(found, outcome, out)) if out is not None else None
    show(_data(outcome) | {"report": page}, _text(outcome, page), json)
    if outcome.row.version_id is None and outcome.row.reason != OF_IMPORTED:
        sys.exit(1)


def _hypercube_plan(compared: Compared, seed: int) -> "HypercubePlan | None":
    from fast.models.calibration.means.hypercube import HypercubePlan
    from fast.models.validation import load_record

    if compared.simulate is None:
        return None
    return load_record(
        HypercubePlan, {"n": compared.simulate, "spread": compared.spread, "seed": seed}, "fast calibrate"
    )


def _data(outcome: "CalibrationOutcome") -> dict[str, Any]:
    return {**outcome.row.model_dump(mode="json"), "is_new": outcome.is_new, "summary": outcome.sentence}


def _text(outcome: "CalibrationOutcome", page: str | None) -> str:
    row = outcome.row
    table = [
        {"": f"{stem}{unit}", **{column: getattr(row, f"{stem}_{column}{unit}") for column in _COLUMNS}}
        for stem, unit in _UNITS.items()
    ]
    k_hat = f", k-hat {row.k_hat:.2f}" if row.k_hat is not None else ""
    lines = [
        f"{outcome.sentence}.",
        "",
        table_text(table),
        "",
        f"{row.sampler}: {row.n_chains} x {row.n_draws} draws, R-hat {row.r_hat_max:.4f}, bulk ESS "
        f"{row.ess_bulk_min:.0f}, {row.n_divergences} divergences{k_hat}, {row.cpu_s:.0f} s of CPU",
        _held_out_line(row),
        *(f"warning: {sentence}" for sentence in row.warnings),
        *([f"page: {page}"] if page else []),
    ]
    return "\n".join(lines)


def _held_out_line(row: "CalibrationRow") -> str:
    if row.data == "trace":
        return "held out: none; traces teach about theta, not about designs"
    if not row.n_held_out or row.rmse_before_n is None or row.rmse_after_n is None:
        return f"held out: {row.n_held_out or 0} designs, nothing compared"
    line = f"held out: {row.n_held_out} designs by the {row.held_out_by}, "
    if row.correlation_before is not None and row.correlation_after is not None:
        line += f"correlation {row.correlation_before:.3f} -> {row.correlation_after:.3f}, "
    return f"{line}RMSE {row.rmse_before_n:.2f} -> {row.rmse_after_n:.2f} N"
