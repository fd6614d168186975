"""The data of `fast gap --example`: eight tools measured on six objects with jaws that stall, and their bank.

The true grasps are those of the small panel of the hidden-effect study: another law of the jaws and another mesh than
the simulator's. A careful lab, with scatter, noise and lost traces, measures them three times. The bank and what else
the search simulates come from the search itself, which runs here once; the file then has all that it needs.

    python -m tests.studies.gap.example LAKE [--bank OTHER_LAKE]

LAKE is made or gone on with; OTHER_LAKE is a lake whose simulations of the bank are taken instead of making them. The
bank takes about 25 minutes of two cores. A change of the simulator, the bank or the catalogue makes it due again.
"""

import argparse
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np

from fast.flows.challenge.hidden.lab import TOOLS_PER_BATCH, Lab, Nuisance, Site, Variants
from fast.flows.challenge.hidden.panel_file import read_small
from fast.flows.cli.common import say_progress
from fast.flows.gap.example import CAMPAIGN, FILE
from fast.flows.gap.folder import write_folder
from fast.flows.gap.search import GapRequest, run_gap
from fast.flows.progress import ProgressReporter
from fast.lake.maintenance import compact_all
from fast.lake.provenance import current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    BatchRow,
    CalibrationRow,
    CampaignRow,
    DesignRow,
    EffectRow,
    EventRow,
    GraspRow,
    PosteriorDrawsRow,
    SimTraceRow,
    SimulationRow,
    SimulatorVersionRow,
    ToolRow,
    TraceRow,
)
from fast.lake.tables.imported import IMPORTED
from fast.lake.tables.requests import setup_columns
from fast.lake.tables.row import Row
from fast.models.design.space import numbered_design
from fast.models.gap.grasps import Cells
from fast.models.records import GraspSetup
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.gap.bank import list_plan_ids, plan_bank
from fast.tasks.gap.findings import STARTED

SMALL = Path(__file__).parents[2] / "data" / "gap-small.npz"
LAW, SEED, REPEATS = "force_limited_closing", 41, 3
CAREFUL = Nuisance(tool_sd=0.015, cell_sd=0.01, noise_sd_n=0.06)  # prints and placements of a lab that measures them
_DECIMALS = {"time_s": 3, "lift_mm": 3, "force_n": 3}
_BEGAN = datetime(2026, 1, 5, 8, 0, tzinfo=UTC)
_CONFIG = f"""# Made-up measurements: there is no schedule to run.
kind = "{IMPORTED}"

[[sources]]
folder = "true grasps of {LAW} of the hidden-effect study, seed {SEED}"
content_hash = ""
"""


def measure_example() -> list[Row]:
    """Rows of the measured grasps: campaign, batches, designs, tools, grasps and traces."""
    panels, _ = read_small(SMALL)
    numbers, objects, cells = panels.designs, panels.objects, panels.cells[LAW]
    lab = Lab(numbers, objects, SEED, REPEATS, CAREFUL)
    designs = [numbered_design(number) for number in numbers]
    rows: list[Row] = [CampaignRow(campaign_id=CAMPAIGN, name=CAMPAIGN, config_toml=_CONFIG)]
    rows += [DesignRow.of(design) for design in designs]
    for batch in sorted({_place(tool)[0] for tool in range(len(designs))}):
        n_tools = sum(_place(tool)[0] == batch for tool in range(len(designs)))
        batch_id = BatchRow.make_id(CAMPAIGN, batch)
        rows.append(BatchRow(batch_id=batch_id, campaign_id=CAMPAIGN, batch=batch, kind="imported", n_tools=n_tools))
    for tool, design in enumerate(designs):
        batch, slot = _place(tool)
        rows.append(
            ToolRow(
                tool_id=ToolRow.make_id(CAMPAIGN, batch, slot),
                campaign_id=CAMPAIGN,
                batch=batch,
                slot=slot,
                design_id=design.design_id,
                status="printed",
                confirmed_by="auto",
            )
        )
    for site, trace in lab.measure(lambda tool, obj: Variants(cells[tool, obj]), ()):
        grasp = _grasp_row(site, lab)
        rows += [TraceRow.of(grasp.grasp_id, trace), grasp]
    return rows


def read_bank_rows(source: Lake) -> list[Row]:
    """The simulations of the bank that another lake has."""
    panels, _ = read_small(SMALL)
    numbers, objects = panels.designs, panels.objects
    designs = [numbered_design(number) for number in numbers]
    ids = list_plan_ids(plan_bank(SimulatorVersion(), Cells.full(designs, objects, GraspSetup())))
    return [*_simulation_rows(source, ids)]


