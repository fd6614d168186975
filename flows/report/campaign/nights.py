"""How the campaign's simulator changed: what each night added, and what that did to error and ranking."""

from fast.flows.report.campaign.content import Content
from fast.flows.report.folder import Folder
from fast.flows.report.html import Markup, paragraph, section, table, text
from fast.tasks.campaign.night_story import Night, read_nights, read_verdicts
from fast.tasks.templates import count, number

TITLE = "How the simulator changed"
_HEADINGS = (
    "before batch",
    "what changed",
    "held-out error (N)",
    "rank correlation",
    "tools compared",
    "designs simulated",
    "worker hours",
)
_ARROW = "\u2192"


def write_nights(content: Content, folder: Folder) -> Markup:
    """A row for each night with a new simulator; empty where there was none and no search has judged one."""
    lake, campaign_id = content.lake, content.campaign.campaign_id
    nights = read_nights(lake, campaign_id)
    refused = [verdict for verdict in read_verdicts(lake, campaign_id) if not verdict.is_accepted]
    if not nights and not refused:
        return Markup("")
    words = paragraph(
        f"A new simulator was taken for the next batch {count(len(nights), 'time')}. Held-out error: root mean square "
        "difference between simulated and measured traces of grasps that nothing was inferred from. Rank correlation: "
        "of the forces that the simulator gives for the measured tools with the measured ones; 1 is the same order. "
        "Both before and after the change; a dash is not known."
    )
    rows = table(_HEADINGS, [_row(night) for night in nights], numeric=(2, 3, 4, 5, 6))
    parts = [words, Markup(f'<div class="words">{rows}</div>')]
    if nights:
        parts.append(folder.numbers("nights", [night.model_dump(mode="json") for night in nights]))
    if refused:
        parts.append(paragraph("Searches whose simulator was not taken over, in order:", "note"))
        parts.append(Markup(f"<ul>{''.join(f'<li>{text(verdict.sentence)}.</li>' for verdict in refused)}</ul>"))
    return section("nights", TITLE, *parts)


def _row(night: Night) -> tuple[object, ...]:
    return (
        f"B{night.batch:02d}",
        night.change,
        f"{number(night.error_before_n, 2)} {_ARROW} {number(night.error_after_n, 2)}",
        f"{number(night.rank_before, 2)} {_ARROW} {number(night.rank_after, 2)}",
        night.n_tools,
        f"{night.n_done} of {night.n_planned}",
        number(night.worker_hours, 2),
    )
