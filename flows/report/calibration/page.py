"""The page of one calibration, and what its campaign's report shows of the newest one."""

import json
from pathlib import Path
from typing import Any

from fast.flows.report.calibration.data import Evidence, StoredCalibration, write_archive
from fast.flows.report.calibration.posterior_figures import pairs_figure, theta_history_figure
from fast.flows.report.calibration.sections import (
    draw_agreement,
    draw_chains,
    draw_plots,
    draw_supplement,
    list_parameters,
    list_scores,
)
from fast.flows.report.campaign.content import Content
from fast.flows.report.folder import Folder, write_page
from fast.lake.store import Lake
from fast.models.calibration.inference.result import ESS_LIMIT, K_HAT_LIMIT, R_HAT_LIMIT
from fast.models.calibration.inference.settings import ThetaPriors
from fast.models.calibration.inference.summary import correlate_ranks
from fast.models.calibration.means.predict import N_DRAWS
from fast.models.calibration.means.problem import THETA
from fast.models.errors import UsageError

_N_SECTION_DRAWS = 60  # a campaign's report is written often; its page has all

NEWEST = """
SELECT calibration_id, campaign_id, status, created_at FROM calibrations
WHERE campaign_id = {campaign} OR campaign_id IS NULL
ORDER BY sequence DESC, created_at DESC, calibration_id LIMIT 1"""


def write_calibration_report(
    lake: Lake,
    calibration_id: str,
    out: Path,
    *,
    evidence: Evidence | None = None,
    n_predicted: int = N_DRAWS,
) -> Path:
    """Write the page of a calibration into the folder `out`, with figures, numbers and `data/posterior.nc`.

    `evidence` is what it learned from; by default it is read from the lake. `n_predicted` draws are used
    for predictions. Returns the path of `out/index.html`.

    Raises:
        UsageError: there is no such calibration, or the folder cannot be written.
    """
    calibration = StoredCalibration.load(lake, calibration_id, evidence, n_predicted)
    folder = Folder(Path(out))
    data = calibration.evidence.fitted if calibration.evidence else None
    write_archive(folder.root / "data" / "posterior.nc", calibration.result, calibration_id, data)
    template = "flows/report/calibration/page.html.j2"
    return write_page(folder, template, lambda folder: _prepare_page(calibration, folder))


def _prepare_page(calibration: StoredCalibration, folder: Folder) -> dict[str, Any]:
    result, past = calibration.result, calibration.past
    names, correlations = correlate_ranks(result)
    folder.numbers("parameters", [{"parameter": n, **s.model_dump()} for n, s in calibration.summary.items()])
    folder.save(*calibration.queries.values())
    return {
        "calibration": calibration,
        "parameters": list_parameters(calibration),
        "trust": {"r_hat": max(result.r_hat[n] for n in THETA), "ess": min(result.ess_bulk[n] for n in THETA)},
        "limits": {"r_hat": f"{R_HAT_LIMIT:g}", "ess": f"{ESS_LIMIT:.0f}", "k_hat": f"{K_HAT_LIMIT:g}"},
        "pairs": folder.draw("calibration_pairs", pairs_figure(result), for_print=True),
        "ridge": correlations[names.index("young_modulus_mpa"), names.index("friction")],
        "is_printed_prior": result.settings.priors == ThetaPriors(),
        "agreement": draw_agreement(calibration, folder),
        "drawn_supplement": draw_supplement(calibration, folder),
        "chains": draw_chains(calibration, folder),
        "drift": folder.draw("calibration_drift", theta_history_figure(past), for_print=True) if past[1:] else None,
        "settings": json.dumps(json.loads(calibration.row.settings_json), indent=2, sort_keys=True),
    }


def prepare_calibration(content: Content, folder: Folder) -> dict[str, Any]:
    """Prepare the newest calibration with this campaign's measurements: Table 2, Figs. 3 and 4, sensitivities."""
    newest = content.result("calibrations", NEWEST)
    if not newest.rows:
        return {"calibration": None, "refused": None}
    calibration_id = newest.rows[0]["calibration_id"]
    try:
        calibration = StoredCalibration.load(content.lake, calibration_id, n_predicted=_N_SECTION_DRAWS)
    except UsageError as error:  # the rest of the campaign's report is worth having without it
        return {"calibration": None, "refused": str(error)}
    folder.save(newest, calibration.queries["calibration"])
    panels = calibration.held_out_plots or calibration.plots
    return {
        "calibration": calibration,
        "refused": None,
        "newest": newest,
        "parameters": list_parameters(calibration),
        "pairs": folder.draw("calibration_pairs", pairs_figure(calibration.result)),
        "panels": draw_plots(panels, folder) if panels else {},
        "scores": list_scores(panels),
        "supplement": draw_supplement(calibration, folder),
    }
