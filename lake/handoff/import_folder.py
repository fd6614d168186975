"""Import of the hand-off format: designs, grasps and traces of another lab or simulator.

A folder with `designs.csv`, `grasps.csv`, `traces.parquet` (or `traces.csv`) and, for simulated grasps,
optionally `simulations.csv`. Import writes everything or nothing and keeps every id and number; peak,
work and initial force are computed from the traces, in the frame of `GraspSetup`. Grasps that a search has
asked for are answers to it (`lake.handoff.answers`). Export is in `lake.handoff.export_folder`, files of
another format in `lake.handoff.readers`.
"""

import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fast.lake.handoff.answers import check_answers, find_settings
from fast.lake.handoff.campaign import Place, bench_rows, campaign_row, source_hash, tool_places
from fast.lake.handoff.files import Handoff, HandoffGrasp, read_handoff
from fast.lake.handoff.format import CHANNELS, FILE_NAMES, THETA_COLUMNS
from fast.lake.handoff.tables import Fault, HandoffError
from fast.lake.provenance import Provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import (
    DesignRow,
    GraspRow,
    ObjectRow,
    Row,
    SimTraceRow,
    SimulationRow,
    SimulatorVersionRow,
    TraceRow,
)
from fast.lake.tables.imported import importing_campaign
from fast.lake.tables.material import MaterialRow
from fast.lake.tables.requests import setup_columns
from fast.models import traces as features
from fast.models.errors import UsageError
from fast.models.ids import canonical_json, content_id, id_in_lab
from fast.models.records import GraspSetup, Trace

_CAMPAIGN_ID = re.compile(r"[^\W_][\w .+-]{0,99}")
_AS_TOLD = ("grasp_id", "tool_id", "design_id", "object_id", "repeat", "order", "attempt", "status", "reason",
            "started_at", "lab", "bench", "world_hash", "tare_force_n", "software")  # fmt: skip
_TRACES_AT_ONCE = 512  # traces of the lake held in memory while they are compared


class HandoffCounts(NamedTuple):
    """How much was imported or exported."""

    n_designs: int
    n_real: int
    n_sim: int
    n_samples: int
    n_known: int = 0  # of an import: grasps that the lake had already, not among the others
    known_in: tuple[str, ...] = ()  # of these, the other campaigns that have them
    n_replaced: int = 0  # of those that the lake had, grasps of an earlier import that now have other numbers


@dataclass(frozen=True)
class Origin:
    """What a person says of a hand-off folder, where its files do not."""

    campaign_id: str | None = None
    """The campaign that measured grasps become part of; None: `import-<source>`."""
    setup: GraspSetup = GraspSetup()
    """How grasps were made; by default as the format says (open gap 70, closed gap 16, tips 5 mm below the object)."""
    source: str | None = None
    """Where the data come from; None: the folder's name."""
    lab: str | None = None
    """Who measured; it stands in front of the ids of these grasps."""


NOT_SAID = Origin()