def round_rows(rows: Sequence[Row]) -> list[Row]:
    """Rows with samples of whole steps, which pack to half the size; the search is made on the very same numbers."""
    return [_rounded(row) if isinstance(row, TraceRow | SimTraceRow) else row for row in rows]


def _rounded(row: TraceRow | SimTraceRow) -> Row:
    samples = {name: np.round(getattr(row, name), decimals) for name, decimals in _DECIMALS.items()}
    return row.model_copy(update=samples)


def write_example(path: Path, rows: Sequence[Row]) -> None:
    """Write a lake of these rows as one file."""
    with TemporaryDirectory() as folder:
        root = Path(folder) / "lake"
        lake = Lake.open(root, create=True)
        lake.append(rows, current_provenance(seed=SEED))
        compact_all(lake)
        lake.close()
        parts = [part for part in sorted(root.rglob("*")) if part.is_file() and ".state" not in part.parts]
        with ZipFile(path, "w", ZIP_DEFLATED) as archive:
            for part in parts:
                archive.write(part, part.relative_to(root))


def collect_example(lake: Lake, campaign_id: str = CAMPAIGN) -> list[Row]:
    """All that a search on the campaign needs or goes on from: grasps, simulations, calibrations, how it began.

    Draws of two machines differ, and so do the simulations at their medians: with the calibrations none is missing.
    """
    grasps = lake.records(GraspRow, campaign_id=campaign_id)
    design_ids = sorted({row.design_id for row in grasps})
    found: list[Row] = [*grasps, *lake.records(TraceRow, grasp_id=[row.grasp_id for row in grasps])]
    for table in (CampaignRow, BatchRow, ToolRow):
        found += lake.records(table, campaign_id=campaign_id)
    found += lake.records(DesignRow, design_id=design_ids)
    found += _simulation_rows(lake, sorted(lake.ids(SimulationRow, design_id=design_ids)))
    found += lake.records(EventRow, campaign_id=campaign_id, kind=STARTED)
    calibrations = lake.records(CalibrationRow, campaign_id=campaign_id)
    ids = [row.calibration_id for row in calibrations]
    return [*found, *calibrations, *lake.records(PosteriorDrawsRow, calibration_id=ids)]


def _simulation_rows(lake: Lake, ids: Sequence[str]) -> Iterator[Row]:
    simulations = lake.records(SimulationRow, simulation_id=list(ids))
    yield from lake.records(SimTraceRow, simulation_id=[row.simulation_id for row in simulations])
    yield from simulations
    for table in (SimulatorVersionRow, EffectRow):
        yield from lake.records(table)


def _grasp_row(site: Site, lab: Lab) -> GraspRow:
    batch, slot = _place(site.tool)
    tool_id, object_id = ToolRow.make_id(CAMPAIGN, batch, slot), lab.objects[site.obj]
    return GraspRow(
        grasp_id=GraspRow.make_id(tool_id, object_id, site.context.repeat),
        campaign_id=CAMPAIGN,
        tool_id=tool_id,
        batch=batch,
        slot=slot,
        design_id=numbered_design(lab.designs[site.tool]).design_id,
        object_id=object_id,
        repeat=site.context.repeat,
        order=site.context.batch_grasps,
        status="ok",
        started_at=_BEGAN + timedelta(days=batch - 1, seconds=site.context.clock_s),
        bench="virtual",
        **setup_columns(GraspSetup()),
    )


def _place(tool: int) -> tuple[int, int]:
    """Batch and slot of a tool."""
    return 1 + tool // TOOLS_PER_BATCH, tool % TOOLS_PER_BATCH


def main() -> None:
    """Measure, search, and write the file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("lake", type=Path)
    parser.add_argument("--bank", type=Path)
    parser.add_argument("--out", type=Path, default=FILE)
    words = parser.parse_args()
    lake = Lake.open(words.lake, create=True)
    bank = read_bank_rows(Lake.open(words.bank)) if words.bank is not None else []
    lake.append(round_rows([*measure_example(), *bank]), current_provenance(seed=SEED))
    outcome = run_gap(lake, GapRequest(CAMPAIGN), ProgressReporter(say_progress, say_progress))
    say_progress(f"{outcome.sentence}; page {write_folder(lake, outcome)}")
    write_example(words.out, collect_example(lake))
    say_progress(f"{words.out}: {words.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
