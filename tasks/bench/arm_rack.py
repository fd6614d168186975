"""The rack of a virtual arm: its bench file, and the tools that a lake says hang in it."""

import tomllib
from pathlib import Path

from fast.hardware.arm.settings import ArmSettings
from fast.hardware.tools.mounted import MountedTool
from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, EventRow, ToolRow
from fast.models.errors import UsageError
from fast.tasks.campaign.requests import BENCH_OPENED


def read_rack(address: str) -> dict[int, MountedTool]:
    """Read the tools that a campaign of the lake expects in its arm's rack, by slot; none while none has opened one."""
    if not Lake.exists(address):
        return {}
    lake = Lake.open(address)
    try:
        opened = [row.payload for row in lake.records(EventRow, kind=BENCH_OPENED)]
        hanging: dict[str, str] = next((found["hanging"] for found in reversed(opened) if "hanging" in found), {})
        tools = {row.tool_id: row.design_id for row in lake.records(ToolRow, tool_id=list(hanging.values()))}
        designs = {row.design_id: row.design for row in lake.records(DesignRow, design_id=list(tools.values()))}
        return {int(slot): MountedTool(tool_id, designs[tools[tool_id]]) for slot, tool_id in hanging.items()}
    finally:
        lake.close()


def write_bench_file(path: Path, settings: ArmSettings) -> None:
    """Write the bench file of an arm as TOML.

    Raises:
        UsageError: the file cannot be written.
    """
    values = settings.model_dump(exclude={"limits", "mounts_mm"}, exclude_none=True)
    lines = [f"{name} = {_write(value)}" for name, value in values.items()]
    lines += ["", "[mounts_mm]", *(f"{number} = {_write(place)}" for number, place in settings.mounts_mm.items())]
    text = "\n".join([*lines, ""])
    tomllib.loads(text)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path} cannot be written ({error.strerror}); give another --file.") from error


def _write(value: object) -> str:
    if isinstance(value, (tuple, list)):
        return "[" + ", ".join(_write(one) for one in value) + "]"
    return f'"{value}"' if isinstance(value, str) else f"{value}"