def import_handoff(
    lake: Lake, directory: Path, provenance: Provenance, origin: Origin = NOT_SAID, *, is_dry: bool = False
) -> HandoffCounts:
    """Import a hand-off folder; importing it again changes nothing. Returns what was written.

    Measured grasps become `grasps` and `traces`, simulated ones `simulations` and `sim_traces`. Grasps that the lake
    has as part of another campaign, or simulated itself, stay as they are. `is_dry`: only check and count.

    Raises:
        HandoffError: something is wrong; every fault is named and nothing was written.
        UsageError: the campaign exists and was not imported, or answers are not what a search asked for; nothing was
            written.
    """
    directory = Path(directory)
    known_designs = lake.ids(DesignRow)
    handoff = _with_lab(read_handoff(directory, known_designs), origin.lab)
    source = origin.source or directory.resolve().name
    real = [grasp for grasp in handoff.grasps if grasp.fidelity == "real"]
    there = lake.ids(GraspRow, grasp_id=[grasp.grasp_id for grasp in real])
    asking = check_answers(lake, [grasp for grasp in real if grasp.grasp_id not in there], origin.setup)
    campaign = asking or origin.campaign_id or "import-" + re.sub(r"[^\w .+-]|\.\.", "-", source)[:90]
    check_campaign_id(campaign)
    grasps, known_in = _new_grasps(lake, directory, handoff, campaign)
    rows: list[Row] = [
        DesignRow.of(design, design_id)
        for design_id, design in handoff.designs.items()
        if design_id not in known_designs
    ]
    known_objects = lake.ids(ObjectRow)
    rows += [ObjectRow.of(obj) for obj in handoff.objects if obj.object_id not in known_objects]
    known_materials = lake.ids(MaterialRow)
    rows += [row for row in handoff.materials if row.material_id not in known_materials]
    content_hash = source_hash(directory)
    if grasps:
        places = tool_places(lake, campaign, [grasp.tool_id for grasp in grasps if grasp.fidelity == "real"])
        if asking is None:  # the lake has the campaign and the tools that a search asks for
            rows += [
                campaign_row(lake, campaign, source, content_hash),
                *bench_rows(lake, campaign, source, grasps, places, handoff.tools),
            ]
        rows += _grasp_rows(grasps, campaign, origin.setup, places)
    _check_room(lake, directory)
    known = lake.ids(GraspRow) | lake.ids(SimulationRow)
    new = [grasp for grasp in grasps if grasp.grasp_id not in known]
    n_replaced = len(_find_replaced(lake, [grasp for grasp in grasps if grasp.grasp_id in known], rows))
    if rows and not is_dry:
        lake.append(_unique(rows), _with_config(provenance, content_hash))
    n_known = len(handoff.grasps) - len(new)
    counts = _counts(len(set(handoff.designs) - known_designs), new, n_known)
    return counts._replace(known_in=known_in, n_replaced=n_replaced)


def _with_lab(handoff: Handoff, lab: str | None) -> Handoff:
    """Return the hand-off with this lab in the measured grasps that name none."""
    if lab is None:
        return handoff
    grasps = [
        replace(grasp, lab=lab, grasp_id=id_in_lab(grasp.grasp_id, lab))
        if grasp.fidelity == "real" and grasp.lab is None
        else grasp
        for grasp in handoff.grasps
    ]
    return replace(handoff, grasps=grasps)


def check_campaign_id(campaign_id: str) -> None:
    """Raise UsageError for a name that is no name: reports and print files go into a folder called so."""
    if not _CAMPAIGN_ID.fullmatch(campaign_id) or ".." in campaign_id:
        raise UsageError(
            f"`{campaign_id[:120]}` cannot be the name of a campaign; nothing was written: give --campaign a name of "
            "at most 100 letters, digits, spaces, `.`, `_`, `+` or `-`, a letter or digit first."
        )


def _check_room(lake: Lake, directory: Path) -> None:
    """Raise UsageError where the files hold more than the lake's disk; of an object store the room is unknown."""
    if lake.root is None:
        return
    wanted = sum(path.stat().st_size for name in FILE_NAMES if (path := directory / name).exists())
    free = shutil.disk_usage(lake.root).free
    if wanted > free:
        raise UsageError(
            f"{directory} holds {wanted / 1e6:.0f} MB, the disk of the lake has {free / 1e6:.0f} MB left; nothing was "
            "written: free some, or import into a lake elsewhere."
        )


def _with_config(provenance: Provenance, content_hash: str) -> Provenance:
    """Return provenance whose config is the imported files, unless it names another."""
    return provenance if provenance.config_hash else provenance.model_copy(update={"config_hash": content_hash})


def _grasp_rows(
    grasps: Sequence[HandoffGrasp], campaign_id: str, setup: GraspSetup, places: dict[str, Place]
) -> list[Row]:
    rows: list[Row] = []
    for grasp in grasps:
        how = setup_columns(*find_settings(grasp, setup))
        if grasp.fidelity == "real":
            rows += _real_rows(grasp, campaign_id, how, places[grasp.tool_id])
        else:
            rows += _sim_rows(grasp, campaign_id, how)
    return rows


