"""The section on the surrogate: its health as it chose each batch, and which parameters it finds to matter."""

from collections.abc import Mapping
from typing import Any

from matplotlib.figure import Figure

from flows.report.campaign import queries
from flows.report.campaign.content import Content
from flows.report.campaign.queries import Result
from flows.report.folder import Folder
from flows.report.html import Markup, columns, number, paragraph, section, table
from flows.report.style import BEST, SIMULATED, WIDTH_IN, new_axes
from models.design.space import PARAMETERS
from models.scientist.surrogate.health import SurrogateHealth

_HEADINGS = ("batch", "measured", "simulated", "rho", "shared", "error (N)", "alone (N)", "predicted", "in 90 %",
             "noise SD (N)")  # fmt: skip


def surrogate_section(content: Content, folder: Folder) -> Markup:
    """Leave-one-out errors and coverage of every fit that chose tools; lengthscales and findings of the last."""
    fits = content.result("fits", queries.FITS)
    if not fits.rows:
        return section("surrogate", "The surrogate", paragraph("The surrogate has not been fitted yet."))
    last = fits.rows[-1]
    figure = folder.figure("relevance", relevance_figure(last), "Relevance of each design parameter")
    return section(
        "surrogate",
        "The surrogate",
        *(paragraph(finding, "note") for finding in _findings(last)),
        _table(fits),
        columns(
            figure,
            paragraph(
                "Each row is the fit that chose the tools of a batch. Shared: part of the variance that measured "
                "designs have in common with their simulation. Error: each measured design predicted from all others, "
                "root mean square; alone: the same without simulations. Predicted: part of the variance between "
                "measured designs. In 90 %: part of them inside their 90 % interval. Bars: how fast the outcome "
                "changes along each design parameter, in the last fit.",
                "note",
            ),
        ),
        folder.sources(fits),
    )


def relevance_figure(fit: Mapping[str, Any]) -> Figure:
    """Inverse lengthscale of each design parameter, for simulator and discrepancy; long bars bend the outcome most."""
    figure, axes = new_axes(WIDTH_IN, 3.4, grid="x")
    for offset, column, colour, label in (
        (-0.19, "lengthscales_h", SIMULATED, "what simulation and measurement share (k_h)"),
        (0.19, "lengthscales_e", BEST, "what only measurements show (k_eps)"),
    ):
        places = [place + offset for place in range(len(PARAMETERS))]
        axes.barh(places, [1.0 / length for length in fit[column]], height=0.36, color=colour, label=label)
    axes.set_yticks(range(len(PARAMETERS)), [_label(name) for name in PARAMETERS])
    axes.invert_yaxis()
    axes.set_xlabel("1 / lengthscale, per range of the parameter")
    figure.legend(loc="outside upper left")
    return figure


def _label(parameter: str) -> str:
    return parameter.removesuffix("_mm").removesuffix("_deg").replace("_", " ")


def _findings(fit: Mapping[str, Any]) -> tuple[str, ...]:
    if fit["shared_variance"] is None:  # recorded before the health card existed
        return ()
    return SurrogateHealth(**{name: fit[name] for name in SurrogateHealth.model_fields}).findings


def _table(fits: Result) -> Markup:
    rows = [
        (
            f"B{row['batch']:02d}",
            row["n_real"],
            row["n_sim"],
            number(row["rho"], 2),
            number(row["shared_variance"], 2),
            number(row["loo_rmse_n"], 2),
            number(row["measured_only_loo_rmse_n"], 2),
            number(row["loo_q2"], 2),
            number(row["loo_coverage_90"], 2),
            number(row["noise_sd_n"], 2),
        )
        for row in fits.rows
    ]
    return table(_HEADINGS, rows, numeric=tuple(range(1, len(_HEADINGS))))
