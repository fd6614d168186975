"""The data of a search from the lake: measured grasps one by one, what came before each, and their split."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import ValidationError

from fast.lake.store import Lake
from fast.lake.tables.campaign import GraspRow, ToolRow, TraceRow
from fast.lake.tables.requests import GraspRequestRow
from fast.models.calibration.inference.result import find_unit_warnings
from fast.models.calibration.inference.settings import ThetaPriors
from fast.models.errors import UsageError
from fast.models.gap.ask.answers import Answers
from fast.models.gap.bank.bank import Bank
from fast.models.gap.data import GapData
from fast.models.gap.evidence.facts import Fact, list_facts
from fast.models.gap.evidence.likelihood import EvidenceFit
from fast.models.gap.fit.recalibrate import TOOL_SD
from fast.models.gap.grasps import Grasps, number_distinct
from fast.models.ids import content_id
from fast.models.records import Design, GraspContext, GraspSetup, Placement, Trace
from fast.models.traces.step_features import N_STEPS, STEP_MM, is_usable, step_means
from fast.models.traces.step_noise import QUIET_S, SensorNoise, noise_of_readings, noise_of_repeats
from fast.models.units import spell_number, spell_share
from fast.tasks.campaign.state import THICKNESSES
from fast.tasks.gap.panel import WHOLE, PanelSize, select_panel
from fast.tasks.gap.readings import read_readings
from fast.tasks.gap.split import Split, freeze_split
from fast.tasks.gap.trace_rows import designs_of, find_base_setup, measured_grasps, read_traces

_CUT_SHARE = 0.3  # of the peak: traces of whole lifts end with less than 0.2
_LATEST_MM = 1.0  # of lift at the first reading: before it a force is not known
_WIDEST_MM = 1.0  # of lift between two readings
_ODD_PRINT = 4.0  # standard deviations: one print in 16,000 is as odd
_OPPOSITE = -0.5  # cosine of measured and simulated traces: far from what any friction or modulus turns round
_SPEED_SHARE = 0.2  # that a lift may be faster or slower than its setup says
_NOISE_TRACES = 20  # of each tool, whose readings before contact are kept


@dataclass(frozen=True, eq=False)
class MeasuredGrasps:
    """Measured grasps, what each tool was printed from (t), their campaigns, and what was left out or is not known.

    answers: grasps that searches asked for to tell effects apart, which are none of the others, and readings of
    persons. context_warnings: what is not known of the order of the grasps, which theta alone does not need.
    """

    grasps: Grasps
    design_ids: tuple[str, ...]
    campaigns: tuple[str, ...]
    trace_warnings: tuple[str, ...]
    context_warnings: tuple[str, ...]
    answers: Answers | None = None

    @property
    def content_id(self) -> str:
        """Id of all that was measured, answers too."""
        if self.answers is None:
            return self.grasps.content_id
        readings = [reading.model_dump() for reading in self.answers.readings]
        return content_id("M", [self.grasps.content_id, self.answers.grasps.content_id, readings])

    @property
    def facts(self) -> tuple[Fact, ...]:
        """What persons measured of effects."""
        readings = () if self.answers is None else self.answers.readings
        return list_facts((one.kind, one.value) for one in readings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """All of them."""
        return (*self.trace_warnings, *self.context_warnings)


@dataclass(frozen=True)
class Contexts:
    """What came before each measured grasp, by its id; failed and replaced attempts count, since they wear a finger."""

    of: Mapping[str, GraspContext]
    warnings: tuple[str, ...]


def split_measurements(lake: Lake, campaign_id: str | None, seed: int, size: PanelSize = WHOLE) -> Split:
    """Return the frozen split of what was measured, or of a smaller panel of it, without a look at any force.

    Raises:
        UsageError: nothing was measured, or on several benches; too few designs or objects; a design is unknown; an
            earlier split holds out none of the panel.
    """
    rows = measured_grasps(lake, campaign_id)
    designs = designs_of(lake, [row.design_id for row in rows])
    rows = select_panel(rows, designs, size)
    ids = {designs[row.design_id].design_id for row in rows}
    objects = {row.object_id for row in rows}
    split = freeze_split(lake, campaign_id, sorted(ids), sorted(objects), seed)
    for what, held in (
        ("designs", [split.designs[name] for name in ids]),
        ("objects", [split.objects[number] for number in objects]),
    ):
        if len(set(held)) < 2:
            raise UsageError(
                f"of the {len(held)} {what} of this panel, {sum(held)} are held out by the split of seed {seed}, which "
                "an earlier search froze; ask for more of them, or take another seed."
            )
    return split


def make_data(measured: MeasuredGrasps, bank: Bank, split: Split) -> GapData:
    """Make the data: grasps and bank with the masks of a split."""
    grasps = measured.grasps
    return GapData(
        grasps=grasps,
        bank=bank,
        held_out_tools=np.array([split.designs[design_id] for design_id in measured.design_ids]),
        held_out_objects=np.array([split.objects[object_id] for object_id in grasps.objects]),
        facts=measured.facts,
    )


def check_units(data: GapData) -> list[str]:
    """Check what the size of the measured forces says about their unit.

    Raises:
        UsageError: a factor of about 1000 is suspected, or the other sign.
    """
    grasps, bank = data.grasps, data.bank
    simulated_n = bank.centre_steps_n[grasps.tool, bank.find_columns(grasps)]
    return check_forces(grasps.steps_n, simulated_n, bank.centre.young_modulus_mpa)


def check_forces(steps_n: np.ndarray, simulated_n: np.ndarray, modulus_mpa: float) -> list[str]:
    """Check the same of measured and simulated traces (n x 120, N; NaN where none is simulated) at a Young's modulus.

    Raises:
        UsageError: as `check_units`.
    """
    is_known = np.isfinite(simulated_n).all(axis=1)
    if not is_known.any():
        return []
    measured, simulated = steps_n[is_known], simulated_n[is_known]
    if has_other_sign(measured, simulated):
        raise UsageError(
            "Measured forces have the other sign than simulated ones: a force is positive where the object pulls the "
            "gripper down; turn the sign and import the grasps again, into another lake."
        )
    share = np.abs(measured).sum(axis=1) / np.abs(simulated).sum(axis=1)
    return find_unit_warnings(float(np.median(share)) * modulus_mpa, ThetaPriors())


def has_other_sign(steps_n: np.ndarray, others_n: np.ndarray) -> bool:
    """Return whether most traces (n x 120, N) run against others, whatever their size: a cosine below -0.5."""
    lengths = np.linalg.norm(steps_n, axis=1) * np.linalg.norm(others_n, axis=1)
    cosines = (steps_n * others_n).sum(axis=1)[lengths > 0] / lengths[lengths > 0]
    return bool(len(cosines) and np.median(cosines) < _OPPOSITE)


def check_repeats(grasps: Grasps) -> list[str]:
    """Check whether repeats can tell what changes slowly: a sentence if there are none, or each follows the other."""
    cells: dict[tuple[int, int], list[int]] = defaultdict(list)
    for tool, obj, context in zip(grasps.tool.tolist(), grasps.obj.tolist(), grasps.contexts, strict=True):
        cells[tool, obj].append(context.batch_grasps)
    apart = [step for made in cells.values() for step in np.diff(sorted(made)).tolist()]
    if not apart:
        return ["No tool gripped an object twice: what changes from grasp to grasp cannot be seen; measure repeats."]
    if np.median(apart) > 1:
        return []
    return [
        "Repeats were made one right after the other: what changes slowly, such as pressure or wear, is hardly seen in "
        'them; measure with `repeats_order = "interleaved"`.'
    ]


def check_prints(fit: EvidenceFit) -> list[str]:
    """Check whether prints are alike: a sentence for each that is fitted stiffer or softer than one of a lot would be.

    The modulus of a print takes up what makes a tool stronger or weaker, so little of a gap may be left of it.
    """
    apart = fit.moduli - np.median(fit.moduli)
    return [
        f"Tool {tool} is fitted {np.exp(own):.2f} times as stiff as the others, where prints of a lot differ by "
        f"{spell_share(TOOL_SD)}: look at its material, walls and mount, and whether it has another tool's name."
        for tool, own in zip(fit.problem.surrogate.grasps.tools, apart, strict=True)
        if abs(own) > _ODD_PRINT * TOOL_SD
    ]


def read_grasps(lake: Lake, campaign_id: str | None, size: PanelSize = WHOLE) -> MeasuredGrasps:
    """Read measured grasps, or those of a smaller panel: the last good attempt of each repeat, with a usable trace.

    Raises:
        UsageError: nothing was measured, or on several benches; a design is unknown; no trace can be used.
    """
    rows = measured_grasps(lake, campaign_id)
    if size != WHOLE:
        rows = select_panel(rows, designs_of(lake, [row.design_id for row in rows]), size)
    by_tool: dict[str, list[GraspRow]] = defaultdict(list)
    for row in rows:
        by_tool[row.tool_id].append(row)
    steps_n, quiet, sentences = _steps(lake, by_tool)
    used = [row for row in rows if row.grasp_id in steps_n]
    if all(row.request_id for row in used):
        why = " ".join(sentences) or "All were asked for by searches."
        raise UsageError(
            f"none of the {len(rows)} measured grasps can be searched: {why} Measure again, and record the whole lift, "
            "until the fingers let go."
        )
    usual = [row for row in used if not row.request_id]
    tools, objects = sorted({row.tool_id for row in usual}), sorted({row.object_id for row in usual})
    used = [row for row in used if row.tool_id in tools and row.object_id in objects]
    nominal = {row.tool_id: row.design_id for row in used}
    known = designs_of(lake, [*nominal.values()])
    printed, printed_sentences = _read_printed(lake, {tool: known[nominal[tool]] for tool in tools})
    contexts = rebuild_contexts(lake, campaign_id)
    tool = np.array([tools.index(row.tool_id) for row in used])
    obj = np.array([objects.index(row.object_id) for row in used])
    all_steps_n = np.array([steps_n[row.grasp_id] for row in used])
    made_by = [GraspSetup.model_validate_json(row.setup_json) for row in used]
    setups, setup = number_distinct(made_by, find_base_setup(rows))
    placements, placement = number_distinct([row.placement for row in used], Placement())
    is_asked = _find_questions(lake, used)
    is_usual = (setup == 0) & (placement == 0) & ~is_asked
    cell = tool * len(objects) + obj
    noise, noise_sentences = _noise(quiet, all_steps_n[is_usual], cell[is_usual], setups[0])
    grasps = Grasps(
        tools=tuple(tools),
        designs=printed,
        objects=tuple(objects),
        tool=tool,
        obj=obj,
        contexts=tuple(contexts.of[row.grasp_id] for row in used),
        steps_n=all_steps_n,
        grasp_ids=tuple(row.grasp_id for row in used),
        noise=noise,
        setups=setups,
        setup=setup,
        placements=placements,
        placement=placement,
    )
    return MeasuredGrasps(
        grasps=grasps.select(np.flatnonzero(~is_asked)),
        design_ids=tuple(known[nominal[tool]].design_id for tool in tools),
        campaigns=tuple(sorted({row.campaign_id for row in used})),
        trace_warnings=(*sentences, *printed_sentences, *noise_sentences),
        context_warnings=contexts.warnings,
        answers=_gather_answers(lake, campaign_id, grasps, used, is_asked),
    )


def _find_questions(lake: Lake, rows: Sequence[GraspRow]) -> np.ndarray:
    """Find which grasps (n) were asked for to tell effects apart; one for a parameter is a grasp like any other."""
    asked = lake.records(GraspRequestRow, request_id=[row.request_id for row in rows if row.request_id])
    for_parameter = {row.request_id for row in asked if row.parameter}
    return np.array([bool(row.request_id) and row.request_id not in for_parameter for row in rows])


def _gather_answers(
    lake: Lake, campaign_id: str | None, grasps: Grasps, rows: Sequence[GraspRow], is_asked: np.ndarray
) -> Answers | None:
    """Gather what came of questions: grasps (of `rows`) in the pairs asked for, and readings of persons."""
    readings = read_readings(lake, campaign_id)
    places = {row.request_id: place for place, row in enumerate(rows) if is_asked[place]}
    asked = lake.records(GraspRequestRow, request_id=list(places))
    of_pair: dict[tuple[str, int], list[int]] = defaultdict(list)
    for request in sorted(asked, key=lambda row: (row.search_id, row.place)):
        of_pair[request.search_id, request.place // 2].append(places[request.request_id])
    if not of_pair and not readings:
        return None
    pairs = []
    for both in of_pair.values():
        is_changed = [bool(grasps.setup[at] or grasps.placement[at]) for at in both]
        if sorted(is_changed) == [False, True]:
            pairs.append(sorted(both, key=lambda at: is_changed[both.index(at)]))
    kept = sorted(places.values())
    numbers = {place: number for number, place in enumerate(kept)}
    numbered = [[numbers[place] for place in pair] for pair in pairs]
    return Answers(grasps.select(np.array(kept, dtype=int)), np.array(numbered, dtype=int).reshape(-1, 2), readings)


def rebuild_contexts(lake: Lake, campaign_id: str | None) -> Contexts:
    """Rebuild the contexts of all grasps of a campaign, or of the lake.

    Batches are told apart by campaign and number. Within one, grasps follow each other by `order`, which no clock can
    turn round, else by `started_at`, else tool by tool, repeat by repeat; only `started_at` tells the time.
    """
    where = "WHERE campaign_id = ?" if campaign_id else ""
    sql = (
        'SELECT grasp_id, campaign_id, batch, tool_id, object_id, repeat, attempt, "order", started_at '
        f"FROM grasps {where}"
    )
    batches: dict[tuple[str, int | None], list[dict[str, Any]]] = defaultdict(list)
    for row in lake.query(sql, [campaign_id] if campaign_id else []).to_pylist():
        batches[row["campaign_id"], row["batch"]].append(row)
    found: dict[str, GraspContext] = {}
    n_untimed = n_unordered = 0
    for rows in batches.values():
        if any(row["started_at"] is None for row in rows):
            n_untimed += len(rows)
            n_unordered += len(rows) if any(row["order"] is None for row in rows) else 0
        found |= _in_batch(rows)
    warnings = []
    if n_untimed:
        warnings.append(f"{n_untimed} grasps have no `started_at`: nothing that changes with the time can be found.")
    if n_unordered:
        warnings.append(
            f"{n_unordered} grasps have neither `started_at` nor `order`: they are taken to be made tool by tool and "
            "repeat by repeat, and what wears off is placed accordingly."
        )
    return Contexts(found, tuple(warnings))


def _steps(
    lake: Lake, by_tool: Mapping[str, Sequence[GraspRow]]
) -> tuple[dict[str, np.ndarray], list[Trace], list[str]]:
    """Return step means by grasp, some pre-contact readings less their tool's offset, and what was left out."""
    found: dict[str, np.ndarray] = {}
    quiet: list[Trace] = []
    seen: dict[bytes, str] = {}
    speeds: dict[str, tuple[float, float]] = {}  # mm/s, of the lift and of the setup, where these are two
    n_copies = n_cut = n_flat = n_late = n_sparse = 0
    for rows in by_tool.values():
        before: list[Trace] = []
        setups = {row.grasp_id: GraspSetup.model_validate_json(row.setup_json) for row in rows}
        for grasp_id, trace in read_traces(lake, TraceRow, [row.grasp_id for row in rows]):
            if not is_usable(trace):
                continue
            if np.ptp(trace.force_n) == 0:
                n_flat += 1
                continue
            if is_cut(trace):
                n_cut += 1
                continue
            if trace.lift_mm.min() > _LATEST_MM:
                n_late += 1
                continue
            steps_n = step_means(trace)
            if steps_n.any() and seen.setdefault(steps_n.tobytes(), grasp_id) != grasp_id:
                n_copies += 1
                continue
            found[grasp_id] = steps_n
            n_sparse += bool(np.median(np.diff(trace.lift_mm[trace.is_lift])) > _WIDEST_MM)
            speed, said = _find_speed(trace), setups[grasp_id].lift_speed_mm_per_s
            if abs(speed - said) > _SPEED_SHARE * said:
                speeds[grasp_id] = speed, said
            if len(before) < _NOISE_TRACES:
                before.append(_before_contact(trace))
        quiet += _less_their_mean([trace for trace in before if len(trace.time_s) > 2])
    n_all = sum(len(rows) for rows in by_tool.values())
    n_lost = n_all - len(found) - n_copies - n_cut - n_flat - n_late
    sentences = []
    if n_lost:
        sentences.append(f"{n_lost} of {n_all} grasps have no trace, or one without a lift of 3 mm; left out.")
    if n_flat:
        sentences.append(f"{n_flat} of {n_all} grasps have the same force in every reading; left out.")
    if n_cut:
        sentences.append(f"{n_cut} of {n_all} grasps end while the fingers still hold the object; left out.")
    if n_late:
        sentences.append(f"{n_late} of {n_all} grasps begin after {_LATEST_MM:g} mm of lift; left out.")
    if n_sparse:
        sentences.append(
            f"{n_sparse} of {n_all} grasps have readings more than {_WIDEST_MM:g} mm of lift apart: what happens "
            "between them is not known, so a name may be wrong; record faster."
        )
    if speeds:
        grasp_id, (speed, said) = next(iter(speeds.items()))
        sentences.append(
            f"{len(speeds)} of {n_all} grasps were lifted at another speed than their setup says, first {grasp_id} at "
            f"{spell_number(speed)} mm/s instead of {said:g}: what hangs on speed is told wrongly; import them with "
            "the column lift_speed_mm_per_s in grasps.csv."
        )
    if n_copies:
        sentences.append(f"{n_copies} of {n_all} grasps have the samples of another grasp; the copies are left out.")
    return found, quiet, sentences


