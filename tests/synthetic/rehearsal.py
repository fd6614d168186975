"""A rehearsal as one of a panel of eight designs and six objects came out, for tests that make none of their own."""

from fast.models.gap.evidence.odds import Odds
from fast.models.gap.evidence.rehearsal import Rehearsal, Rehearsed
from fast.models.gap.evidence.trials import LEAST, Signs

USUAL = Rehearsal(
    worlds=(
        *[Rehearsed("nothing", Signs(5.0, 1.0))] * 60,
        *[Rehearsed("listed", Signs(20.0, 1.0), size=0.02)] * 15,
        *[Rehearsed("listed", Signs(300.0, 1.0), size=0.1)] * 45,
    ),
    thresholds=LEAST,
    name=Odds((-1.1, 1.2, -1.1, 0.0, -2.4, 0.1, -0.7)),  # without the next family, which small catalogues lack
    behind=0.1,
    possible_name=0.6,
    possible_unknown=0.6,
)
