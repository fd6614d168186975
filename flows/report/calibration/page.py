"""The page of one calibration, and the newest calibration as a section of its campaign's report."""

from functools import partial
from pathlib import Path

from fast.flows.report.calibration.data import Evidence, StoredCalibration, write_archive
from fast.flows.report.calibration.posterior_figures import Markers, pairs_figure
from fast.flows.report.calibration.sections import (
    agreement_columns,
    agreement_section,
    chains_section,
    drift_section,
    headline,
    provenance_section,
    scores_table,
    supplement_section,
    theta_section,
    theta_table,
    warnings_of,
)
from fast.flows.report.campaign.content import Content
from fast.flows.report.folder import Folder, write_page
from fast.flows.report.html import Markup, Page, columns, moment, paragraph, section
from fast.lake.store import Lake
from fast.models.calibration.means.predict import N_DRAWS
from fast.models.errors import UsageError

_N_SECTION_DRAWS = 60  # a campaign's report is written often; its page has all

NAV = {
    "theta": "Theta",
    "agreement": "Before and after",
    "supplement": "Sensitivities",
    "chains": "Chains",
    "drift": "Over time",
    "provenance": "Provenance",
}

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
    markers: Markers | None = None,
    n_predicted: int = N_DRAWS,
) -> Path:
    """Write the page of a calibration into the folder `out`, with figures, numbers and `data/posterior.nc`.

    `evidence` is what it learned from; by default it is read from the lake. `markers` are named points for the pair
    plot, of some or all of theta. `n_predicted` draws are used for predictions. Returns the path of `out/index.html`.

    Raises:
        UsageError: there is no such calibration, or the folder cannot be written.
    """
    calibration = StoredCalibration.load(lake, calibration_id, evidence, n_predicted)
    folder = Folder(Path(out))
    data = calibration.evidence.fitted if calibration.evidence else None
    write_archive(folder.root / "data" / "posterior.nc", calibration.result, calibration_id, data)
    row = calibration.row
    page = Page(
        title=f"Calibration {calibration_id}",
        kicker=f"FAST campaign {row.campaign_id}" if row.campaign_id else "FAST, all measurements of the lake",
        footer=f"Calibration {calibration_id}, made {moment(calibration.made_at)} UTC. Units: mm, N, MPa.",
        nav=NAV,
    )
    sections = (
        partial(theta_section, markers=markers),
        agreement_section,
        supplement_section,
        chains_section,
        drift_section,
        provenance_section,
    )
    return write_page(folder, calibration, page, headline, sections)


def calibration_section(content: Content, folder: Folder) -> Markup:
    """The newest calibration with this campaign's measurements: Table 2, Figs. 3 and 4, sensitivities."""
    newest = content.result("calibrations", NEWEST)
    if not newest.rows:
        said = (
            "The simulator has three constants: Young's modulus, friction and Poisson's ratio, together called theta. "
            "Which values fit these measurements best has not been asked yet; <code>fast calibrate</code> does it, and "
            "this part then shows them with their uncertainty (Figs. 3b and 4 and Table 2 of the paper)."
        )
        return section("calibration", "Calibration", paragraph(Markup(said)))
    calibration_id = newest.rows[0]["calibration_id"]
    try:
        calibration = StoredCalibration.load(content.lake, calibration_id, n_predicted=_N_SECTION_DRAWS)
    except UsageError as error:  # the rest of the campaign's report is worth having without it
        return section("calibration", "Calibration", paragraph(str(error)))
    pairs = folder.figure("calibration_pairs", pairs_figure(calibration.result), "Joint posterior of theta")
    panels = calibration.held_out_panels or calibration.panels
    agreement = agreement_columns(panels, folder) + scores_table(panels) if panels else ""
    words = paragraph(
        "Theta stands for the three constants of the simulator: Young's modulus, friction and Poisson's ratio. Above: "
        "what is known of them now (Table 2 of the paper). Left: which values go together (Fig. 4). Below: simulated "
        "against measured, before and after the calibration (Fig. 3). "
        f"Calibration {calibration_id} of {moment(calibration.made_at)} UTC, {calibration.row.n_designs} measured "
        f"designs and {calibration.simulations}. All of it: fast report {calibration_id}.", "note",
    )  # fmt: skip
    shown = section(
        "calibration",
        "Calibration",
        warnings_of(calibration),
        theta_table(calibration),
        columns(pairs, words),
        agreement,
        folder.sources(newest, calibration.queries["calibration"]),
    )
    return Markup(shown + supplement_section(calibration, folder))