def _new_grasps(
    lake: Lake, directory: Path, handoff: Handoff, campaign_id: str
) -> tuple[list[HandoffGrasp], tuple[str, ...]]:
    """Find grasps that are not in the lake already as something else's than this import's; the campaigns with those.

    Raises:
        HandoffError: an id of the lake is used for something else.
    """
    faults = []
    known = {row.design_id: row.design for row in lake.records(DesignRow, design_id=list(handoff.designs))}
    for design_id, design in handoff.designs.items():
        if known.get(design_id, design) != design:
            limit = "is a design of the lake with other parameters; give it another id."
            faults.append(Fault("designs.csv", None, "design_id", design_id, limit))
    used = _used_ids(lake, [grasp.grasp_id for grasp in handoff.grasps])
    others, owners = [], set()
    for grasp in handoff.grasps:
        identity = (grasp.fidelity, grasp.design_id, grasp.object_id)
        there, owner = used.get(grasp.grasp_id, (identity, campaign_id))
        if there != identity:
            limit = "is in the lake for another design, object or fidelity; give it another id"
            limit += ", or say with --lab who measured it." if grasp.fidelity == "real" else "."
            faults.append(Fault("grasps.csv", None, "grasp_id", grasp.grasp_id, limit))
        elif owner != campaign_id:
            others.append(grasp)
            owners.add(owner)
    faults += _changed_grasps(lake, others)
    if faults:
        raise HandoffError(directory, faults)
    left_alone = {grasp.grasp_id for grasp in others}
    new = [grasp for grasp in handoff.grasps if grasp.grasp_id not in left_alone]
    return new, tuple(sorted(filter(None, owners)))  # None: the lake's own simulations


def _used_ids(lake: Lake, grasp_ids: list[str]) -> dict[str, tuple[tuple[str, str, int], str | None]]:
    """Return what the lake has under these ids: (fidelity, design, object), and the campaign it belongs to."""
    table = lake.query(
        "SELECT grasp_id AS id, 'real' AS fidelity, design_id, object_id, campaign_id, NULL AS version_json "
        "FROM grasps WHERE grasp_id IN (SELECT unnest($ids)) UNION ALL "
        "SELECT simulation_id, 'sim', design_id, object_id, NULL, version_json "
        "FROM simulations LEFT JOIN simulator_versions USING (version_id) "
        "WHERE simulation_id IN (SELECT unnest($ids))",
        {"ids": grasp_ids},
    )
    return {
        row["id"]: (
            (row["fidelity"], row["design_id"], row["object_id"]),
            row["campaign_id"] or importing_campaign(row["version_json"] or "{}"),
        )
        for row in table.to_pylist()
    }


def _changed_grasps(lake: Lake, grasps: Sequence[HandoffGrasp]) -> list[Fault]:
    """List a fault for each grasp that the lake has with other samples or, if it brings none, another peak."""
    remedy = "and not from this import; give it another id"
    by_lab = f"{remedy}, or say with --lab who measured it."
    alone = {grasp.grasp_id: grasp for grasp in grasps if grasp.fidelity == "real" and grasp.trace is None}
    faults = [
        Fault("grasps.csv", None, "grasp_id", row["grasp_id"], f"is in the lake with {_say_end(row)}, {by_lab}")
        for row in lake.rows(GraspRow, grasp_id=list(alone))
        if _say_end(row) != _say_end(vars(alone[row["grasp_id"]]))
    ]
    tables: tuple[tuple[str, type[TraceRow] | type[SimTraceRow]], ...] = (("real", TraceRow), ("sim", SimTraceRow))
    for fidelity, table in tables:
        wanted = [grasp for grasp in grasps if grasp.fidelity == fidelity]
        for start in range(0, len(wanted), _TRACES_AT_ONCE):
            some = wanted[start : start + _TRACES_AT_ONCE]
            rows = lake.rows(table, **{table.id_column(): [grasp.grasp_id for grasp in some]})
            there = {row[table.id_column()]: row for row in rows}
            for grasp in some:
                if grasp.trace is not None and not _same_samples(there.get(grasp.grasp_id), grasp.trace):
                    limit = f"is in the lake with other samples, {by_lab if fidelity == 'real' else f'{remedy}.'}"
                    faults.append(Fault("grasps.csv", None, "grasp_id", grasp.grasp_id, limit))
    return faults


