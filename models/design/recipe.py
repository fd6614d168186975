"""How a finger is printed: process, material of each body, support and what is done after, as a printer is told."""

import math
from typing import Literal

from pydantic import Field, model_validator

from fast.models.design.printability import PrintingRules
from fast.models.ids import canonical_json
from fast.models.records import Record

STRANDS_PER_WALL = 2  # a filament printer's wall of one line has no weld along its middle and tears there
_Text = Field(min_length=1, max_length=120)


class BodyMaterial(Record):
    """What one body of a finger is printed of; the colour is how a printer's program shows it."""

    material: str = _Text
    colour: str = Field(pattern=r"^#[0-9A-Fa-f]{6}$", description="#RRGGBB")
    density_g_per_cm3: float = Field(gt=0.1, le=10)


class Recipe(Record):
    """All that a print needs besides its shape; `name` is that of its file unless it says otherwise.

    `bed_mm` is the build plate, x by y. `min_wall_mm` is the thinnest wall that the process prints; of FDM it is two
    lines of the nozzle where that is more. `support_gap_mm` is the circle that must fit into every cavity, so that what
    removes support gets in; 0 where cavities have no support.
    """

    recipe: str | None = Field(
        default=None, description="path of a recipe file, relative to the config: it gives what is not said here"
    )
    name: str = Field(min_length=1, max_length=60)
    """Of the recipe: that of its file unless it says otherwise."""
    process: Literal["polyjet", "fdm", "sla", "sls"]
    """How bodies are made."""
    printer: str = _Text
    """Which machine."""
    bed_mm: tuple[float, float]
    """Build plate, x by y."""
    compliant: BodyMaterial
    """Material of the fingers."""
    rigid: BodyMaterial
    """Material of their bases."""
    layer_mm: float = Field(gt=0, le=1)
    """Height of a layer."""
    nozzle_mm: float | None = Field(default=None, gt=0, le=3, description="of FDM, required there")
    min_wall_mm: float | None = Field(default=None, gt=0, le=10, description="required but of FDM")
    infill_percent: float = Field(default=100.0, gt=0, le=100)
    """Of the walls."""
    finish: str = _Text
    """Of the surfaces."""
    support: str = _Text
    """What holds overhangs."""
    support_gap_mm: float = Field(ge=0, le=20)
    """Circle that must fit into every cavity, so that what removes support gets in; 0 where cavities have none."""
    post_processing: tuple[str, ...] = Field(min_length=1, description="steps, in order")

    @model_validator(mode="after")
    def _check_process(self) -> "Recipe":
        if self.process == "fdm" and self.nozzle_mm is None:
            raise ValueError('process "fdm" needs nozzle_mm, the width of its nozzle; add it')
        if self.process != "fdm" and self.nozzle_mm is not None:
            raise ValueError(f'process "{self.process}" has no nozzle; remove nozzle_mm')
        if self.process != "fdm" and self.min_wall_mm is None:
            raise ValueError(f'process "{self.process}" needs min_wall_mm, the thinnest wall that it prints; add it')
        if not all(50 <= size <= 2000 for size in self.bed_mm):
            raise ValueError("bed_mm must be two sizes of 50 to 2000 mm; correct it")
        return self

    @property
    def content_json(self) -> str:
        """All that it says, as canonical JSON: what is kept with a tool."""
        return canonical_json(self.model_dump(mode="json", exclude={"recipe"}, exclude_none=True))

    @property
    def wall_mm(self) -> float:
        """Thinnest wall that may be printed."""
        return max(self.min_wall_mm or 0.0, STRANDS_PER_WALL * (self.nozzle_mm or 0.0))

    @property
    def wall_rule(self) -> str:
        """Where the thinnest wall comes from, in words."""
        if self.nozzle_mm is not None and math.isclose(self.wall_mm, STRANDS_PER_WALL * self.nozzle_mm):
            return f"{STRANDS_PER_WALL} lines of a nozzle of {self.nozzle_mm:g} mm"
        return f"{self.name}, min_wall_mm"

    def limit(self, rules: PrintingRules) -> PrintingRules:
        """Return the rules with the wall and the gap of this recipe; its gap stands in place of theirs."""
        wall_mm = max(self.wall_mm, rules.min_wall_mm)
        return rules.model_copy(update={"min_wall_mm": wall_mm, "min_cavity_mm": self.support_gap_mm})