def _find_speed(trace: Trace) -> float:
    """Find the speed of a lift in mm/s, between a tenth and nine tenths of its height."""
    time_s, lift_mm = trace.time_s[trace.is_lift], trace.lift_mm[trace.is_lift]
    start, end = (int(np.argmax(lift_mm >= share * lift_mm.max())) for share in (0.1, 0.9))
    return float((lift_mm[end] - lift_mm[start]) / max(time_s[end] - time_s[start], 1e-3))


def is_cut(trace: Trace) -> bool:
    """Return whether the recording ended with force on the fingers: what came after is not known, and not zero."""
    lift_mm, force_n = trace.lift_mm[trace.is_lift], trace.force_n[trace.is_lift]
    at_end_n = force_n[lift_mm >= lift_mm[-1] - STEP_MM].mean()
    return bool(lift_mm[-1] < N_STEPS * STEP_MM - STEP_MM and at_end_n > _CUT_SHARE * force_n.max())


def _before_contact(trace: Trace) -> Trace:
    is_quiet = (trace.time_s - trace.time_s[0] < QUIET_S) & (trace.lift_mm <= 0)
    return Trace(trace.time_s[is_quiet], trace.lift_mm[is_quiet], trace.force_n[is_quiet])


def _less_their_mean(traces: Sequence[Trace]) -> list[Trace]:
    """Return traces less their mean: what hangs on the load cell differs from tool to tool and is no noise."""
    if not traces:
        return []
    mean_n = np.concatenate([trace.force_n for trace in traces]).mean()
    return [Trace(trace.time_s, trace.lift_mm, trace.force_n - mean_n) for trace in traces]


