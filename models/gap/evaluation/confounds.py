"""What these data cannot tell from theta or tools, and what would."""

from collections.abc import Mapping

from fast.models.gap.findings import Confound
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.units import spell_share

HARDLY_VISIBLE = 0.1  # of a signature left once theta and tools are fitted again
_OF = {
    "young_modulus_mpa": "Young's modulus",
    "friction": "friction, as long as all lifts have one speed",
    "tool_modulus": "the modulus of each tool",
}
_ANYWHERE = "a second lift speed, a second closed gap and a dead weight on the load cell"


def find_confounds(visible: Mapping[str, float] | None = None) -> tuple[Confound, ...]:
    """Declared aliases of the catalogue, and effects of which theta and tools swallow all but a tenth in these data.

    visible: by effect, the share of its signature that is left once theta and tools are fitted again.
    """
    declared = [
        Confound(effect=name, of=_OF[spec.alias_of], experiment=spec.experiment or _ANYWHERE)
        for name, spec in CATALOGUE.items()
        if spec.alias_of is not None
    ]
    names = {confound.effect for confound in declared}
    hidden = [
        Confound(
            effect=name,
            of=f"theta and tools, which take up {spell_share(1 - share)} of it in these data",
            experiment=CATALOGUE[name].experiment or _ANYWHERE,
        )
        for name, share in (visible or {}).items()
        if share < HARDLY_VISIBLE and name in CATALOGUE and name not in names
    ]
    return (*declared, *hidden)
