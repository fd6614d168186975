"""The parameters that a grasp has slopes by: where each is in the inputs of a grasp, and how it is moved."""

import difflib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

from fast.models.design.fin_ray import FinRay
from fast.models.errors import UsageError
from fast.models.records import EffectValue, GraspSetup, Placement, Record, Theta
from fast.models.simulation.effects.catalogue import CATALOGUE
from fast.models.simulation.effects.scaling import scales_with_modulus
from fast.models.simulation.effects.spec import EffectSpec, ParameterSpec
from fast.models.simulation.inputs import GraspInputs
from fast.models.units import unit_of

ALL = "all"
_WALLS = "wall_offset_mm"
SHORT_NAMES = {"nu": "poisson_ratio", _WALLS: "wall_thickness_offset.offset_mm"}
_PAGE = "docs/how-to/use-slopes.md"

_SMALL = 1e-4  # of a parameter's range: below the curvature of the force, above the rounding of a copy's equilibrium
_SMALL_OF_PRIOR = 1e-3  # of an effect's prior
_SMALL_OF_TRACE = 0.05  # the same, of effects of the load cell
_FINITE = 0.03  # of the range of a number of the finger, where its mesh changes
_USUAL = 0.1  # of the range of a number of the finger

# Hooks of effects whose parameters copies carry. Of `modify_object` and `finger_stop_mm` a finite step is taken: what
# touches moves over the contact points. Other hooks act on traces, on the closing and on the modulus of the whole.
_CARRIED = ("modify_profile", "modify_section", "stiffness_factor", "strain_stiffening", "friction_factor")
_ADHESION = "adhesion_mpa"
_FINITE_HOOKS = ("modify_object", "finger_stop_mm")


@dataclass(frozen=True)
class Parameter:
    """A number among the inputs of a grasp."""

    name: str
    """As in `along=`."""
    value: float
    """The present one."""
    put: Callable[[float], GraspInputs]
    """Gives the inputs with another value."""
    small: float
    """Change of a copy, towards where there is room."""
    finite: float
    """Change of a grasp of its own, towards where there is room."""
    usual: float
    """By how much it changes between prints, grasps or designs, which is what bars show."""
    is_carried: bool = True
    """Copies of the finger walk with it; else its slope follows from others."""
    is_finite: bool = False
    """Two grasps of their own: the slope of the discrete force is that of contact points, not of the force."""
    is_in_all: bool = False
    """Asked for by `all`."""
    is_at_limit: bool = False
    """There is room to one side alone."""

    @property
    def unit(self) -> str:
        """Of its slope."""
        unit = unit_of(self.name)
        return f"N/({unit})" if unit and "/" in unit else f"N/{unit}" if unit else "N"


def find_parameters(grasp: GraspInputs, names: Sequence[str] | str) -> dict[str, Parameter]:
    """Find the parameters of these names, as they are named there; `all`: those of finger, material and closing.

    One that is named twice, or by both of its names, is there once, by the first.

    Raises:
        UsageError: a parameter is unknown or has no slope, or these are no names.
    """
    names = (names,) if isinstance(names, str) else names
    if not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise UsageError(f'along is {names!r}, it must be names of parameters, such as ("friction",); change it.')
    if not names:
        return {}
    known = {parameter.name: parameter for parameter in _parameters(grasp)}
    short = {long: word for word, long in SHORT_NAMES.items()}
    in_all = [short.get(p.name, p.name) for p in known.values() if p.is_in_all]
    asked: dict[str, str] = {}
    for name in chain.from_iterable(in_all if name == ALL else [name] for name in names):
        own = SHORT_NAMES.get(name, name)
        if own not in known:
            aliases = [word for word, long in SHORT_NAMES.items() if long in known]
            raise UsageError(_refusal(name, grasp, [*aliases, *known]))
        asked.setdefault(own, name)
    return {name: known[own] for own, name in asked.items()}


def _refusal(name: str, grasp: GraspInputs, known: Sequence[str]) -> str:
    records: dict[str, type[Record]] = {"material": Theta, "finger": type(grasp.design), "closing": GraspSetup}
    records["placement"] = Placement
    fields = [field for record in records.values() for field in record.model_fields]
    inputs = {*fields, *(f"{spec.effect}.{p.name}" for spec in CATALOGUE.values() for p in spec.parameters)}
    near = [] if name in inputs else _nearest(name, known)
    if near:
        meant = " or ".join(f"`{own}`" for own in near)
        return f"there is no parameter `{name}`; did you mean {meant}? {_PAGE} has all names."
    groups = {kind: [own for own in known if own in record.model_fields] for kind, record in records.items()}
    groups["print"] = [own for own in known if own == _WALLS]
    words = ", ".join(f"{kind} ({', '.join(names)})" for kind, names in groups.items() if names)
    head = f"`{name}` has no slope" if name in inputs else f"there is no parameter `{name}`"
    return f"{head}; slopes are by {words} and by effects, as EFFECT.PARAMETER ({_PAGE})."


def _nearest(name: str, known: Sequence[str]) -> list[str]:
    """Find the known names most like this one, whole or the effect or parameter in them; case does not matter."""
    names: dict[str, list[str]] = {}
    for own in known:
        for part in dict.fromkeys([own, *own.split(".")]):
            names.setdefault(part.lower(), []).append(own)
    close = difflib.get_close_matches(name.strip().lower(), names, n=1)
    return names[close[0]] if close else []


