"""Row records of what traces say: their features, and flags on grasps that went wrong; `fast features` fills both."""

from typing import ClassVar, Self

from pydantic import Field

from fast.lake.tables.row import Row
from fast.models.ids import content_id
from fast.models.traces.flags import Anomaly, Compared, Kind
from fast.models.traces.names import FEATURE_VERSION


class TraceFeaturesRow(Row):
    """Features of one measured grasp, from its trace alone; empty where the trace does not show one.

    Forces named without a reading are means over 0.5 mm of lift.
    """

    table: ClassVar[str] = "trace_features"
    feature_id: str
    """Of grasp and version."""
    grasp_id: str
    """Whose trace it is."""
    feature_version: int = Field(description="of the definitions; queries want one version, the newest")
    peak_force_n: float = Field(description="largest reading of the lift")
    peak_lift_mm: float
    """Where that is."""
    initial_force_n: float = Field(description="reading just before the lift")
    closing_lowest_n: float = Field(description="lowest reading of the closing; negative: fingers press down")
    dip_n: float = Field(description="lowest in the first 3 mm of the lift")
    positive_after_mm: float = Field(description="lift from which the force is positive, up to the peak")
    work_j: float = Field(description="to break the grasp: area under the force over the lift")
    hold_start_mm: float | None = None
    """Where that stretch begins."""
    hold_mm: float = Field(description="longest stretch at 80 % of the peak or more")
    hold_force_n: float | None = Field(default=None, description="mean over that stretch")
    hold_slope_n_per_mm: float | None = Field(default=None, description="of the least-squares line through it")
    half_peak_lift_mm: float = Field(description="lift above half of the peak, all stretches together")
    n_peaks: int = Field(description="that stand out by 8 % of the peak and 0.5 N")
    prominence_n: float = Field(description="of the peak that stands out most")
    second_prominence_n: float = Field(description="of the next; 0: there is none")
    drop_rate_n_per_mm: float | None = Field(default=None, description="mean fall from 80 to 20 % of the peak")
    lowest_after_n: float = Field(description="lowest after the peak; negative: the tips push the object down")
    separation_lift_mm: float | None = Field(default=None, description="last reading of a tenth of the peak, and 0.5 N")
    end_force_n: float | None = Field(default=None, description="mean over the last 2 mm: the zero when it is over")
    profile_n: tuple[float, ...] = Field(description="mean forces over 2 mm of lift each, up to 60 mm")

    @classmethod
    def of(cls, grasp_id: str, features: dict[str, float | None], profile_n: list[float]) -> Self:
        """Make the row of the features of a grasp by name, as `TraceFeatures.row` gives them."""
        return cls.model_validate(
            {
                "feature_id": cls.make_id(grasp_id, FEATURE_VERSION),
                "grasp_id": grasp_id,
                "feature_version": FEATURE_VERSION,
                "profile_n": profile_n,
                **features,
            }
        )

    @staticmethod
    def make_id(grasp_id: str, feature_version: int) -> str:
        """Make an id from the grasp and the definitions: calculating again duplicates nothing."""
        return content_id("T", [grasp_id, feature_version])


class AnomalyFlagRow(Row):
    """One thing wrong with a measured grasp, as its repeats and peers tell; the view `anomalies` has those that stand.

    Grasps measured later may take a flag back: the row is then superseded by one that is not flagged.
    """

    table: ClassVar[str] = "anomaly_flags"
    flag_id: str
    """Of grasp and kind."""
    grasp_id: str
    """What is flagged."""
    kind: Kind
    """What is wrong."""
    is_flagged: bool
    """False: taken back."""
    p_value: float | None = Field(default=None, description="that chance departs as far; empty when taken back")
    compared: Compared | None = Field(default=None, description="what the grasp was compared with")
    shortfall: float | None = Field(default=None, description="in the unit that the reason names")
    reason: str = ""
    """In words."""

    @classmethod
    def of(cls, grasp_id: str, anomaly: Anomaly) -> Self:
        """Make the row of a flag."""
        values = {name: value for name, value in anomaly._asdict().items() if name != "place"}
        return cls(flag_id=cls.make_id(grasp_id, anomaly.kind), grasp_id=grasp_id, is_flagged=True, **values)

    @classmethod
    def taken_back(cls, grasp_id: str, kind: Kind) -> Self:
        """Make the row of a flag that no longer stands."""
        return cls(flag_id=cls.make_id(grasp_id, kind), grasp_id=grasp_id, kind=kind, is_flagged=False)

    @staticmethod
    def make_id(grasp_id: str, kind: Kind) -> str:
        """Make an id from the grasp and the kind: a later row supersedes an earlier one."""
        return content_id("Y", [grasp_id, kind])
