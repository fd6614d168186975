"""A bench file for the addresses of a virtual bench, as for a rehearsal."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fast.flows.cli.virtual import rack


def write_bench(path: Path, addresses: Mapping[str, Any], more: str = "") -> Path:
    """Write it, with the weights of the tools that hang there; `more`: further lines."""
    lines = [f"{key} = {json.dumps(value)}" for key, value in addresses.items()]
    masses = [f"{slot} = {tool.expected_mass_kg:.3f}" for slot, tool in rack(None).items()]
    path.write_text("\n".join([*lines, "modbus_time_out_s = 10", more, "[tool_mass_kg]", *masses]))
    return path
