import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from fast.flows.gap.bench_plan import describe_command
from fast.flows.gap.search import describe_outcome
from fast.flows.report.gap import sentences
from fast.flows.report.gap.page import write_findings, write_gap_report
from fast.flows.report.gap.sentences import INDEPENDENT, GapPage, ThetaRow
from fast.models.gap.evaluation.evaluate import AFTER, BEFORE, Evaluation, evaluate
from fast.models.gap.evaluation.held_out import HeldOut, add_scatter
from fast.models.gap.findings import (
    Asked,
    AskedGrasps,
    Candidate,
    Confound,
    Decision,
    FamilyTold,
    Findings,
    Gap,
    LawCurve,
    NextExperiment,
    Outcome,
    PanelTold,
    ParameterEstimate,
    PersonQuestion,
    Prediction,
    Promise,
    RankedDesigns,
    Rest,
    RoundFindings,
    SizeTold,
    WhereFinding,
)
from fast.models.gap.where.locate import locate
from fast.models.gap.where.residuals import Residuals
from fast.models.records import EffectValue, GraspSetup
from fast.models.simulation.effects.catalogue import CATALOGUE
from tests.synthetic.gap import GapTruth, made_up_gap

LAG = EffectValue(effect="load_cell_lag", parameters={"time_constant_s": 0.3})
NAMED = Decision(
    kind="effect",
    effects=("load_cell_lag",),
    probability=0.97,
    parameters={"time_constant_s": ParameterEstimate(median=0.29, ci90=(0.27, 0.31))},
    sentence="Held-out grasps are better with it.",
)
NOTHING = Decision(kind="none", probability=0.99)


def _candidate(effect: str, probability: float) -> Candidate:
    return Candidate(effect=effect, probability=probability, nats=12.0)


@pytest.fixture(scope="module")
def content() -> GapPage:
    truth = GapTruth(effects=(LAG,))
    data = made_up_gap(12, 9, 0, truth, held_out=(2, 3))
    theta = np.array(list(truth.theta.model_dump().values()))
    before, after = data.held_out.predict_steps(theta), data.held_out.predict_steps(theta, [LAG])
    residuals = Residuals.of(data.training, data.training.predict_steps(theta), truth.theta.young_modulus_mpa)
    held_out = HeldOut.of(data, truth.theta)
    scatter = np.full(len(before), 0.044)
    first, last = (
        add_scatter(label, np.repeat(steps[None], 2, axis=0), held_out, scatter, 0.08)
        for label, steps in ((BEFORE, before), (AFTER, after))
    )
    evaluation, where = evaluate(held_out, first, last), locate(residuals)
    return GapPage(
        findings=_findings(
            evaluation, (RoundFindings(where=where.findings, candidates=_CANDIDATES, named=NAMED, version="V1"),)
        ),
        where=(where,),
        residuals=residuals,
        evaluation=evaluation,
        theta=(ThetaRow("young_modulus_mpa", (9.0, 8.5, 9.5), (10.0, 9.6, 10.4), INDEPENDENT["young_modulus_mpa"]),),
        assumed=("Two designs and three objects were held out.",),
    )


def words_of(page: Path) -> str:
    """The page, on one line: where a line of its template ends means nothing."""
    return " ".join(page.read_text(encoding="utf-8").split())


FAST = GraspSetup(lift_speed_mm_per_s=20.0)
ASKED = Asked(
    promised=4,
    spent=4,
    promised_nats=3.1,
    got_nats=4.0,
    before={"load_cell_lag": 0.5, "unknown": 0.5},
    after={"load_cell_lag": 0.97, "unknown": 0.03},
    outcome="4 grasps say load cell lag.",
)
_CANDIDATES = (_candidate("load_cell_lag", 0.97), _candidate("none", 0.01), _candidate("unknown", 0.02))


