"""The answer of gap discovery, as it is written to `findings.json` and shown in the report; its keys stay."""

from typing import Any, Literal

from pydantic import model_validator

from fast.models.records import GraspSetup, Placement, Record

Interval = tuple[float, float]
_OF_HELD_OUT = ("held_out_gain_nats", "held_out_rmse_change", "grouped_r2")
LEFTOVER = 0.1  # of what the first name explained
NONE, UNKNOWN = "none", "unknown"  # candidates that are no effect


class WhereFinding(Record):
    """A place where simulation and measurement disagree after theta was calibrated again."""

    sentence: str
    """What a person reads."""
    phase: str
    """Part of the grasp: dip, rise, peak, slip or tail."""
    stratum: str
    """Which tools, objects, repeats, in words."""
    effect_size_n: float
    """Mean of measured minus simulated."""
    ci90: Interval
    """90 % interval of that, N."""
    share: float | None = None
    """The same of the measured force."""
    p_value: float | None = None
    """Smallest of the tests that it stands on."""
    q_value: float | None = None
    """Largest q of these tests, by Benjamini and Hochberg."""


class Candidate(Record):
    """An effect that was tried: `none` and `unknown` are candidates too.

    nats: the log of how much more probable it makes the data; of `unknown`, what a pattern without a name does.
    visible_fraction: what is left of its signature when theta and tools are fitted again.
    """

    effect: str
    probability: float
    nats: float | None = None
    visible_fraction: float | None = None
    parameters: dict[str, float] = {}

    @model_validator(mode="before")
    @classmethod
    def _read_older(cls, data: Any) -> Any:
        """Read searches of before 0.3, which ranked by what held-out grasps gained."""
        if isinstance(data, dict) and "held_out_gain_nats" in data:
            kept = {key: value for key, value in data.items() if key not in _OF_HELD_OUT}
            return {**kept, "nats": data["held_out_gain_nats"]}
        return data


class ParameterEstimate(Record):
    """A parameter of a named effect, from the posterior jointly with theta."""

    median: float
    ci90: Interval


class LawCurve(Record):
    """The law of a named effect as the data have it: a quantity against a state, with its 90 % band.

    `quantity` and `state`: in words, with units ("friction over friction at rest", "slip, mm").
    """

    quantity: str
    state: str
    at: tuple[float, ...]
    median: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


class Rest(Record):
    """What is left that nothing of the catalogue explains: in words, and as a mean force over the lift.

    `force_n`, `low_n`, `high_n`: mean gap and its 90 % band over tools and objects, at `lift_mm`. `has_sign`: whether
    tools and objects agree on more or less force in some part of the lift.
    """

    sentence: str
    lift_mm: tuple[float, ...]
    force_n: tuple[float, ...]
    low_n: tuple[float, ...]
    high_n: tuple[float, ...]
    has_sign: bool = True


class Decision(Record):
    """The answer of a round: one effect, a set that cannot be told apart, none, or not in the catalogue."""

    kind: Literal["effect", "set", "none", "unknown"]
    """Which of these."""
    effects: tuple[str, ...] = ()
    """Names, the likeliest first; none without a name."""
    family: str = ""
    """What the named effects have in common."""
    probability: float
    """That the answer is right, whatever its kind."""
    parameters: dict[str, ParameterEstimate] = {}
    """Of the first effect, by name, in their units."""
    sentence: str = ""
    """What a person reads."""
    left_share: float | None = None
    """Of what the answer explains, what another effect or a model without a name would still explain."""
    law: LawCurve | None = None
    """Of the first effect; None without one, or for one that is a plain number."""
    rest: Rest | None = None
    """What is left where the answer is that it is not in the catalogue."""
    possible: tuple[str, ...] = ()
    """Of a first alarm, the effects, or "unknown", that are not excluded: in made-up worlds of each kind of truth, nine
    in ten alarms had it among these."""
    drift: str = ""
    """What repeats of the same grasps differ by, in words, where they tell more than anything else."""


