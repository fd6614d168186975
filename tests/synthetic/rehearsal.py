"""A rehearsal as one of a panel of eight designs and six objects came out, for tests that make none of their own."""

from fast.models.gap.evidence.odds import Odds
from fast.models.gap.evidence.rehearsal import LEAST_NATS, LEAST_OMNIBUS, Rehearsal

USUAL = Rehearsal(
    worlds=(),
    nats_line=LEAST_NATS,
    omnibus_line=LEAST_OMNIBUS,
    gap=Odds((2.0, 3.0)),
    name=Odds((-4.14, 2.27, -1.5, -0.46, 1.5)),
    behind=0.1,
    possible_name=0.6,
    possible_unknown=0.6,
)