def _findings(evaluation: Evaluation, rounds: tuple[RoundFindings, ...]) -> Findings:
    return Findings(
        alarm=any(r.named.kind != "none" for r in rounds),
        rounds=rounds,
        gap=evaluation.gap,
        aliases=(Confound(effect="load_cell_gain", of="Young's modulus", experiment="a dead weight"),),
        next_experiment=NextExperiment(
            grasps=(AskedGrasps(tool="x/B01T3", object=14, setup=FAST, n=3, setting="lifted at 20 mm/s"),),
            separates=("load_cell_lag", "object_post_compliance"),
            promised_grasps=6,
            promised=(Promise(between=("load_cell_lag", "object_post_compliance"), nats=3.4),),
            sentence="Lift fast.",
            predictions=(Prediction(effect="load_cell_lag", force_n=(1.0, 2.0)),),
        ),
        asked=(ASKED,),
        seed=3,
        budget={"bank_simulations": 100.0},
        warnings=("<Few> designs.",),
        panel=PanelTold(
            lines={"nats": 45.0, "omnibus": 4.5, "full_nats": 97.3, "spread_nats": 25.0, "sure_nats": 25.0},
            families=(
                FamilyTold(family="delay between lift and force", n=12, n_alarms=10, n_right=8, n_unknown=1,
                           taken_for=("compliance in series",), seen_size=0.02),
                FamilyTold(family="", n=40, n_alarms=30, n_right=29, n_unknown=29, taken_for=(), seen_size=None),
            ),
            sizes=(SizeTold(effect="load_cell_lag", words="tau 0.02 s", share=0.013),),
        ),
    )  # fmt: skip


def test_page_says_where_what_and_how_much(content: GapPage, tmp_path: Path) -> None:
    page = words_of(write_gap_report(content, tmp_path, "X1"))
    gap = content.findings.gap
    assert content.findings.rounds[0].where[0].sentence.replace("'", "&#39;") in page
    assert "First-order lag of the load-cell transmitter" in page
    assert f"{gap.rmse_before_n:.2f}" in page
    assert f"floor {gap.rmse_floor_n:.2f} N" in page
    assert "Lift fast." in page
    assert "B01T3" in page
    assert "load cell lag or object post compliance" in page
    assert "Asked before: 4 grasps promised, 4 made. 4 grasps say load cell lag. load cell lag 0.50 to 0.97" in page
    assert "odds of the right one, about" in page
    assert ">30 to 1<" in page
    assert "a dead weight" in page
    assert "Where most of the gap is" in page
    assert "No larger than chance makes it with these tools and objects:" in page
    assert "a cause of no catalogue 30 of 40 - 29 of 30 -" in re.sub("<[^>]+>| +", " ", page).replace("  ", " ")
    assert "1.3 % of the force (tau 0.02 s)" in page
    assert "nearer" in page  # 9 to 10 MPa, tensile bars say 11.5
    assert "time_constant_s dF" in page  # the law of the named effect
    assert "&lt;Few&gt; designs." in page  # what comes from data is escaped
    for source in re.findall(r'(?:src|href)="((?:figures|data)/[^"]+)"', page):
        assert (tmp_path / source).is_file(), source
    assert "http" not in page


def test_page_says_what_a_person_should_measure_how_to_answer_and_what_it_would_mean(
    content: GapPage, tmp_path: Path
) -> None:
    sentence = "No grasp of this bench tells. Please measure the walls. What it would mean: if so: walls."
    asked = NextExperiment(
        separates=("wall_thickness_offset", "rib_imperfection"),
        possible={"wall_thickness_offset": 0.6, "rib_imperfection": 0.3, "unknown": 0.1},
        promised_grasps=0,
        sentence=sentence,
        outcomes=(
            Outcome(effect="wall_thickness_offset", sentence="the reading is about 0.12"),
            Outcome(effect="rib_imperfection", sentence="the reading is about 0"),
        ),
        person=PersonQuestion(kind="walls", sentence=sentence, label="Walls, more than drawn, mm"),
    )
    findings = content.findings.model_copy(update={"next_experiment": asked})
    command = describe_command(asked, "lab", "/data/lake")
    assert command == "fast gap answer walls VALUE --campaign lab --operator NAME --lake /data/lake"
    page = words_of(write_gap_report(replace(content, findings=findings, command=command), tmp_path, "X1"))
    assert "Please measure the walls." in page
    assert "What it would mean" not in page  # its outcomes stand in a table
    for row in (("0.12", "wall thickness offset", "0.60"), ("about 0<", "rib imperfection", "0.30")):
        place = page.index(row[0])
        assert place < page.index(row[1], place) < page.index(row[2], place) < place + 200
    assert "anything else" in page
    assert f"Answer with <code>{command}</code>, or in the form" in page


