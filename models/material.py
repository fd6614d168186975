"""What was measured of a lot of printing material: a value for each quantity, with its scatter and its source."""

from pydantic import Field, ValidationInfo, field_validator

from fast.models.records import Record

LAYER_EXCESS = "layer_modulus_excess"  # modulus of a bar printed upright over that of a flat one, less 1
# Unit of each quantity, and the range in which a value is believed: for modulus and friction that of the simulator.
QUANTITIES: dict[str, tuple[str, float, float]] = {
    "young_modulus": ("MPa", 0.5, 200.0),
    "static_friction": ("1", 0.02, 2.0),
    "dynamic_friction": ("1", 0.02, 2.0),
    "hardness": ("Shore A", 10.0, 100.0),
    LAYER_EXCESS: ("1", -0.9, 2.0),
}
TABLE_3 = "none"  # asks for the priors of the paper's Table 3, so no lot may have this name


class MaterialMeasurement(Record):
    """One quantity of a lot: mean of `n` tests, and the standard deviation of single tests in the same unit."""

    value: float
    unit: str
    sd: float | None = Field(default=None, gt=0)
    n: int | None = Field(default=None, ge=1)
    method: str = Field(min_length=1)
    source: str = Field(min_length=1)


class MaterialLot(Record):
    """What is known of a lot of material; a quantity that nobody measured is None."""

    young_modulus: MaterialMeasurement | None = None
    static_friction: MaterialMeasurement | None = None
    dynamic_friction: MaterialMeasurement | None = None
    hardness: MaterialMeasurement | None = None
    layer_modulus_excess: MaterialMeasurement | None = None

    @field_validator(*QUANTITIES)
    @classmethod
    def _check_value(cls, measured: MaterialMeasurement | None, info: ValidationInfo) -> MaterialMeasurement | None:
        if measured is None:
            return None
        unit, lowest, highest = QUANTITIES[str(info.field_name)]
        if measured.unit != unit:
            raise ValueError(f'the unit is "{measured.unit}", it must be "{unit}"; convert value and sd')
        if not lowest <= measured.value <= highest:
            raise ValueError(
                f"the value is {measured.value:g} {unit}, it must be {lowest:g} to {highest:g}; check value and unit"
            )
        return measured

    @property
    def measured(self) -> dict[str, MaterialMeasurement]:
        """The quantities that were measured, by name."""
        return {name: found for name in QUANTITIES if (found := getattr(self, name)) is not None}


def modulus_of_hardness_mpa(hardness_shore_a: float) -> float:
    """Young's modulus of a rubber by its Shore A hardness S (Gent 1958, Rubber Chem. Technol. 31, 896), MPa.

        E = 0.0981 (56 + 7.62336 S) / (0.137505 (254 - 2.54 S))

    The durometer's spring force over its depth, as of a flat punch of the tip's mean radius on an incompressible
    half-space. Good to some ten per cent for 20 to 80; too rough for a prior, enough to catch a slip of the pen.
    """
    return 0.0981 * (56.0 + 7.62336 * hardness_shore_a) / (0.137505 * (254.0 - 2.54 * hardness_shore_a))
