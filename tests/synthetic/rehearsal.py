"""A rehearsal as one of a panel of eight designs and six objects came out, for tests that make none of their own."""

from fast.models.gap.evidence.odds import Odds
from fast.models.gap.evidence.rehearsal import Rehearsal
from fast.models.gap.evidence.trials import LEAST_NATS, LEAST_OMNIBUS

USUAL = Rehearsal(
    worlds=(),
    nats_line=LEAST_NATS,
    omnibus_line=LEAST_OMNIBUS,
    gap=Odds((2.4, 2.6)),
    name=Odds((-4.9, 1.6, -0.6, -1.0, 0.0, -1.9)),  # without the next family, which small catalogues lack
    behind=0.1,
    possible_name=0.6,
    possible_unknown=0.6,
)
