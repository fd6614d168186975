"""Banks around fitted thetas in a study's own lake: worlds are answered with them, as a search on a bench is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fast.lake.store import Lake
from fast.models.gap.bank.bank import BankPlan
from fast.models.gap.data import GapData
from fast.models.gap.local_bank import name_locally
from fast.models.records import EffectValue
from fast.models.simulation.version import SimulatorVersion
from fast.tasks.gap.bank import plan_bank, read_bank
from fast.tasks.simulation.plan import simulate_plan

if TYPE_CHECKING:
    from fast.models.gap.evidence.rehearsal import Rehearsal
    from fast.models.gap.naming.name import NamingResult


@dataclass(frozen=True, eq=False)
class LocalBanks:
    """The lake of a study's panel, and on how many workers it simulates what a bank lacks."""

    lake: Lake
    n_workers: int = 1

    @staticmethod
    def of(folder: Path, n_workers: int) -> "LocalBanks":
        """Those of a study's folder."""
        return LocalBanks(Lake(str(folder / "lake")), n_workers)

    def name(
        self,
        wide: GapData,
        in_model: Sequence[EffectValue],
        rehearsal: "Rehearsal",
        catalogue: Sequence[str],
        former: BankPlan | None = None,
    ) -> tuple["NamingResult", GapData, BankPlan]:
        """What is missing by the bank around the theta that the wide one proposes, as `tasks.gap.rounds.settle_bank`.

        Here the catalogue may lack effects. Returns also the data with that bank, and the bank's plan.
        """
        from fast.models.gap.naming.name import name_effect

        def answer(plan: BankPlan) -> tuple[GapData, "NamingResult"]:
            data = self._with_bank(wide, plan)
            return data, name_effect(data, rehearsal, in_model, proposed.raised_alarm, catalogue)

        proposed = name_effect(wide, rehearsal, in_model, catalogue=catalogue)
        data, found, plan = name_locally(proposed, former, answer)
        return found, data, plan

    def _with_bank(self, wide: GapData, plan: BankPlan) -> GapData:
        around = (SimulatorVersion(), wide.grasps.cells, plan)
        for simulations in plan_bank(*around):
            simulate_plan(self.lake, simulations, self.n_workers, lambda _: None, lambda: False)
        return replace(wide, bank=read_bank(self.lake, *around, wide.bank))