def test_page_says_that_the_order_of_designs_is_settled_and_what_grasps_for_a_parameter_brought(
    content: GapPage, tmp_path: Path
) -> None:
    ranking = RankedDesigns(
        tools=("x/B01T4", "x/B01T2"),
        parameter="load_cell_lag.time_constant_s",
        ci90=(0.07, 0.09),
        agreement=0.97,
        is_settled=True,
        sentence="No further grasp: the order of the 2 best designs does not depend on it.",
    )
    refined = ASKED.model_copy(update={"before": {}, "after": {}, "outcome": "Its interval is half as wide."})
    update = {"next_experiment": None, "ranking": ranking, "asked": (refined,)}
    page = write_gap_report(replace(content, findings=content.findings.model_copy(update=update)), tmp_path, "X1")
    words = words_of(page)
    assert ranking.sentence in words
    assert words.index(ranking.sentence) < words.index("B01T4") < words.index("B01T2")
    assert "4 grasps promised, 4 made. Its interval is half as wide.</p>" in words


def test_findings_are_the_contract_for_machines(content: GapPage, tmp_path: Path) -> None:
    found = json.loads(write_findings(content.findings, tmp_path / "new").read_text(encoding="utf-8"))
    assert set(found) >= {"alarm", "rounds", "gap", "aliases", "next_experiment", "seed", "budget"}
    assert set(found["rounds"][0]) >= {"where", "candidates", "named", "version"}
    assert set(found["rounds"][0]["where"][0]) >= {"sentence", "phase", "stratum", "effect_size_n", "ci90"}
    assert set(found["gap"]) == {"rmse_before_n", "rmse_after_n", "rmse_floor_n", "closed_fraction", "ci95"}
    assert Findings.model_validate_json((tmp_path / "new" / "findings.json").read_text()) == content.findings


def test_answer_alone_makes_a_page_and_silence_is_said(tmp_path: Path) -> None:
    silent = Findings(
        alarm=False,
        rounds=(RoundFindings(where=(), candidates=(_candidate("none", 0.99),), named=NOTHING),),
        gap=Gap(rmse_before_n=0.3, rmse_after_n=0.3, rmse_floor_n=0.29, closed_fraction=0.0, ci95=(0.0, 0.0)),
        aliases=(),
        next_experiment=None,
        seed=0,
        budget={},
    )
    page = words_of(write_gap_report(GapPage(silent), tmp_path, "X2"))
    assert "these data show nothing missing" in page
    assert "No single tool, object or phase stands out" in page
    assert "too weak for an alarm" not in page


def test_what_is_asked_without_an_alarm_is_said_first(content: GapPage, tmp_path: Path) -> None:
    (first, *_), asked = content.findings.rounds, content.findings.next_experiment
    quiet = content.findings.model_copy(
        update={"alarm": False, "rounds": (first.model_copy(update={"named": NOTHING, "where": ()}),)}
    )
    assert asked is not None
    page = words_of(write_gap_report(replace(content, findings=quiet, where=()), tmp_path, "X2"))
    said = f"An effect may be too weak for an alarm: {asked.promised_grasps} grasps at another setting would show it."
    assert said in page
    assert "No alarm was raised." in page
    assert describe_outcome(quiet).endswith("would show an effect that is too weak for an alarm")
    assert "too weak" not in describe_outcome(quiet.model_copy(update={"next_experiment": None}))


def test_a_gap_that_no_place_is_sure_of_says_what_so_few_tools_can_show(content: GapPage, tmp_path: Path) -> None:
    (first, *others), power = content.findings.rounds, "4 designs show a gap of 22 % or more."
    nowhere = content.findings.model_copy(
        update={"rounds": (first.model_copy(update={"where": ()}), *others), "power": power}
    )
    page = words_of(write_gap_report(replace(content, findings=nowhere, where=()), tmp_path, "X2"))
    assert f"no single tool, object or phase is sure to carry more of it than others. {power}" in page
    assert "stands out" not in page
    assert "explains the traces together" in page
    unknown = _round(Decision(kind="unknown", probability=0.7))
    page = words_of(write_gap_report(GapPage(_told(unknown)), tmp_path, "X3"))
    assert "no single tool, object or phase is sure" in page
    assert "explains the traces together" not in page


