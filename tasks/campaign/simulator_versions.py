"""Which simulator version each stage of a campaign uses: decided once, at its beginning, and kept as an event."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from fast.lake.store import Lake
from fast.lake.tables.campaign import CalibrationRow, EventRow, SimulatorVersionRow
from fast.models.calibration.inference.settings import WITH_EFFECTS
from fast.models.records import Design
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.campaign.campaign import Campaign
from fast.tasks.campaign.state import tuples
from fast.tasks.scientist.observe import older_simulations, proposed_designs

KIND = "simulator_version"
_SECONDS = """
    SELECT coalesce(sum(coalesce(try_cast(details_json ->> '$.wall_s' AS DOUBLE), cpu_s)), 0.0) FROM simulations
    WHERE version_id = $version AND setup_id = $setup AND list_contains($designs, design_id)
"""


class StageVersion(NamedTuple):
    """What was decided for a stage: the version, and designs to simulate with it before anything is proposed.

    spent_s: seconds of workers that these designs had taken with the version before, in a search.
    """

    stage: int
    version_id: str
    reruns: tuple[str, ...]
    spent_s: float = 0.0


def at_stage(campaign: Campaign, stage: int) -> Campaign:
    """Return the campaign with the simulator version of a stage; decide it now unless it has been before."""
    if not campaign.config.night.active:
        return campaign
    decided = _decisions(campaign)
    if stage > 0 and stage not in {decision.stage for decision in decided}:
        _decide(_with_versions(campaign, decided), stage)
        decided = _decisions(campaign)
    return _with_versions(campaign, [decision for decision in decided if decision.stage <= stage])


def at_present(campaign: Campaign) -> Campaign:
    """Return the campaign with the simulator version of its last stage so far."""
    return _with_versions(campaign, _decisions(campaign)) if campaign.config.night.active else campaign


def find_decision(campaign: Campaign, stage: int) -> StageVersion | None:
    """Find what was decided for a stage, if anything was."""
    return next((decision for decision in _decisions(campaign) if decision.stage == stage), None)


def list_reruns(campaign: Campaign, stage: int) -> list[Design]:
    """List the designs that a stage simulates again because its simulator version is new, in order."""
    if not campaign.config.night.active:
        return []
    decision = find_decision(campaign, stage)
    wanted = decision.reruns if decision else ()
    designs = proposed_designs(campaign.state()) if wanted else {}
    return [designs[design_id] for design_id in wanted]


def note_older_simulations(campaign: Campaign, batch: int) -> None:
    """Keep as events what the tools of a batch are chosen with of simulations by older versions."""
    if not campaign.older_versions:
        return
    for part in older_simulations(campaign, campaign.state()):
        if part.version_map is None:
            message = f"{part.n_left_out} designs of {part.version.version_id} left out: {part.n_shared} are of both"
        else:
            message = (
                f"{len(part.means.ids)} designs of {part.version.version_id} mapped to {campaign.version.version_id}"
                f" by a line through {part.n_shared}, residual {part.version_map.residual_sd_n:.2f} N"
            )
        payload = {
            "batch": batch,
            "version_id": campaign.version.version_id,
            "old_version_id": part.version.version_id,
            "n_shared": part.n_shared,
            "n_mapped": len(part.means.ids),
            "n_left_out": part.n_left_out,
            "rho": part.version_map.rho if part.version_map else None,
            "residual_sd_n": part.version_map.residual_sd_n if part.version_map else None,
        }
        _append_event(campaign, "old_simulations", (batch, part.version.version_id), message, payload)


def newest_calibrated(lake: Lake, base_version_id: str, campaign_id: str) -> tuple[SimulatorVersion, str] | None:
    """Return the newest version that calibrations made from the base version or one made from it, and its calibration.

    Counted are calibrations with the measurements of this campaign or of the whole lake: another campaign's may have
    been on another bench. Effects that gap discovery has added stay: a later calibration of theta alone, of a simulator
    that lacks one of them, does not take them away. What re-tested them may.
    """
    rows = [row for row in lake.rows(CalibrationRow, status="ok") if row["campaign_id"] in (None, campaign_id)]
    known = {row.version_id: row for row in lake.records(SimulatorVersionRow) if row.tier != "imported"}
    line, newest = {base_version_id}, None
    effects: set[str] = set()
    for row in rows:  # oldest first: a version is made before it is calibrated in turn
        if row["base_version_id"] not in line or row["version_id"] not in known:
            continue
        line.add(row["version_id"])
        found = {value.effect for value in known[row["version_id"]].version.effects}
        if effects <= found or row["sampler"] == WITH_EFFECTS:
            newest, effects = row, found
    return None if newest is None else (known[newest["version_id"]].version, newest["calibration_id"])


def _decide(campaign: Campaign, stage: int) -> None:
    """Take the newest version for a stage and write down which it is."""
    from fast.lake.tables.catalogue_rows import append_version
    from fast.models.simulation.effects.scaling import force_ratio

    base = campaign.config.simulator.version
    found = newest_calibrated(campaign.lake, base.version_id, campaign.campaign_id)
    version, calibration_id = found or (base, None)
    reruns: list[str] = []
    if force_ratio(campaign.version, version) is None:
        from fast.tasks.scientist.night import choose_designs  # needs SciPy, which a campaign without nights does not

        chosen = choose_designs(campaign, stage, campaign.config.night.max_designs)
        reruns = [design.design_id for design in chosen]
    append_version(campaign.lake, version, campaign.provenance())
    batch = campaign.config.schedule.batches_of(stage)[-1]
    message = f"B{batch:02d} is chosen and simulated with {version.version_id}"
    if version != campaign.version:
        message += (
            f" instead of {campaign.version.version_id}; at most {len(reruns)} designs are simulated with it in the "
            f"night, for {campaign.config.night.max_hours:g} h at most"
        )
    payload = {
        "stage": stage,
        "version_id": version.version_id,
        "calibration_id": calibration_id,
        "reruns": reruns,
        "spent_s": count_seconds(campaign, version, reruns),
    }
    _append_event(campaign, KIND, (stage,), message, payload, [calibration_id] if calibration_id else [])


def _with_versions(campaign: Campaign, decided: list[StageVersion]) -> Campaign:
    versions = {row.version_id: row for row in campaign.lake.records(SimulatorVersionRow)} if decided else {}
    chain = [campaign.config.simulator.version, *(versions[decision.version_id].version for decision in decided)]
    # A version that comes back is the present one again, and no older one.
    return replace(campaign, versions=tuple(reversed(dict.fromkeys(reversed(chain)))))


def _decisions(campaign: Campaign) -> list[StageVersion]:
    """Return what was decided so far, by stage."""
    rows = campaign.lake.records(EventRow, campaign_id=campaign.campaign_id, kind=KIND)
    payloads = [row.payload for row in rows]
    return sorted(
        StageVersion(p["stage"], p["version_id"], tuple(p["reruns"]), p.get("spent_s", 0.0)) for p in payloads
    )


def count_seconds(campaign: Campaign, version: SimulatorVersion, design_ids: Sequence[str]) -> float:
    """Count what simulations of designs with a version have taken, summed over the workers, in seconds."""
    if not design_ids:
        return 0.0
    names = {"version": version.version_id, "setup": campaign.config.grasp.setup_id, "designs": list(design_ids)}
    ((seconds,),) = tuples(campaign.lake, _SECONDS, **names)
    return float(seconds)


def _append_event(
    campaign: Campaign,
    kind: str,
    key: tuple[int | str, ...],
    message: str,
    payload: dict[str, object],
    parents: list[str] | None = None,
) -> None:
    """Append an event that is itself however often it is written."""
    name = campaign.campaign_id
    row = EventRow.of([name, kind, *key], kind, message, payload, name)
    campaign.lake.append([row], campaign.provenance(parents=parents or []))
