"""Where each figure and table of the paper stands in a report, and what a campaign lacks for those that are missing."""

from flows.report.html import Markup, paragraph, section, table

_NO_MEASUREMENT = "needs a measured tool"
_NO_CALIBRATION = "needs a calibration: fast calibrate"
_NO_PAIRS = "needs a measured design that was simulated with the same grasp setup"
_NO_RIVAL = "needs a second approach: fast compare, then fast report CAMPAIGN --against LAKE"
_NO_FIT = "needs a fit of the surrogate or a calibration"

# Figure, what it shows, anchor in the page, marks of which one must be in the page, what is missing where none is.
_ROWS = (
    ("Fig. 2a", "Tools found, against other approaches", "rivals", ("figures/approaches.svg",), _NO_RIVAL),
    ("Fig. 2a", "Tool quality by batch", "progress", ("figures/quality_by_batch.svg",), _NO_MEASUREMENT),
    ("Fig. 2b", "Closure and pull-up of a grasp", "moments", ("figures/moments/",), _NO_MEASUREMENT),
    ("Fig. 2c", "Work to break the grasp, by object", "work", ("figures/work_by_object.svg",), _NO_MEASUREMENT),
    ("Table 1", "Parameters of the best finger", "best", ("figures/profile.svg",), _NO_MEASUREMENT),
    ("Fig. 3a", "Simulated against measured", "agreement", ("figures/agreement_designs.svg",), _NO_PAIRS),
    ("Fig. 3b", "The same after calibration", "calibration", ("figures/calibration_agreement",), _NO_CALIBRATION),
    ("Fig. 4", "Joint posterior of theta", "calibration", ("figures/calibration_pairs.svg",), _NO_CALIBRATION),
    ("Table 2", "Statistics of the posterior", "calibration", ("figures/calibration_pairs.svg",), _NO_CALIBRATION),
    ("Fig. 5a, b", "Traces of the first and the last batch", "batches", ("figures/batch_traces/",), _NO_MEASUREMENT),
    ("Fig. 5c-f", "Traces by shape", "shapes", ("figures/shapes/",), _NO_MEASUREMENT),
    ("Fig. 5g", "Grasps lost too early", "shapes", ("early_losses.sql",), _NO_MEASUREMENT),
    ("Suppl. 1, 2", "Noise and amplitude of the discrepancy", "supplement", ("calibration_noise.svg", "tool_sd.svg"),
     _NO_CALIBRATION),
    ("Suppl. 3, 4", "Sensitivities: lengthscales of k_eps and k_h", "supplement", ("calibration_sensitivity",), ""),
    ("Suppl. 3, 4", "The same, of the surrogate", "surrogate", ("figures/relevance.svg",), _NO_FIT),
    ("Resource usage", "Throughput", "cost", ("throughput.sql",), _NO_MEASUREMENT),
)  # fmt: skip


def paper_section(body: str) -> Markup:
    """A table of the paper's figures with links into the page made so far."""
    rows = []
    for figure, what, anchor, marks, missing in _ROWS:
        is_there = any(mark in body for mark in marks)
        where = Markup(f'<a href="#{anchor}">here</a>') if is_there else missing or _NO_CALIBRATION
        rows.append((figure, what, where))
    note = paragraph(
        "Fig. 1 shows the authors' platform. Fig. 2b: photographs there, drawn from the simulator here.", "note"
    )
    shown = table(("paper", "what it shows", "in this report"), rows)
    return section("paper", "The paper's figures and tables", f'<div class="words">{shown}</div>', note)
