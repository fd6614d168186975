"""How an open question of a search is answered: the command for a person's number, or for grasps made by hand."""

from fast.models.gap.findings import NextExperiment


def describe_command(asked: NextExperiment, campaign_id: str | None, address: str) -> str:
    """The command line that answers a question, or writes the plan of its grasps; empty if it has neither."""
    of = f" --campaign {campaign_id}" if campaign_id else ""
    if asked.person is not None:
        return f"fast gap answer {asked.person.kind} VALUE{of} --operator NAME --lake {address}"
    return f"fast gap next --lake {address} --out asked" if asked.grasps else ""