def _parameters(grasp: GraspInputs) -> Iterator[Parameter]:
    yield from _of_theta(grasp)
    yield from _of_design(grasp)
    setup = grasp.setup

    def with_setup(field: str) -> Callable[[float], GraspInputs]:
        return lambda value: replace(grasp, setup=setup.model_copy(update={field: value}))

    yield Parameter(
        "closed_gap_mm", setup.closed_gap_mm, with_setup("closed_gap_mm"), 1e-3, 0.5, 0.4, False, is_in_all=True
    )
    yield Parameter("tip_below_mm", setup.tip_below_mm, with_setup("tip_below_mm"), 0.0, 0.5, 0.5, is_finite=True)
    for field, value in grasp.placement.model_dump().items():
        yield Parameter(
            field,
            value,
            lambda moved, field=field: replace(grasp, placement=grasp.placement.model_copy(update={field: moved})),  # type: ignore[misc]
            0.0,
            *((0.5, 0.5) if field.endswith("_mm") else (2.0, 2.0)),
            is_finite=True,
            is_in_all=field == "offset_z_mm",
        )
    for spec in () if grasp.effects is not None else CATALOGUE.values():
        if isinstance(grasp.design, FinRay) or not spec.needs_fin_ray:
            yield from _of_effect(grasp, spec)


def _scales(grasp: GraspInputs) -> bool:
    """Return whether forces are in exact proportion to the modulus, so that its slope needs no copy."""
    if grasp.effects is not None:
        return all(effect.scales_with_modulus for effect in grasp.effects)
    return scales_with_modulus(grasp.version)


def _of_theta(grasp: GraspInputs) -> Iterator[Parameter]:
    theta, is_carried = grasp.version.theta, not _scales(grasp)

    def with_theta(field: str) -> Callable[[float], GraspInputs]:
        def put(value: float) -> GraspInputs:
            moved = theta.model_copy(update={field: value})
            return replace(grasp, version=grasp.version.model_copy(update={"theta": moved}))

        return put

    modulus, friction, poisson = "young_modulus_mpa", "friction", "poisson_ratio"
    yield Parameter(modulus, theta.young_modulus_mpa, with_theta(modulus), 1e-3, 1.0, 1.0, is_carried, is_in_all=True)
    yield Parameter(friction, theta.friction, with_theta(friction), 5e-5, 0.02, 0.1, is_in_all=True)
    yield Parameter(poisson, theta.poisson_ratio, with_theta(poisson), -5e-6, -0.01, 0.02, is_in_all=True)


def _of_design(grasp: GraspInputs) -> Iterator[Parameter]:
    """Yield the continuous numbers of the finger."""
    for field, info in type(grasp.design).model_fields.items():
        if info.annotation is not float:
            continue
        value = getattr(grasp.design, field)
        lower, upper = (_limit(info.metadata, name) for name in ("ge", "le"))
        span = upper - lower

        def put(moved: float, field: str = field) -> GraspInputs:
            return replace(grasp, design=grasp.design.model_copy(update={field: moved}))

        finite = _FINITE * span
        inward = -1.0 if value + finite > upper else 1.0
        yield Parameter(
            field,
            value,
            put,
            inward * _SMALL * span,
            inward * finite,
            _USUAL * span,
            is_in_all=True,
            is_at_limit=not lower <= value - inward * finite <= upper,
        )


def _limit(metadata: Sequence[Any], name: str) -> float:
    (limit,) = [float(getattr(bound, name)) for bound in metadata if hasattr(bound, name)]
    return limit


def _of_effect(grasp: GraspInputs, spec: EffectSpec) -> Iterator[Parameter]:
    """Yield the parameters of an effect; one that is not switched on is moved from where it vanishes."""
    own = next((value.parameters for value in grasp.version.effects if value.effect == spec.effect), {})
    present = spec.neutral.parameters | own
    kind = spec.kind
    is_carried = kind.overrides(*_CARRIED, _ADHESION) or (kind.overrides("modify_theta") and not _scales(grasp))
    for parameter in spec.parameters:
        if parameter.is_limit and present[parameter.name] >= parameter.neutral:
            continue

        def put(value: float, parameter: ParameterSpec = parameter) -> GraspInputs:
            effect = EffectValue(effect=spec.effect, parameters={**present, parameter.name: value})
            effects = {switched.effect: switched for switched in grasp.version.effects} | {spec.effect: effect}
            return replace(grasp, version=grasp.version.model_copy(update={"effects": tuple(effects.values())}))

        value, prior = present[parameter.name], parameter.prior_sd
        # A finished trace is moved for nothing, but the load cell's samples are not those of the simulation.
        small = _SMALL_OF_TRACE if kind.acts_on_traces() and not is_carried else _SMALL_OF_PRIOR
        inward = -1.0 if value + prior > parameter.upper else 1.0
        yield Parameter(
            f"{spec.effect}.{parameter.name}",
            value,
            put,
            inward * small * prior,
            inward * 0.5 * prior,
            prior,
            is_carried,
            is_finite=kind.overrides(*_FINITE_HOOKS),
            is_in_all=spec.effect == "wall_thickness_offset",
            is_at_limit=not parameter.lower <= value - inward * 0.5 * prior <= parameter.upper,
        )
