"""The section on the surrogate: its health as it chose each batch, and which parameters it finds to matter."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from fast.flows.report.campaign import queries
from fast.flows.report.campaign.content import Content
from fast.flows.report.folder import Folder
from fast.flows.report.style import BEST, SIMULATED, WIDTH_IN, new_axes
from fast.models.units import spell_name


def prepare_surrogate(content: Content, folder: Folder) -> dict[str, Any]:
    """Prepare leave-one-out errors and coverage of every fit that chose tools; the last's lengthscales and findings."""
    source = content.result("fits", queries.FITS)
    fits = [{**row, "label": f"B{row['batch']:02d}"} for row in source.rows]
    if not fits:
        return {}
    folder.save(source)
    has_prior = any(row["without_prior_loo_rmse_n"] is not None for row in fits)
    return {
        "source": source,
        "fits": fits,
        "prior_words": _prior_words(fits[-1], content.prior_campaigns) if has_prior else "",
        "drawn": folder.draw("relevance", draw_relevance(fits[-1], content.space.names)),
    }


def draw_relevance(fit: Mapping[str, Any], names: Sequence[str]) -> Figure:
    """Draw design parameters' inverse lengthscales, for simulator and discrepancy; long bars bend the outcome most."""
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
