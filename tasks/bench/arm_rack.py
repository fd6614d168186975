"""The rack of a virtual arm: its bench file, and the tools that a lake says hang in it."""

import tomllib
from pathlib import Path

from fast.hardware.arm.settings import ArmSettings
from fast.hardware.tools.mounted import MountedTool
from fast.lake.store import Lake
from fast.lake.tables.campaign import DesignRow, ToolRow
from fast.models.errors import UsageError


def read_rack(address: str) -> dict[int, MountedTool]:
    """Printed tools of the newest batch in the lake, by slot; none while there is no lake or no tool."""
    if not Lake.exists(address):
        return {}
    lake = Lake.open(address)
    try:
        tools = [row for row in lake.records(ToolRow) if row.status == "printed"]
        newest = max((row.batch for row in tools), default=0)
        mounted = [row for row in tools if row.batch == newest]
        designs = {row.design_id: row.design for row in lake.records(DesignRow)}
        return {
            row.slot if row.rack_slot is None else row.rack_slot: MountedTool(row.tool_id, designs[row.design_id])
            for row in mounted
        }
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
