"""Words of the field for tools, objects and sizes, of which findings are made."""

import numpy as np

# What a tool with much or little of a parameter is called; {} is the limit.
_TOOLS = {
    "length_mm": ("fingers deeper than {:.0f} mm", "fingers up to {:.0f} mm deep"),
    "width_mm": ("fingers wider than {:.1f} mm", "fingers up to {:.1f} mm wide"),
    "height_mm": ("fingers longer than {:.0f} mm", "fingers up to {:.0f} mm long"),
    "tip_length_mm": ("tips over {:.1f} mm", "tips under {:.1f} mm"),
    "front_thickness_mm": ("front walls over {:.2f} mm", "front walls under {:.2f} mm"),
    "back_thickness_mm": ("back walls over {:.2f} mm", "back walls under {:.2f} mm"),
    "rib_thickness_mm": ("ribs over {:.2f} mm", "ribs under {:.2f} mm"),
    "rib_count": ("more than {:.0f} ribs", "{:.0f} ribs or fewer"),
    "rib_angle_deg": ("rib angles above {:.0f} deg", "rib angles below {:.0f} deg"),
}
_OBJECTS = {
    "object width": ("objects wider than {:.0f} mm", "objects up to {:.0f} mm wide"),
    "object height": ("objects taller than {:.0f} mm", "objects up to {:.0f} mm tall"),
}


def condition(feature: str, limit: float, is_above: bool) -> tuple[str, str]:
    """What a split selects in words: for objects and for tools, one of them empty."""
    side = 0 if is_above else 1
    if feature in _TOOLS:
        if feature == "rib_count":
            limit = float(np.floor(limit))
        return "", _TOOLS[feature][side].format(limit)
    if feature in _OBJECTS:
        return _OBJECTS[feature][side].format(limit), ""
    return (f"objects with {feature}" if is_above else f"objects without {feature}"), ""


def stratum_words(conditions: tuple[tuple[str, str], ...]) -> str:
    """Conditions on objects and tools as one phrase, `everywhere` if there is none."""
    objects = [o for o, _ in conditions if o]
    tools = [t for _, t in conditions if t]
    parts = []
    if objects:
        parts.append("for " + " and ".join([objects[0], *(o.removeprefix("objects ") for o in objects[1:])]))
    if tools:
        parts.append("on tools with " + " and ".join(tools))
    return " ".join(parts) or "everywhere"


def size_words(effect_n: float, share: float, interval: tuple[float, float]) -> str:
    """A size in N and in per cent of the peak, with the interval in per cent, signs left to the sentence."""
    low, high = sorted(np.sign(share or 1.0) * np.array(interval))
    return f"{abs(effect_n):.2g} N ({abs(100 * share):.0f} % of the peak [{100 * low:.0f}, {100 * high:.0f}])"
