"""The page of a gap search: where the simulator is wrong, what is missing, and how much of the gap that closes.

It is written from the answer (`Findings`) and, as far as it is there, from what the answer rests on. With it goes
`findings.json`, the same for machines.
"""

import logging
from pathlib import Path

from flows.report.folder import Folder
from flows.report.gap.evidence import GapEvidence
from flows.report.gap.sections import assumed_section, headline, name_section, next_section, show_section, where_section
from flows.report.gap.theta import theta_section
from flows.report.html import page, text
from flows.report.style import figure_style
from models.gap.findings import Findings

_LOG = logging.getLogger(__name__)
PAGE, FINDINGS = "report.html", "findings.json"

NAV = {
    "where": "Where",
    "name": "What is missing",
    "show": "Before and after",
    "theta": "Theta",
    "next": "What to measure next",
    "assumed": "What was assumed",
}


def write_findings(findings: Findings, out: Path) -> Path:
    """Write `findings.json` (design.md section 10) into a folder; returns its path."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / FINDINGS
    path.write_text(findings.model_dump_json(indent=2) + "\n", encoding="utf-8")
    return path


def write_gap_report(evidence: GapEvidence, out: Path, name: str, of: str = "") -> Path:
    """Write the page of a search, its figures and numbers, and `findings.json` into the folder `out`.

    name: of the search. of: what was searched, for the line above the title. Returns the path of the page.

    Raises:
        UsageError: the folder cannot be written.
    """
    folder = Folder(Path(out))
    with figure_style():
        parts = (where_section, name_section, show_section, theta_section, next_section, assumed_section)
        body = "".join(build(evidence, folder) for build in parts)
        top = headline(evidence)
    write_findings(evidence.findings, folder.root)
    footer = text(f"Gap search {name}. Units: mm, N, MPa. For machines: {FINDINGS}.")
    path = folder.root / PAGE
    document = page("What the simulator misses", of or f"FAST gap search {name}", top, NAV, body, footer)
    path.write_text(document, encoding="utf-8")
    _LOG.info("page of gap search %s written to %s", name, path)
    return path
