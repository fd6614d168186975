"""What gap discovery found, in the lake: one line a row in `gap_findings`, and the whole answer as an event."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from fast.lake.provenance import Provenance, current_provenance
from fast.lake.store import Lake
from fast.lake.tables.campaign import EventRow, GapFindingRow
from fast.lake.tables.row import Row
from fast.models.gap.findings import Decision, Findings, NextExperiment, RoundFindings
from fast.models.ids import content_id
from fast.models.records import EffectValue, Record
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.gap.readings import is_answered

if TYPE_CHECKING:  # seconds of imports, which whoever only reads what was found does without
    from fast.tasks.gap.data import MeasuredGrasps
    from fast.tasks.gap.split import Split

KIND, STARTED = "gap", "gap_started"
_N_MADE = "SELECT count(*) AS n FROM asked_grasps WHERE search_id = $search AND state = 'made'"


class GapRun(Record):
    """A finished search: its answer, and the simulator versions before and after."""

    gap_id: str
    """Of the search."""
    campaign_id: str | None
    """None: all measurements of the lake."""
    seed: int
    """Of its draws, the split among them."""
    split_id: str
    """Of which grasps were held out."""
    n_grasps: int
    """That were measured, held-out ones too."""
    base_version_id: str
    """The campaign's own, as it began."""
    before_version_id: str
    """Calibrated before the first round."""
    after_version_id: str
    """With what was added, after the last round."""
    calibration_ids: tuple[str, ...]
    """Of the simulator that each round ended with."""
    findings: Findings
    """The answer."""


def make_gap_id(
    measured: "MeasuredGrasps", base: SimulatorVersion, split: "Split", settings: Mapping[str, object]
) -> str:
    """Make the id of a search: the same grasps, samples, measured walls, simulator, split, catalogue and settings."""
    catalogue = {name: spec.version for name, spec in CATALOGUE.items()}
    content = [measured.content_id, base.version_id, split.split_id, catalogue, dict(settings)]
    return content_id("A", content)


def find_run(lake: Lake, gap_id: str) -> GapRun | None:
    """Find the finished search with this id, if the lake has it."""
    found = lake.records(EventRow, event_id=EventRow.make_id(KIND, gap_id))
    return GapRun.model_validate(found[-1].payload) if found else None


def find_newest_run(lake: Lake, campaign_id: str | None) -> GapRun | None:
    """Find the search of a campaign, or of a whole lake, that ended last."""
    return next(iter(_read_runs(lake, campaign_id)[-1:]), None)


def find_last_run(lake: Lake) -> GapRun | None:
    """Find the search of a lake that ended last, of whatever campaign."""
    found = lake.records(EventRow, kind=KIND)
    return GapRun.model_validate(found[-1].payload) if found else None


def find_answered_run(lake: Lake, campaign_id: str | None) -> GapRun | None:
    """Find the search that ended last, if what it asked for is answered, at least in part: it is to be gone on with.

    One that asked for a parameter had its name already; the search after it begins with that.
    """
    run = find_newest_run(lake, campaign_id)
    if run is None or run.findings.next_experiment is None or run.findings.next_experiment.parameter:
        return None
    person = run.findings.next_experiment.person
    if person is not None:
        return run if is_answered(lake, run.gap_id, person.kind) else None
    return run if count_made(lake, run.gap_id) else None


def find_refined_run(lake: Lake, campaign_id: str | None) -> GapRun | None:
    """Find the last search that asked for a parameter and had any of its grasps made."""
    for run in reversed(_read_runs(lake, campaign_id)):
        asked = run.findings.next_experiment
        if asked is not None and asked.parameter and count_made(lake, run.gap_id):
            return run
    return None


def count_made(lake: Lake, gap_id: str) -> int:
    """Count how many of the grasps that a search asked for are made."""
    return int(lake.query(_N_MADE, {"search": gap_id})["n"][0].as_py())


def count_asked(lake: Lake, campaign_id: str) -> int:
    """Count how many grasps the finished searches of a campaign have asked for, made or not."""
    return sum(asked.promised_grasps for asked in read_questions(lake, campaign_id))


def read_questions(lake: Lake, campaign_id: str | None) -> list[NextExperiment]:
    """Read what finished searches of a campaign, or of a whole lake, have asked for, in order."""
    runs = _read_runs(lake, campaign_id)
    return [run.findings.next_experiment for run in runs if run.findings.next_experiment is not None]


def _read_runs(lake: Lake, campaign_id: str | None) -> list[GapRun]:
    """Read the finished searches of a campaign, or of a whole lake, in order."""
    rows = lake.records(EventRow, kind=KIND, campaign_id=campaign_id or "")
    return [GapRun.model_validate(row.payload) for row in rows]