class RoundFindings(Record):
    """What one round found; `version` is the simulator version with what was named, if anything was added.

    `refused`: why what was named was not added, a sentence; empty if it was, or if there was nothing to add.
    `patternless_n`: root mean square of the gap in which designs, objects and repeats show no pattern.
    """

    where: tuple[WhereFinding, ...]
    candidates: tuple[Candidate, ...]
    named: Decision
    version: str | None = None
    dropped: tuple[str, ...] = ()
    refused: str = ""
    patternless_n: float | None = None

    @property
    def rest_sentence(self) -> str:
        """What is left of an answer without a name: of all grasps, or where they agree on no sign, of single ones."""
        rest = self.named.rest
        if rest is None:
            return ""
        return self.where[0].sentence if self.where and not rest.has_sign else rest.sentence

    @property
    def explained_nats(self) -> float:
        """The evidence for the answer: of its best effect, or of any model where it is unknown."""
        wanted = set(self.named.effects) or {self.named.kind}
        return max((c.nats or 0.0 for c in self.candidates if c.effect in wanted), default=0.0)


class Gap(Record):
    """Root mean square difference of traces on held-out designs and objects, before and after.

    `ci95`: of the closed share; None where fewer than three designs or objects were held out.
    """

    rmse_before_n: float
    rmse_after_n: float
    rmse_floor_n: float
    closed_fraction: float
    ci95: Interval | None


class Verdict(Record):
    """Whether the simulator that a search ended with replaces the one in use, by held-out grasps that both simulated.

    present_version_id: in use when the search began. present_rmse_n, rmse_n: root mean square differences of traces,
    in N. sentence: why.
    """

    present_version_id: str
    version_id: str
    present_rmse_n: float
    rmse_n: float
    is_accepted: bool
    sentence: str


class Confound(Record):
    """Something that these data cannot tell from another quantity, declared and never named."""

    effect: str
    of: str
    experiment: str


class AskedGrasps(Record):
    """Grasps of a tool on an object in one way: `n` of them, and as many as usual in turn if `setting` says how.

    setting: what is done otherwise, in words; usual: the setup of ordinary grasps.
    """

    tool: str
    object: int
    setup: GraspSetup
    placement: Placement = Placement()
    usual: GraspSetup = GraspSetup()
    n: int
    setting: str


class Promise(Record):
    """What an experiment promises between two of the hypotheses, in nats: 3 are odds of 20 to 1."""

    between: tuple[str, str]
    nats: float


class Outcome(Record):
    """What it would mean: if `effect` is true, this is what comes."""

    effect: str
    sentence: str


class Prediction(Record):
    """What a hypothesis predicts of the first asked grasp: force over lift, at every `STEP_MM`."""

    effect: str
    force_n: tuple[float, ...]


class PersonQuestion(Record):
    """What a person is asked to measure where no grasp of the bench tells; `kind` of `models.gap.ask.person`."""

    kind: str
    sentence: str
    label: str


class NextExperiment(Record):
    """What to do so that what is still possible falls apart: grasps of the bench, or a measurement by a person."""

    grasps: tuple[AskedGrasps, ...] = ()
    """To be made; none where a person is to measure."""
    possible: dict[str, float] = {}
    """Probability of each hypothesis, `none` and `unknown` among them."""
    separates: tuple[str, ...]
    """Hypotheses that would fall apart."""
    promised_grasps: int
    """How many grasps that takes, as many as usual among them; 0 of a person."""
    promised: tuple[Promise, ...] = ()
    """What it promises between two of the hypotheses."""
    minutes: float = 0.0
    """Of the bench or the person."""
    sentence: str
    """What a person reads."""
    outcomes: tuple[Outcome, ...] = ()
    """What it would mean, by the hypothesis that is true."""
    predictions: tuple[Prediction, ...] = ()
    """Forces of the first asked grasp, by hypothesis."""
    person: PersonQuestion | None = None
    """What a person is asked to measure; None where grasps are asked for."""
    parameter: str = ""
    """`effect.name`, or of theta, whose interval shall get shorter, where a name is sure and nothing has to fall apart;
    empty otherwise."""
    ci90: Interval | None = None
    """Interval of that parameter when it was asked."""
    sd_left: float | None = None
    """Share of its width that is promised to stay."""

    @model_validator(mode="before")
    @classmethod
    def _read_older(cls, data: Any) -> Any:
        """Read searches of before 2.1, which gave a setting without a tool, as a sentence."""
        if isinstance(data, dict) and "n_grasps" in data:
            kept = {name: data[name] for name in ("separates", "sentence")}
            return {**kept, "promised_grasps": data["n_grasps"]}
        return data


