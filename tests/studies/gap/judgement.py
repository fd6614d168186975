"""What is right in an answer to a world of known truth."""

from dataclasses import dataclass

from fast.flows.challenge.hidden.worlds import WorldKey
from fast.models.simulation.effects.catalogue import CATALOGUE
from tests.studies.gap.answers import Answer

VISIBLE = 0.02  # from this visible strength on, an effect is expected to be found
LEAST_VISIBLE = 0.01  # below this one, it is not there for these data


@dataclass(frozen=True)
class Judged:
    """An answer with its key. left_out: the truth was not in the catalogue; twin_n: error of the world without it."""

    key: WorldKey
    said: Answer
    left_out: bool = False
    twin_n: float | None = None

    @property
    def families(self) -> set[str]:
        """Families of what is hidden; what no catalogue lists has none."""
        return {CATALOGUE[name].family for name in self.key.names if name in CATALOGUE}

    @property
    def is_visible(self) -> bool:
        """Whether something is hidden, and all of it should be found."""
        return bool(self.key.effects) and all(hidden.visible_strength >= VISIBLE for hidden in self.key.effects)

    def is_family_right(self, name: str) -> bool:
        """Whether an effect is of a family that is hidden."""
        return name in CATALOGUE and CATALOGUE[name].family in self.families

    @property
    def is_right(self) -> bool:
        """Whether the first answer is right: a hidden family; unknown if there is none; nothing if nothing is there.

        What changes the traces by less than `LEAST_VISIBLE` once theta is fitted is nothing to these data.
        """
        first = self.said.rounds[0]
        if first.kind in ("effect", "set"):
            return any(self.is_family_right(name) for name in first.effects)
        if first.kind == "none":
            return all(hidden.visible_strength < LEAST_VISIBLE for hidden in self.key.effects)
        return bool(self.key.effects) and (self.left_out or not self.families)
