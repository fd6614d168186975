"""How a grasp was made, as columns of a row, and the row records of grasps that are asked for."""

from collections.abc import Mapping
from typing import Any, ClassVar, Self

from pydantic import Field

from fast.lake.tables.row import Row
from fast.models.ids import canonical_json, content_id
from fast.models.records import GraspRequest, GraspSetup, Placement, find_setup_id

PLACEMENT = ("offset_x_mm", "offset_y_mm", "yaw_deg")  # what of a placement can be asked for


def read_placement(row: Mapping[str, Any]) -> Placement:
    """Read the placement that was asked for from the columns of a row; an empty one is 0."""
    return Placement(**{name: row[name] or 0.0 for name in PLACEMENT})


def setup_columns(setup: GraspSetup, placement: Placement = Placement()) -> dict[str, Any]:  # noqa: B008 - frozen record
    """Return `setup_id` and `setup_json` of a row, and the placement asked for, where it is not the nominal one."""
    offsets = {name: value for name in PLACEMENT if (value := getattr(placement, name))}
    return {
        "setup_id": find_setup_id(setup, placement),
        "setup_json": canonical_json(setup.model_dump()),
        **offsets,
    }


class GraspRequestRow(Row):
    """A grasp that a search asks for; the view `asked_grasps` says what became of it."""

    table: ClassVar[str] = "grasp_requests"
    request_id: str
    """Of all that is asked."""
    search_id: str = Field(description="of what asks, such as a gap search")
    campaign_id: str | None = None
    """Of the tool; empty: a search of the whole lake."""
    place: int = Field(ge=0, description="order in which the grasps of a search are made")
    tool_id: str
    """What shall grasp."""
    object_id: int
    """What shall be grasped."""
    repeat: int
    """Counts the grasps of the same kind."""
    setup_id: str
    """How, and where the object shall sit."""
    setup_json: str
    """All of the setup."""
    offset_x_mm: float | None = None
    """Of the object between the fingers; empty: 0."""
    offset_y_mm: float | None = None
    """Of the object between the fingers; empty: 0."""
    yaw_deg: float | None = None
    """Of the object between the fingers; empty: 0."""
    purpose: str = Field(default="", description="what it shall tell, in words")
    parameter: str | None = Field(default=None, description="whose interval it shall shorten, if no effects are told")

    @classmethod
    def of(
        cls,
        search_id: str,
        place: int,
        request: GraspRequest,
        campaign_id: str | None = None,
        parameter: str | None = None,
    ) -> Self:
        """Make the row of a request of a search."""
        where = setup_columns(request.setup, request.placement)
        return cls(
            request_id=cls.make_id(search_id, place),
            search_id=search_id,
            campaign_id=campaign_id,
            place=place,
            tool_id=request.tool_id,
            object_id=request.object_id,
            repeat=request.repeat,
            purpose=request.purpose,
            parameter=parameter,
            **where,
        )

    @property
    def request(self) -> GraspRequest:
        """The request of this row."""
        return GraspRequest(
            tool_id=self.tool_id,
            object_id=self.object_id,
            repeat=self.repeat,
            setup=GraspSetup.model_validate_json(self.setup_json),
            placement=read_placement(self.__dict__),
            purpose=self.purpose,
            request_id=self.request_id,
        )

    @staticmethod
    def make_id(search_id: str, place: int) -> str:
        """Make an id from which request of which search it is."""
        return content_id("I", [search_id, place])
