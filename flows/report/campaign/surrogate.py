"""The section on the surrogate: its health as it chose each batch, and which parameters it finds to matter."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from fast.flows.report.campaign import queries
from fast.flows.report.campaign.content import Content
from fast.flows.report.folder import Folder
from fast.flows.report.html import Column, Markup, columns, paragraph, record_table, section
from fast.flows.report.style import BEST, SIMULATED, WIDTH_IN, new_axes
from fast.models.units import spell_name

_COLUMNS: dict[str, Column] = {
    "batch": lambda row: f"B{row['batch']:02d}",
    "measured": ("n_real", 0),
    "simulated": ("n_sim", 0),
    "rho": ("rho", 2),
    "shared": ("shared_variance", 2),
    "error (N)": ("loo_rmse_n", 2),
    "alone (N)": ("measured_only_loo_rmse_n", 2),
    "predicted": ("loo_q2", 2),
    "in 90 %": ("loo_coverage_90", 2),
    "noise SD (N)": ("noise_sd_n", 2),
}


_PRIOR_COLUMNS: dict[str, Column] = {"prior": ("n_prior", 0), "no prior (N)": ("without_prior_loo_rmse_n", 2)}


def write_surrogate(content: Content, folder: Folder) -> Markup:
    """Leave-one-out errors and coverage of every fit that chose tools; lengthscales and findings of the last."""
    fits = content.result("fits", queries.FITS)
    if not fits.rows:
        return section("surrogate", "The surrogate", paragraph("The surrogate has not been fitted yet."))
    last = fits.rows[-1]
    has_prior = any(row["without_prior_loo_rmse_n"] is not None for row in fits.rows)
    figure = folder.figure("relevance", draw_relevance(last, content.space.names), "Relevance of each design parameter")
    return section(
        "surrogate",
        "The surrogate",
        paragraph(
            "The surrogate is the model that chooses the next tools. It predicts the quality of a design: rho times "
            "what the simulation says, plus the discrepancy, which only measurements show (Eq. 1 of the paper)."
        ),
        record_table(fits.rows, _COLUMNS | (_PRIOR_COLUMNS if has_prior else {})),
        *([paragraph(_prior_words(last, content.prior_campaigns), "note")] if has_prior else []),
        paragraph(
            "Each row is the fit that chose the tools of a batch. Measured, simulated: the designs that it knew. Rho: "
            "how many newtons on the bench go with one in the simulation. Shared: part of the variance that measured "
            "designs have in common with their simulation. Error: each measured design predicted from all others, root "
            "mean square; alone: the same without simulations. Predicted: part of the variance between measured "
            "designs. In 90 %: part of them inside their 90 % interval. Noise: between measurements of one design"
            + (
                ", at the mean force. Logarithms of forces are modelled: rho is by how many per cent the force on the "
                "bench rises with one per cent in the simulation. Without simulated designs: they were left aside, as "
                "measured designs are predicted better so."
                if last["is_log"]
                else "."
            ),
            "note",
        ),
        columns(
            figure,
            paragraph(
                "How fast the quality changes along each design parameter, in the last fit: a long bar is a parameter "
                "that matters, a short one hardly does. The length scale is the change of a parameter, as part of its "
                "range, over which the quality becomes another. The model has one for what simulation and bench share "
                "and one for the discrepancy (the kernels k_h and k_eps of the paper).",
                "note",
            ),
        ),
        folder.sources(fits),
    )


def draw_relevance(fit: Mapping[str, Any], names: Sequence[str]) -> Figure:
    """Inverse lengthscale of each design parameter, for simulator and discrepancy; long bars bend the outcome most."""
    figure, axes = new_axes(WIDTH_IN, 3.4, grid="x")
    for offset, column, colour, label in (
        (-0.19, "lengthscales_h", SIMULATED, "simulation, which measurements share"),
        (0.19, "lengthscales_e", BEST, "discrepancy, which only measurements show"),
    ):
        places = [place + offset for place in range(len(names))]
        axes.barh(places, [1.0 / length for length in fit[column]], height=0.36, color=colour, label=label)
    axes.set_yticks(range(len(names)), [spell_name(name) for name in names])
    axes.invert_yaxis()
    axes.set_xlabel("1 / length scale, per range of the parameter")
    figure.legend(loc="outside upper left")
    return figure


def _prior_words(fit: Mapping[str, Any], names: Sequence[str]) -> str:
    links = json.loads(fit["priors_json"] or "[]")
    told = ", ".join(f"{name} {link['correlation']:.2f}" for name, link in zip(names, links, strict=False))
    now = "in the last fit they were left aside, as measured designs are predicted better so"
    if told:
        now = f"correlation with the own measurements in the last fit: {told}"
    return (
        "Prior: tools of prior campaigns that the fit knew, each campaign with a scale and a mean of its own. No "
        f"prior: the error without them. {now[0].upper()}{now[1:]}."
    )
