"""Whether open pages slow the bench: a campaign on virtual devices in real time, with and without twenty open pages.

The drivers, the wires and the page's process are the real ones; the pages ask as a browser's script asks. They open and
close after every `BLOCK` grasps, so that whatever else the computer does meets both kinds alike.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fast.flows.server.access import Api
from fast.flows.server.lab import CHECKOUT
from fast.flows.server.page_port import find_page
from fast.lake.store import Lake
from tests.flows.cli.rehearsal import write_bench
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.platform.page_cost import N_PAGES, open_page

BLOCK = 3
LOOK_S = 0.5
_GRASPS = "SELECT tool_id, object_id, repeat, created_at FROM grasps ORDER BY created_at"
_CONFIG = """
name = "paper"
seed = 1
[schedule]
initial_tools = 2
tools_per_batch = 2
guided_batches = 0
initial_simulations = 2
simulations_per_batch = 2
[objects]
ids = [2, 14, 28, 30]
repeats = {repeats}
[bench]
world = "world.toml"
real = "rehearsal.toml"
[execution]
simulation_workers = 1
"""


@dataclass(frozen=True)
class Pace:
    """From the end of a grasp to the end of the next one of the same tool, on the wall."""

    duration_s: float
    cell: tuple[str, int]
    """Tool and object: the way there and the lift take their time."""
    is_first: bool
    """The first of its object: the virtual gripper waits for its physics then."""
    n_pages: int


def measure_page_pace(options: Options) -> Tables:
    """Seconds from grasp to grasp of a virtual bench in real time, with no and with twenty pages open; --n repeats."""
    with tempfile.TemporaryDirectory(prefix="fast-page-pace-") as name:
        folder = Path(name)
        (folder / "world.toml").write_bytes((CHECKOUT / "worlds" / "quick.toml").read_bytes())
        (folder / "campaign.toml").write_text(_CONFIG.format(repeats=options.n or 8), encoding="utf-8")
        with _virtual_bench(folder), _running_campaign(folder) as campaign:
            paces = list(_watch(folder / "lake", campaign, options))
    return {"page-pace": [summarise(paces)]}


def summarise(paces: list[Pace]) -> dict[str, Any]:
    """What pages add to a grasp: least squares with a duration for each cell, first grasps left out; 90 % interval."""
    later = [pace for pace in paces if not pace.is_first]
    cells = sorted({pace.cell for pace in later})
    design = np.array([[*(pace.cell == cell for cell in cells), pace.n_pages > 0] for pace in later], dtype=float)
    duration_s = np.array([pace.duration_s for pace in later])
    terms = np.linalg.lstsq(design, duration_s, rcond=None)[0]
    rest_s = duration_s - design @ terms
    variance = float(rest_s @ rest_s) / (len(later) - len(terms))
    sd_s = float(np.sqrt(variance * np.linalg.inv(design.T @ design)[-1, -1]))
    percent = 100.0 / float(duration_s.mean())
    n_with = int(design[:, -1].sum())
    return {
        "grasps_without": len(later) - n_with,
        "grasps_with": n_with,
        "grasp_s": float(duration_s.mean()),
        "slower_percent": float(terms[-1]) * percent,
        "slower_percent_low": (float(terms[-1]) - 1.645 * sd_s) * percent,
        "slower_percent_high": (float(terms[-1]) + 1.645 * sd_s) * percent,
    }


def _watch(root: Path, campaign: "subprocess.Popen[bytes]", options: Options) -> Iterator[Pace]:
    """Open and close pages of the campaign while it measures."""
    while not Lake.exists(root):
        time.sleep(LOOK_S)
    lake = Lake.open(root)
    last: tuple[str, float] | None = None
    n_seen = n_pages = 0
    with ExitStack() as stack:
        while campaign.poll() is None:
            time.sleep(LOOK_S)
            rows = lake.query(_GRASPS).to_pylist()
            for row in rows[n_seen:]:
                ended_s = row["created_at"].timestamp()
                if last is not None and last[0] == row["tool_id"]:
                    cell = row["tool_id"], row["object_id"]
                    yield Pace(ended_s - last[1], cell, row["repeat"] == 0, n_pages)
                last = row["tool_id"], ended_s
                n_seen += 1
                page = find_page(root)
                if n_seen % BLOCK == 0 and page is not None:
                    n_pages = _toggle(stack, page, n_pages)
                    options.tell(f"{n_seen} grasps; {n_pages} pages open")


def _toggle(stack: ExitStack, page: Api, n_pages: int) -> int:
    if n_pages:
        stack.pop_all().close()
        return 0
    for _ in range(N_PAGES):
        stack.enter_context(open_page(page))
    return N_PAGES


@contextmanager
def _virtual_bench(folder: Path) -> Iterator[None]:
    """A virtual bench in real time, in a process of its own, and its bench file."""
    words = [sys.executable, "-m", "fast.flows.cli.main", "virtual", "start", str(folder / "world.toml"), "--json"]
    bench = subprocess.Popen(words, cwd=CHECKOUT, stdout=subprocess.PIPE)
    try:
        assert bench.stdout is not None
        addresses = json.loads(bench.stdout.readline())
        write_bench(folder / "rehearsal.toml", addresses, "pressure_time_out_s = 120")
        yield
    finally:
        bench.terminate()
        bench.wait()


@contextmanager
def _running_campaign(folder: Path) -> Iterator["subprocess.Popen[bytes]"]:
    words = ["campaign", "run", str(folder / "campaign.toml"), "--lake", str(folder / "lake"), "--auto-print"]
    words += ["--real", "--yes-move", "rehearsal"]
    log = folder / "campaign.log"
    with log.open("wb") as lines:
        campaign = subprocess.Popen(
            [sys.executable, "-m", "fast.flows.cli.main", *words], cwd=CHECKOUT, stdout=lines, stderr=lines
        )
        try:
            yield campaign
            if campaign.wait() != 0:
                raise RuntimeError(f"the campaign failed: {log.read_text()[-2000:]}")
        finally:
            campaign.terminate()
            campaign.wait()
