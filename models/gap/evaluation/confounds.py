"""What these data cannot tell from theta or tools, and what would."""

from collections.abc import Mapping

from fast.models.gap.findings import Confound
from fast.models.simulation.effects.catalogue import CATALOGUE

HARDLY_VISIBLE = 0.1  # of a signature left once theta and tools are fitted again
_OF = {
    "young_modulus_mpa": "Young's modulus",
    "friction": "friction, as long as all lifts have one speed",
    "tool_modulus": "the modulus of each tool",
}
_EXPERIMENTS = {
    "load_cell_gain": "hang a dead weight of 1 kg on the load cell: force that the cell reads, without a gripper",
    "velocity_strengthening_friction": "lift at 1 and at 20 mm/s, one tool on one straight-sided object",
    "batch_ageing": "test a tool of an old batch again, or pull a tensile bar of each batch",
    "wall_thickness_offset": "calliper and scale on three fingers: wall thickness to 0.02 mm",
    "print_anisotropy": "tensile bars printed in two orientations",
    "temperature_softening": "log the temperature, and grasp a reference object with a reference tool every 36 grasps",
    "mullins_softening": "rest for an hour and grasp the first object again",
    "base_compliance": "push against a jaw without a finger, 20 N, and read how far it gives way",
}
_ANYWHERE = "a second lift speed, a second closed gap and a dead weight on the load cell"


def find_confounds(visible: Mapping[str, float] | None = None) -> tuple[Confound, ...]:
    """Declared aliases of the catalogue, and effects of which theta and tools swallow all but a tenth in these data.

    visible: by effect, the share of its signature that is left once theta and tools are fitted again.
    """
    declared = [
        Confound(effect=name, of=_OF[spec.alias_of], experiment=_EXPERIMENTS.get(name, _ANYWHERE))
        for name, spec in CATALOGUE.items()
        if spec.alias_of is not None
    ]
    names = {confound.effect for confound in declared}
    hidden = [
        Confound(
            effect=name,
            of=f"theta and tools, which take up {100 * (1 - share):.0f} % of it in these data",
            experiment=_EXPERIMENTS.get(name, _ANYWHERE),
        )
        for name, share in (visible or {}).items()
        if share < HARDLY_VISIBLE and name in CATALOGUE and name not in names
    ]
    return (*declared, *hidden)
