"""Names of the hand-off format: its files and their columns."""

from fast.lake.tables.requests import PLACEMENT
from fast.models.design.space import PARAMETERS
from fast.models.records import GraspSetup, Theta

DESIGN_COLUMNS = ("design_id", *PARAMETERS)
# Of fingers that are no fin rays: the family, and its parameters as a JSON object; the nine columns may then be empty.
FAMILY_COLUMNS = ("family", "parameters_json")
GRASP_COLUMNS = ("grasp_id", "design_id", "object_id", "repeat", "fidelity", "tool_id", "started_at", "order")
# How a grasp was made, and what asked for it; what is left out means the usual setup, and that nobody asked.
SETTING_COLUMNS = (*GraspSetup.model_fields, *PLACEMENT)
HOW_COLUMNS = (*SETTING_COLUMNS, "request_id")
TELLING_COLUMNS = ("closed_gap_mm", "tip_below_mm")  # settings that change a force most: an export always says them
# Where a grasp was made and how it ended. A grasp without samples has a peak, or is a failure with its reason.
END_COLUMNS = (
    "lab", "bench", "world_hash", "attempt", "status", "reason", "peak_force_n", "tare_force_n", "software",
)  # fmt: skip
# What a person measured of tools and of the lots of material that they are printed of.
TOOL_COLUMNS = (
    "tool_id", "design_id", "status", "reason", "operator", "material_lot", "measured_front_thickness_mm",
    "measured_back_thickness_mm", "measured_rib_thickness_mm", "hardness_shore_a",
)  # fmt: skip
RECIPE_COLUMNS = ("recipe", "recipe_json")  # of tools, where a recipe was kept with one
MATERIAL_COLUMNS = ("lot", "quantity", "value", "unit", "sd", "n", "method", "source")
CHANNELS = ("time_s", "lift_mm", "force_n")
TRACE_COLUMNS = ("grasp_id", *CHANNELS)
THETA_COLUMNS = tuple(Theta.model_fields)
SIMULATION_COLUMNS = ("grasp_id", *THETA_COLUMNS, "contact_force_n")
OBJECTS_FILE = "objects.json"  # own objects: a list of object_id, name and shape
FILE_NAMES = (
    OBJECTS_FILE, "tools.csv", "materials.csv", "designs.csv", "grasps.csv", "simulations.csv", "traces.csv",
    "traces.parquet",
)  # fmt: skip