class Asked(Record):
    """What came of grasps and readings that searches had asked for.

    promised, spent: grasps. promised_nats, got_nats: for what is believed now, over what is next to it; of a parameter,
    log of how much shorter its interval gets. before, after: probability of each hypothesis. outcome: a sentence.
    """

    promised: int
    spent: int
    promised_nats: float
    got_nats: float
    before: dict[str, float]
    after: dict[str, float]
    outcome: str


class RankedDesigns(Record):
    """Whether the order of the best measured designs hangs on what is not known of the calibrated simulator.

    tools: printed of them, best first. parameter: on which the order hangs most, `effect.name` or of theta; ci90: its
    interval. agreement: share of the posterior's draws with this order. is_settled: no grasp would change it.
    """

    tools: tuple[str, ...]
    parameter: str
    ci90: Interval
    agreement: float
    is_settled: bool
    sentence: str


class FamilyTold(Record):
    """What became of n rehearsed worlds that hide one family, or (without a name) a cause of no catalogue."""

    family: str
    """As the catalogue has it; empty: none there."""
    n: int
    """Worlds that hide it, and nothing else."""
    n_alarms: int
    """Those in which anything was noticed."""
    n_right: int
    """Alarms that got this family as their name; of no catalogue, *unknown*."""
    n_unknown: int
    """Alarms that were called unknown."""
    taken_for: tuple[str, ...]
    """Families of the other names, the most frequent first."""
    seen_size: float | None
    """Size from which on nine in ten are noticed, of the force; None: too few worlds, or not even of the largest."""


class SizeTold(Record):
    """The smallest size of an effect that a panel would have shown in nine of ten cases."""

    effect: str
    words: str
    share: float | None
    """What it changes, of the force; None: no plausible size is seen."""


class PanelTold(Record):
    """What a panel can tell, by made-up worlds of it. lines: signs beyond them are an alarm, by name."""

    lines: dict[str, float]
    families: tuple[FamilyTold, ...]
    sizes: tuple[SizeTold, ...]


class Findings(Record):
    """`findings.json`."""

    alarm: bool
    """Whether any round named something that is missing."""
    rounds: tuple[RoundFindings, ...]
    """In order."""
    gap: Gap
    """On held-out grasps, before and after all rounds."""
    aliases: tuple[Confound, ...]
    """Confounds: what these data cannot tell from theta or tools."""
    next_experiment: NextExperiment | None
    """Of the first round that leaves anything open, or for the ranking of designs; None: nothing is asked."""
    seed: int
    """Of all draws of the search."""
    budget: dict[str, float]
    """What it took: numbers of simulations by kind, and minutes of analysis."""
    warnings: tuple[str, ...] = ()
    """Sentences."""
    power: str = ""
    """Of searches before 0.3, a sentence on what could still hide."""
    asked: tuple[Asked, ...] = ()
    """What came of earlier experiments."""
    verdict: Verdict | None = None
    """Whether the simulator in use is replaced; None in answers of older code."""
    ranking: RankedDesigns | None = None
    """Whether the order of the best designs is settled; None where the simulator has no effect."""
    in_use: tuple[str, ...] = ()
    """Effects that the simulator had when the search began, of earlier searches."""
    panel: PanelTold | None = None
    """What the panel can tell; None in answers of older code."""

    @property
    def is_suspicion(self) -> bool:
        """Whether grasps are asked for without an alarm, as they would show an effect that is too weak for one."""
        asked = self.next_experiment
        return not self.alarm and asked is not None and bool(asked.grasps) and not asked.parameter

    def is_leftover(self, place: int) -> bool:
        """Return whether a later round speaks of what an earlier name left over, and not of something else missing.

        Law and parameters of a name are never exact: what they leave is less than a tenth of what the name explained,
        or is taken by an effect of the same family, or by one that does not make held-out errors smaller.
        """
        named = self.rounds[place].named
        if place == 0 or named.kind == "none" or not self.rounds[0].named.effects:
            return False
        if self.rounds[place].refused:
            return True
        if named.family and named.family in {earlier.named.family for earlier in self.rounds[:place]}:
            return True
        if named.kind == "unknown" and self.rounds[0].named.left_share is not None:
            return self.rounds[0].named.left_share < LEFTOVER
        first, now = (self.rounds[k].explained_nats for k in (0, place))
        return first > 0.0 and now < LEFTOVER * first