def _find_replaced(lake: Lake, grasps: Sequence[HandoffGrasp], rows: Sequence[Row]) -> set[str]:
    """List the grasps of the lake that these rows give other samples or numbers; `grasps`: those that it has."""
    found = {fault.value or "" for fault in _changed_grasps(lake, grasps)}
    tables: tuple[type[GraspRow] | type[SimulationRow], ...] = (GraspRow, SimulationRow)
    for table in tables:
        name = table.id_column()
        new = {row.__dict__[name]: row for row in rows if isinstance(row, table)}
        there = lake.records(table, **{name: list(new)}) if new else []
        found |= {row.__dict__[name] for row in there if row != new[row.__dict__[name]]}
    return found


def _say_end(grasp: Mapping[str, Any]) -> str:
    """Say how a grasp without samples ended, in words."""
    return "no force" if grasp["peak_force_n"] is None else f"a peak of {grasp['peak_force_n']!r} N"


def _same_samples(row: dict[str, Any] | None, trace: Trace) -> bool:
    return row is not None and all(np.array_equal(row[name], getattr(trace, name)) for name in CHANNELS)


def _real_rows(grasp: HandoffGrasp, campaign_id: str, setup: dict[str, Any], place: Place) -> list[Row]:
    trace, is_pull = grasp.trace, grasp.trace is not None and grasp.status == "ok"
    row = GraspRow(
        **{name: getattr(grasp, name) for name in _AS_TOLD},
        campaign_id=campaign_id,
        batch=place[0],
        slot=place[1],
        peak_force_n=features.peak_force_n(trace) if trace and is_pull else grasp.peak_force_n,
        work_j=features.work_j(trace) if trace and is_pull else None,
        initial_force_n=features.initial_force_n(trace) if trace and is_pull else None,
        request_id=grasp.request_id or None,
        **setup,
    )
    return [row] if trace is None else [row, TraceRow.of(grasp.grasp_id, trace)]


def _sim_rows(grasp: HandoffGrasp, campaign_id: str, setup: dict[str, Any]) -> list[Row]:
    assert grasp.trace is not None  # a simulated grasp without samples is a fault
    simulation = grasp.simulation or {}
    version = _version_row(campaign_id, {name: simulation.get(name) for name in THETA_COLUMNS})
    started_at = grasp.started_at.isoformat() if grasp.started_at else ""
    details = {"repeat": grasp.repeat, "tool_id": grasp.tool_id, "started_at": started_at, "order": grasp.order}
    row = SimulationRow(
        simulation_id=grasp.grasp_id,
        design_id=grasp.design_id,
        object_id=grasp.object_id,
        version_id=version.version_id,
        status="ok",
        peak_force_n=features.peak_force_n(grasp.trace),
        contact_force_n=simulation.get("contact_force_n"),
        work_j=features.work_j(grasp.trace),
        details_json=canonical_json(details),
        **setup,
    )
    return [version, row, SimTraceRow.of(grasp.grasp_id, grasp.trace)]


def _version_row(campaign_id: str, theta: dict[str, float | None]) -> SimulatorVersionRow:
    """Return the row of the other lab's simulator, as far as it told."""
    content = {"imported": campaign_id, "theta": theta}
    return SimulatorVersionRow(
        version_id=content_id("V", content),
        version_json=canonical_json(content),
        tier="imported",
        effects_json="[]",
        **theta,
    )


def _unique(rows: Sequence[Row]) -> list[Row]:
    return list({(row.table, row.__dict__[row.id_column()]): row for row in rows}.values())


def count_all(handoff: Handoff) -> HandoffCounts:
    """Count what a folder holds: what a lake without any of it would take."""
    return _counts(len(handoff.designs), handoff.grasps, 0)


def _counts(n_designs: int, grasps: Sequence[HandoffGrasp], n_known: int) -> HandoffCounts:
    n_real = sum(grasp.fidelity == "real" for grasp in grasps)
    n_samples = sum(len(grasp.trace.time_s) for grasp in grasps if grasp.trace is not None)
    return HandoffCounts(n_designs, n_real, len(grasps) - n_real, n_samples, n_known)
