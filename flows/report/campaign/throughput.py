"""What the bench and the simulator got done in the time, beside the paper's numbers."""

from flows.report.campaign import queries
from flows.report.campaign.content import Content
from flows.report.campaign.queries import Result
from flows.report.html import DASH, Markup, number, paragraph, table

PAPER = {"grasp_s": "15", "grasps_per_hour": "240, the most", "measured": "8,532", "simulated": "50,608"}  # Results

_LOCKSTEP = Markup(
    "This virtual bench worked in lockstep: it does not wait, and the clock times below are the computer's. "
    "<code>fast gantry plan</code> says what the same batch takes on a bench."
)


def throughput(content: Content) -> tuple[Markup, Result]:
    """Counts, seconds per grasp, grasps per hour, and what was simulated while the bench worked."""
    result = content.result("throughput", queries.THROUGHPUT)
    row = result.rows[0]
    pause, trace_s = row["median_interval_s"], row["median_trace_s"]
    is_lockstep = bool(row["is_virtual"] and pause and trace_s and pause < trace_s)
    if is_lockstep:
        pause = None
    rows = [
        ("grasps measured, failed ones too", number(row["n_grasps"], 0), PAPER["measured"]),
        ("grasps simulated", number(row["n_simulated"], 0), PAPER["simulated"]),
        ("of these, while the bench measured", number(row["n_simulated_meanwhile"], 0), DASH),
        ("closing and lift of a grasp (s), by its trace", number(trace_s, 1), DASH),
        ("start of a grasp to start of the next (s), within a tool", number(pause, 1), PAPER["grasp_s"]),
        ("grasps per hour at that pace", number(3600 / pause if pause else None, 0), PAPER["grasps_per_hour"]),
    ]
    shown = table(("throughput", "this campaign", "paper"), rows, numeric=(1, 2))
    shown = Markup(f'<div class="words">{shown}</div>')
    return Markup(shown + (paragraph(_LOCKSTEP, "note") if is_lockstep else "")), result