def _told(*rounds: RoundFindings) -> Findings:
    gap = Gap(rmse_before_n=0.5, rmse_after_n=0.3, rmse_floor_n=0.1, closed_fraction=0.5, ci95=(0.4, 0.6))
    is_alarm = any(r.named.kind != "none" for r in rounds)
    return Findings(alarm=is_alarm, rounds=rounds, gap=gap, aliases=(), next_experiment=None, seed=0, budget={})


def _round(named: Decision, *candidates: Candidate, **more: Any) -> RoundFindings:
    return RoundFindings(where=(), candidates=candidates or (_candidate("none", 0.1),), named=named, **more)


def test_what_a_name_leaves_over_is_not_called_found() -> None:
    names = ("force_limited_closing", "base_compliance", "load_cell_lag")
    named = [Decision(kind="effect", effects=(name,), probability=0.9, family="closing") for name in names]
    findings = _told(*map(_round, named[:2]), _round(named[2], refused="it does not help."))
    said = "found force_limited_closing; base_compliance added for what that leaves over; held-out error"
    assert describe_outcome(findings).startswith(said)


def test_a_set_and_a_name_behind_it_are_both_said() -> None:
    either = Decision(kind="set", effects=("load_cell_lag", "lift_misalignment"), probability=0.9)
    wear = Decision(kind="effect", effects=("friction_wear",), probability=0.95)
    findings = _told(*map(_round, (either, wear, NOTHING)))
    said = describe_outcome(findings)
    assert said.startswith("found friction_wear; one of load_cell_lag, lift_misalignment, not told apart; held-out")
    assert sentences.shorten_findings(findings) == "one of 2 causes, friction wear"
    assert "cannot tell apart, then Friction drifts" in sentences.describe_findings(findings)
    assert sentences.describe_sureness(findings) == "is missing; right with probability 0.90, 0.95"
    assert [sentences.describe_notes(found, False) for found in findings.rounds] == [[], [], []]
    (note,) = sentences.describe_notes(_round(either, version="V2"), False)
    assert note == "The simulator gets load cell lag, since all of them correct alike; which of them it is stays open."
    (note,) = sentences.describe_notes(_round(either, refused="it does not help."), False)
    assert note == "it does not help."


def test_what_an_earlier_search_added_is_said() -> None:
    """A search starts from the simulator in use: that it finds nothing more does not mean that nothing was missing."""
    nothing = _told(_round(NOTHING))
    again = nothing.model_copy(update={"in_use": ("force_limited_closing",)})
    assert describe_outcome(again) == "no further gap; the simulator in use already has force_limited_closing"
    lead = "The simulator in use has force limited closing already, from an earlier search."
    assert sentences.describe_findings(again).startswith(f"{lead} Simulation and measurement agree")
    assert "show nothing else missing" in sentences.describe_findings(again)
    assert sentences.shorten_findings(again) == "no further gap"
    assert sentences.describe_sureness(again).startswith("nothing more is missing")
    assert sentences.describe_in_use(nothing) == ""
    assert sentences.describe_findings(nothing).startswith("Simulation and measurement agree")
    found = _told(_round(Decision(kind="effect", effects=("load_cell_lag",), probability=0.9)))
    found = found.model_copy(update={"in_use": ("force_limited_closing",)})
    assert sentences.describe_findings(found).startswith(f"{lead} Missing: ")


def test_what_a_name_leaves_over_is_no_second_discovery() -> None:
    lag = Decision(kind="effect", effects=("load_cell_lag",), probability=0.95)
    unknown = Decision(kind="unknown", probability=0.7)
    first = _round(lag, _candidate("load_cell_lag", 0.9))  # 12 nats
    weak = Candidate(effect="unknown", probability=0.5, nats=1.1)
    strong = weak.model_copy(update={"nats": 1.3})
    little, much = _told(first, _round(unknown, weak)), _told(first, _round(unknown, strong))
    assert "then" not in sentences.describe_findings(little)
    assert "something else" not in sentences.describe_sureness(little)
    assert "no new discovery" in " ".join(sentences.describe_notes(little.rounds[1], little.is_leftover(1)))
    assert "then something that is not in the catalogue" in sentences.describe_findings(much)
    assert sentences.describe_sureness(much).endswith("; something else is missing that the catalogue does not have")
    said = _round(lag.model_copy(update={"left_share": 0.3}), _candidate("load_cell_lag", 0.9))
    assert not _told(said, _round(unknown, weak)).is_leftover(1)  # the round itself says how much is left
    other = Decision(kind="effect", effects=("friction_wear",), probability=0.8, family="wear")
    large = _candidate("friction_wear", 0.9)
    helps, helps_not = (_told(first, _round(other, large, refused=why)) for why in ("", "it does not help."))
    assert "then" in sentences.describe_findings(helps)
    assert "then" not in sentences.describe_findings(helps_not)
    assert not helps.is_leftover(1)
    assert helps_not.is_leftover(1)