def _noise(
    quiet: Sequence[Trace], steps_n: np.ndarray, cell: np.ndarray, setup: GraspSetup
) -> tuple[SensorNoise, list[str]]:
    """Return sensor noise from readings before contact, or if there are none, from what repeats do not share."""
    try:
        return noise_of_readings(quiet), []
    except UsageError:
        noise = noise_of_repeats(steps_n, cell, setup.lift_speed_mm_per_s)
        return noise, [
            "readings before the fingers touch are too few, or all the same: the noise of the load cell, "
            f"{spell_number(noise.sd_n)} N, is taken from repeats."
        ]


def _read_printed(lake: Lake, designs: Mapping[str, Design]) -> tuple[tuple[Design, ...], list[str]]:
    """Read tool designs with the thicknesses that a person measured, and those that the simulator cannot make."""
    said = {row.tool_id: row for row in lake.records(ToolRow, tool_id=list(designs))}
    printed, sentences = [], []
    for tool_id, design in designs.items():
        row = said.get(tool_id)
        thicknesses = {name: getattr(row, f"measured_{name}", None) for name in THICKNESSES}
        values = design.model_dump()
        values |= {name: value for name, value in thicknesses.items() if value is not None and name in values}
        try:
            printed.append(type(design).model_validate(values))
        except ValidationError:
            printed.append(design)
            sentences.append(
                f"tool {tool_id} was printed with walls beyond the range of designs; it is simulated as designed."
            )
    return tuple(printed), sentences


def _in_batch(rows: Sequence[dict[str, Any]]) -> dict[str, GraspContext]:
    is_timed = all(row["started_at"] is not None for row in rows)
    orders = {row["order"] for row in rows}
    is_ordered = None not in orders and (len(orders) == len(rows) or not is_timed)

    def place(row: dict[str, Any]) -> tuple[Any, ...]:
        by = row["order"] if is_ordered else row["started_at"] if is_timed else 0
        return (by, row["tool_id"], row["repeat"], row["object_id"], row["attempt"])

    made = sorted(rows, key=place)
    began = min(row["started_at"] for row in rows) if is_timed else None
    of_tool: dict[str, int] = defaultdict(int)
    of_pair: dict[tuple[str, int], int] = defaultdict(int)
    found = {}
    for number, row in enumerate(made):
        pair = row["tool_id"], row["object_id"]
        found[row["grasp_id"]] = GraspContext(
            repeat=of_pair[pair],
            tool_grasps=of_tool[row["tool_id"]],
            batch_grasps=number,
            clock_s=(row["started_at"] - began).total_seconds() if began is not None else 0.0,
        )
        of_tool[row["tool_id"]] += 1
        of_pair[pair] += 1
    return found
