"""What the bench and the simulator got done in the time, beside the paper's numbers."""

from flows.report import queries
from flows.report.content import Content
from flows.report.page import Markup, number, paragraph, table
from flows.report.queries import Result

PAPER = {"grasp_s": "15", "grasps_per_hour": "240, the most", "measured": "8,532", "simulated": "50,608"}  # Results


def throughput(content: Content) -> tuple[Markup, Result]:
    """Counts, seconds per grasp, grasps per hour, and what was simulated while the bench worked."""
    result = content.result("throughput", queries.THROUGHPUT)
    row = result.rows[0]
    pause = row["median_interval_s"]
    rows = [
        ("grasps measured, failed ones too", number(row["n_grasps"], 0), PAPER["measured"]),
        ("grasps simulated", number(row["n_simulated"], 0), PAPER["simulated"]),
        ("of these, while the bench measured", number(row["n_simulated_meanwhile"], 0), "–"),
        ("closing and lift of a grasp (s), by its trace", number(row["median_trace_s"], 1), "–"),
        ("start of a grasp to start of the next (s), within a tool", number(pause, 1), PAPER["grasp_s"]),
        ("grasps per hour at that pace", number(3600 / pause if pause else None, 0), PAPER["grasps_per_hour"]),
    ]
    note = ""
    if row["is_virtual"]:
        note = paragraph(
            "The times between grasps are those of the computer, because a virtual bench in lockstep does not wait; "
            "<code>fast gantry plan</code> says what the same batch takes on a bench."
            if pause and row["median_trace_s"] and pause < row["median_trace_s"]
            else "Measured on the virtual bench.", "note",
        )  # fmt: skip
    return Markup(table(("throughput", "this campaign", "paper"), rows, numeric=(1, 2)) + str(note)), result