class Start(NamedTuple):
    """What a search began with: effects of its simulator, and the version in use (None: begun by older code)."""

    effects: tuple[EffectValue, ...]
    version: SimulatorVersion | None


def find_start(lake: Lake, gap_id: str) -> Start | None:
    """Find what a search began with, if it has begun."""
    found = lake.records(EventRow, event_id=EventRow.make_id(STARTED, gap_id))
    if not found:
        return None
    payload = found[-1].payload
    version = payload.get("version")
    effects = tuple(map(EffectValue.model_validate, payload["effects"]))
    return Start(effects, SimulatorVersion.model_validate(version) if version else None)


def write_start(lake: Lake, gap_id: str, campaign_id: str | None, start: Start, seed: int) -> None:
    """Write down that a search begins, and with what."""
    effects = start.effects
    names = ", ".join(value.effect for value in effects) or "no effect"
    version = start.version.model_dump(mode="json") if start.version else None
    payload = {"effects": [value.model_dump(mode="json") for value in effects], "version": version}
    message = f"gap search {gap_id} begins with {names} in the simulator"
    row = EventRow.of([STARTED, gap_id], STARTED, message, payload, campaign_id)
    lake.append([row], current_provenance(seed=seed))


def write_run(lake: Lake, run: GapRun, message: str, provenance: Provenance) -> None:
    """Write a finished search: its lines, and last the event by which it is found again."""
    rows: list[Row] = [row for number in range(len(run.findings.rounds)) for row in make_round_rows(run, number)]
    lake.append([*rows, EventRow.of([KIND, run.gap_id], KIND, message, run, run.campaign_id)], provenance)


def make_round_rows(run: GapRun, number: int) -> list[GapFindingRow]:
    """Make the lines of one round, which counts from 0 here and from 1 in the table."""
    found = run.findings.rounds[number]
    rows = [
        GapFindingRow(
            **_columns(run, number, "where", place),
            **where.model_dump(include={"sentence", "phase", "stratum", "p_value", "q_value"}),
            size_n=where.effect_size_n,
            ci90_lower_n=where.ci90[0],
            ci90_upper_n=where.ci90[1],
        )
        for place, where in enumerate(found.where)
    ]
    ranked = sorted(found.candidates, key=lambda candidate: -candidate.probability)
    rows += [
        GapFindingRow(
            **_columns(run, number, "candidate", place),
            **candidate.model_dump(include={"effect", "probability", "visible_fraction"}),
            evidence_nats=candidate.nats,
            parameters=tuple(candidate.parameters),
            parameter_values=tuple(candidate.parameters.values()),
        )
        for place, candidate in enumerate(ranked)
    ]
    return rows + _named_rows(run, number, found)


def _named_rows(run: GapRun, number: int, found: RoundFindings) -> list[GapFindingRow]:
    """Make one row for each effect of the answer, or one without effect; the gap is that of the whole search."""
    named, gap = found.named, run.findings.gap
    effects: Sequence[str | None] = named.effects or (None,)
    return [
        GapFindingRow(
            **_columns(run, number, "named", place),
            **_parameters(named, effect),
            sentence=named.sentence,
            effect=effect,
            answer=named.kind,
            probability=named.probability,
            **gap.model_dump(exclude={"ci95"}),
            closed_ci95_lower=gap.ci95[0] if gap.ci95 else None,
            closed_ci95_upper=gap.ci95[1] if gap.ci95 else None,
            version_id=found.version,
            calibration_id=run.calibration_ids[number],
        )
        for place, effect in enumerate(effects)
    ]


def _parameters(named: Decision, effect: str | None) -> dict[str, Any]:
    """Return one effect's parameters; the answer names them `<effect>.<parameter>` or, of a single one, plainly."""
    if effect is None:
        return {}
    own = {
        name.removeprefix(f"{effect}."): value
        for name, value in named.parameters.items()
        if name.startswith(f"{effect}.") or "." not in name
    }
    return {
        "parameters": tuple(own),
        "parameter_values": tuple(value.median for value in own.values()),
        "parameter_ci90_lower": tuple(value.ci90[0] for value in own.values()),
        "parameter_ci90_upper": tuple(value.ci90[1] for value in own.values()),
    }


def _columns(run: GapRun, number: int, kind: str, place: int) -> dict[str, Any]:
    return {
        "finding_id": GapFindingRow.make_id(run.gap_id, number + 1, kind, place),
        "gap_id": run.gap_id,
        "campaign_id": run.campaign_id,
        "round": number + 1,
        "kind": kind,
        "place": place,
        "base_version_id": run.base_version_id,
    }