@pytest.mark.parametrize(
    ("kind", "effects", "possible", "note"),
    [
        ("effect", ("load_cell_lag",), ("load_cell_lag",), "A cause that is not in the catalogue is excluded at 90 %."),
        (
            "effect",
            ("tool_weight",),
            ("tool_weight", "unknown"),
            "A cause that is not in the catalogue is still possible.",
        ),
        ("unknown", (), ("unknown",), "All of the catalogue is excluded at 90 %."),
        (
            "unknown",
            (),
            ("load_cell_lag", "lift_misalignment", "unknown"),
            "Still possible: delay between lift and force.",
        ),
    ],
)
def test_what_an_alarm_does_not_exclude_is_said(
    kind: Literal["effect", "unknown"], effects: tuple[str, ...], possible: tuple[str, ...], note: str
) -> None:
    named = Decision(kind=kind, effects=effects, possible=possible, probability=0.8)
    assert sentences.describe_notes(_round(named), False) == [note]


def test_what_repeats_tell_most_is_said(tmp_path: Path) -> None:
    drift = "repeats of the same grasps differ over the batch, as if friction changed"
    law = LawCurve(
        quantity="friction over that at first",
        state="grasps of the batch before",
        at=(0.0, 50.0),
        median=(1.0, 0.97),
        low=(1.0, 0.96),
        high=(1.0, 0.98),
    )
    named = Decision(kind="unknown", probability=0.8, drift=drift, law=law, sentence="Something is missing.")
    (note,) = sentences.describe_notes(_round(named), False)
    assert note.startswith(f"Most of the evidence: {drift}.")
    possible = named.model_copy(update={"possible": ("unknown",)})
    assert sentences.describe_notes(_round(possible), False)[1] == "All of the catalogue is excluded at 90 %."
    page = write_gap_report(GapPage(_told(_round(named))), tmp_path, "X3").read_text(encoding="utf-8")
    assert "The law as the data have it, with its 90" in page


def test_none_does_not_deny_what_a_test_sees() -> None:
    seen = WhereFinding(
        sentence="Less on the cube.", phase="peak", stratum="cube", effect_size_n=-0.6, ci90=(-0.7, -0.5)
    )
    found = _round(NOTHING, patternless_n=0.2)
    (note,) = sentences.describe_notes(found, False)
    assert "show no pattern" in note
    (note,) = sentences.describe_notes(found.model_copy(update={"where": (seen,)}), False)
    assert "show no pattern" not in note
    assert "Yet a test of tools and objects sees this: Less on the cube." in note


def test_a_rest_without_a_sign_is_told_by_where_it_is() -> None:
    """Tools and objects agree on no sign where one object is stronger and another weaker: a test says which."""
    rest = Rest(sentence="No sign.", lift_mm=(0.0,), force_n=(0.0,), low_n=(-1.0,), high_n=(1.0,), has_sign=False)
    seen = WhereFinding(
        sentence="Less on the cube.", phase="peak", stratum="cube", effect_size_n=-0.6, ci90=(-0.7, -0.5)
    )
    found = _round(Decision(kind="unknown", probability=0.7, rest=rest))
    assert found.rest_sentence == "No sign."
    assert found.model_copy(update={"where": (seen,)}).rest_sentence == "Less on the cube."
    assert "Less on the cube." in sentences.describe_findings(_told(found.model_copy(update={"where": (seen,)})))
    signed = found.named.model_copy(update={"rest": rest.model_copy(update={"has_sign": True})})
    assert _round(signed).model_copy(update={"where": (seen,)}).rest_sentence == "No sign."


