"""The families of fingers that FAST brings, and those of a user's own (`docs/how-to/add-a-family.md`)."""

import math
from collections.abc import Mapping
from typing import Any

from fast.models.design.fin_ray import FinRay
from fast.models.errors import ConfigError, UsageError
from fast.models.own_code import load_own
from fast.models.records import Design
from fast.models.validation import closest, load_record

# A family of a user's own needs no line here: configs name it as `module:Class`.
FAMILIES: Mapping[str, str] = {
    "fin-ray": "fast.models.design.fin_ray:FinRay",
    "graded-fin-ray": "fast.models.design.fin_ray:GradedFinRay",
    "free-form": "fast.models.design.free_form:FreeForm",
}


def find_family(name: str) -> type[Design]:
    """Find the family with this name, or of a user's own as `module:Class`.

    Raises:
        UsageError: it is unknown, cannot be imported, or is no family.
    """
    if name == FinRay.family:
        return FinRay
    if ":" not in name and name not in FAMILIES:
        raise UsageError(
            f"the design family `{name}` is unknown; {closest(name, list(FAMILIES))} One of your own is `module:Class`."
        )
    found: Any = load_own(FAMILIES.get(name, name))
    if not (isinstance(found, type) and issubclass(found, Design)) or found is Design:
        raise UsageError(f"`{name}` is no design family: make it a subclass of `models.records.Design`.")
    return found


def read_design(family: str | None, values: Mapping[str, Any], source: str = "design") -> Design:
    """Read a design of the family (None: a fin ray) from its parameters.

    Raises:
        UsageError: the family is unknown.
        ConfigError: a parameter is missing, unknown or out of its range.
    """
    return load_record(find_family(family or FinRay.family), dict(values), source)


def check_section(design: Design) -> None:
    """Check that a design of a user's own family can be meshed, printed and mounted.

    Raises:
        ConfigError: its section is no single body, leaves its outer sizes, or has no front wall at x = 0.
    """
    from shapely.geometry import Polygon

    from fast.models.design.fin_ray import BASE_HEIGHT_MM

    section = design.draw_section()
    what = f"the section of design {design.design_id} ({design.family})"
    if not isinstance(section, Polygon) or section.is_empty or not section.is_valid:
        raise ConfigError(f"{what} is no single valid polygon; correct `draw_section`.")
    x_min, z_min, x_max, z_max = section.bounds
    if x_max > design.length_mm + 1e-6 or not math.isclose(z_max, design.height_mm, abs_tol=1e-6):
        raise ConfigError(
            f"{what} ends at x {x_max:.2f} and z {z_max:.2f} mm; it must stay within length {design.length_mm:.2f} mm "
            f"and reach height {design.height_mm:.2f} mm."
        )
    if not math.isclose(x_min, 0.0, abs_tol=1e-6) or not math.isclose(z_min, BASE_HEIGHT_MM, abs_tol=1e-6):
        raise ConfigError(
            f"{what} begins at x {x_min:.2f} and z {z_min:.2f} mm; the front wall must lie at x = 0, the foot on the "
            f"base at z = {BASE_HEIGHT_MM:g} mm."
        )
