"""The bench by hand, and the real bench that a terminal lends: what the page shows of it, and what people order."""

import contextlib
import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from fast.flows.campaign.lend import find_bench_file
from fast.flows.page.configs import find_world
from fast.flows.page.jobs import start_on_worker
from fast.lake.leases import holder_of
from fast.lake.store import Lake
from fast.models.errors import UsageError
from fast.tasks.bench.lend import BenchRequest, LentBench, read_lent, reading_path, send_request
from fast.tasks.campaign.requests import GANTRY_LEASE


def describe_holder(lake: Lake, lent: LentBench | None) -> str:
    """Say who has the bench, in some words; empty where nobody has and none is lent."""
    if lent is not None and lent.holder:
        return f"{lent.holder} moves the bench by hand"
    if holder_of(lake.storage, GANTRY_LEASE) is not None:
        return "a campaign has the bench"
    return f"the bench {lent.name} is lent" if lent is not None else ""


def read_bench(lake: Lake, lent: LentBench | None) -> dict[str, Any]:
    """Read what the hand-moved bench reads now, what was said of it last, and a mark of who has it."""
    values: dict[str, Any] = {}
    if lent is not None and lent.holder:
        with contextlib.suppress(OSError, ValueError):
            values = json.loads(reading_path(lake).read_text())
    return {**values, "mark": mark_lent(lent), "said": lent.said if lent is not None else ""}


def mark_lent(lent: LentBench | None) -> str:
    """Return a mark that changes when the bench's card is to be drawn anew: whoever has or may have it is another."""
    if lent is None:
        return ""
    return f"{lent.session} {lent.holder} {lent.wanted_by} {lent.may_take(lent.wanted_by)}"


def ask_bench(lake: Lake, form: Mapping[str, str], operator: str) -> str:
    """Order something of the bench that is lent; where none is, the worker lends the campaign's virtual one.

    Raises:
        StaleRequestError: the bench that was seen is not lent any more.
        UsageError: somebody else holds it, or the order cannot be read.
    """
    verb, session = form.get("verb", ""), form.get("session", "")
    if verb == "take" and not session and read_lent(lake) is None:
        world = find_world(lake, form.get("campaign", ""))
        start_on_worker(lake, "lend/lend", {"holder": operator, "world": str(world)}, operator)
        return f"The virtual bench of {world.name} is connected and homed within a minute."
    values: dict[str, Any] = {"session": session, "operator": operator, "verb": verb}
    if verb == "step":
        step: dict[str, Any] = {name: form[name] for name in ("axis", "distance_mm") if name in form}
        values["step"] = {"verb": form.get("step", ""), "is_held": "is_held" in form, **step}
    if verb == "take":
        values["may_vent"] = "may_vent" in form
    try:
        request = BenchRequest.model_validate(values)
    except ValidationError as error:
        raise UsageError(f"The order could not be read ({error.errors()[0]['msg']}); nothing was moved.") from error
    return send_request(lake, request)


def find_lent(lake: Lake, config: Path) -> LentBench:
    """Find the lent bench that a campaign's config is for.

    Raises:
        UsageError: none is lent, or the config is for another.
    """
    file, lent = find_bench_file(config), read_lent(lake)
    if file is None:
        raise UsageError(f"{config.name} names no real bench (`bench.real`); nothing was started.")
    if lent is None or not lent.is_real:
        raise UsageError(
            "A real bench needs leave to move at the terminal beside it, once: "
            f"fast gantry lend --real {shlex.quote(str(file))} --lake {shlex.quote(lake.address)}. "
            "Then start again here."
        )
    if Path(lent.file) != file:
        raise UsageError(f"{config.name} is for the bench {file.stem}, and {lent.name} is lent; nothing was started.")
    return lent


def run_on_lent(lake: Lake, config: Path, operator: str) -> str:
    """Have the terminal that lends a real bench run a campaign on it.

    Raises:
        UsageError: none is lent, the config is for another, or it is in use.
    """
    lent = find_lent(lake, config)
    request = BenchRequest(session=lent.session, operator=operator, verb="run", config=str(config.resolve()))
    return f"{send_request(lake, request)} It shows on the tab Now within a minute."