def test_the_same_family_again_is_no_second_discovery() -> None:
    """A delay whose law is between two of the catalogue is named twice and told once, by its family."""
    delay = "delay between lift and force"
    first = Decision(kind="set", effects=("load_cell_lag", "lift_misalignment"), family=delay, probability=0.8)
    again = Decision(kind="effect", effects=("lift_misalignment",), family=delay, probability=0.9)
    findings = _told(_round(first), _round(again, _candidate("lift_misalignment", 0.9)))
    assert not findings.is_leftover(0)
    assert findings.is_leftover(1)
    assert sentences.shorten_findings(findings) == delay
    assert "then" not in sentences.describe_findings(findings)
    twice = _told(
        _round(first), _round(first.model_copy(update={"effects": ("lift_misalignment", "lift_start_error")}))
    )
    assert describe_outcome(twice).count("not told apart") == 1


def test_a_set_says_which_law_is_whose(tmp_path: Path, content: GapPage) -> None:
    """Every member has its title before its formula; parameters and curve are those of the first."""
    law = LawCurve(
        quantity="delay, s", state="lift, mm", at=(0.0, 1.0), median=(0.1,) * 2, low=(0.0,) * 2, high=(1.0,) * 2
    )
    members = ("load_cell_lag", "lift_misalignment")
    either = NAMED.model_copy(update={"kind": "set", "effects": members, "law": law})
    findings = content.findings.model_copy(update={"rounds": (_round(either),)})
    page = words_of(write_gap_report(replace(content, findings=findings), tmp_path, "X1"))
    for member in members:
        assert f"{CATALOGUE[member].title}: <code>" in page
    assert "parameter of load cell lag" in page
    assert "If it is load cell lag: the law as the data have it" in page


def test_law_rest_and_reserve_are_on_the_page(tmp_path: Path) -> None:
    at = tuple(np.linspace(0.0, 20.0, 9))
    law = LawCurve(
        quantity="friction over friction at rest", state="slip (mm)", at=at,
        median=tuple(1.0 - 0.01 * x for x in at), low=tuple(0.95 - 0.01 * x for x in at), high=(1.05,) * 9,
    )  # fmt: skip
    rest = Rest(sentence="A pull stays.", lift_mm=at, force_n=(0.5,) * 9, low_n=(0.4,) * 9, high_n=(0.6,) * 9)
    slips = Decision(
        kind="effect", effects=("static_kinetic_friction",), family="friction laws", probability=0.93, law=law,
        left_share=0.12,
    )  # fmt: skip
    unknown = Decision(kind="unknown", probability=0.71, rest=rest, sentence="No effect explains it.")
    best = _candidate("static_kinetic_friction", 0.96).model_copy(update={"nats": 420.0})
    findings = _told(
        _round(slips, best, refused="It made held-out grasps worse."), _round(unknown, best, patternless_n=0.104)
    )
    named = _round(slips, patternless_n=0.104)
    assert "0.1 N are left" in sentences.describe_notes(named, False)[-1]
    page = words_of(write_gap_report(GapPage(findings), tmp_path, "X3"))
    for words in (
        "Family: friction laws.",
        "Probability that this answer is right: 0.93.",
        "Probability that this answer is right: 0.71.",
        "would still explain 12 % of what this answer explains",
        "It made held-out grasps worse.",
        "A pull stays.",
    ):
        assert words in page, words
    assert "show no pattern" not in page  # of an answer that says which pattern there is
    assert page.index("gap_law_1.svg") < page.index('id="where"')
    assert "friction over friction at rest" in (tmp_path / "figures" / "gap_law_1.svg").read_text()
    assert "measured less simulated force" in (tmp_path / "figures" / "gap_rest_2.svg").read_text()
    bars = (tmp_path / "figures" / "gap_names_2.svg").read_text()
    assert "0.96" not in bars  # a share among candidates is not the probability of the answer
    assert ">420<" in bars


def test_too_few_held_out_and_a_small_gap_are_said(tmp_path: Path) -> None:
    named = _round(NAMED, _candidate("load_cell_lag", 0.9), version="V1")
    gap = Gap(rmse_before_n=0.12, rmse_after_n=0.11, rmse_floor_n=0.13, closed_fraction=0.0, ci95=None)
    findings = _told(named).model_copy(update={"gap": gap})
    page = words_of(write_gap_report(GapPage(findings), tmp_path, "X4"))
    assert "too few designs or objects held out for an interval, which takes 3 of either" in page
    assert "95 %: " not in page
    assert "not larger than what repeats scatter or another mesh or contact changes, 0.13 N" in page
