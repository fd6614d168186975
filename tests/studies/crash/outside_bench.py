"""Virtual devices in a process of their own, which live on when their host dies: `fast virtual start` for studies."""

import json
import multiprocessing
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from multiprocessing.process import BaseProcess
from pathlib import Path

from fast.hardware.bench import Bench, BenchSettings, open_real_bench, open_virtual_servers
from fast.hardware.clock import ScaledClock
from fast.hardware.virtual.world.file import World
from fast.models.errors import DeviceError, InterlockError
from fast.tasks.campaign.state import ProposedTool
from tests.studies.benchmarks.fingerprints import fingerprint
from tests.studies.benchmarks.made_up_batch import Batch, rack_of

SPEED_UP = 5.0  # faster, and a pause of a busy machine looks like a fault
START_S = 60.0
PATIENCE_S = 30.0  # of the clock, for the pressure of the gripper


class OutsideDevices:
    """The devices of a batch: `start` gives them a new world with all tools in the rack, `kill` ends it."""

    def __init__(self, folder: Path, batch: Batch, world: World) -> None:
        self.addresses = folder / "addresses.json"
        self._folder, self._batch, self._world = folder, batch, world
        self._process: BaseProcess | None = None

    def start(self) -> None:
        """Start, and wait until they answer.

        Raises:
            DeviceError: they do not.
        """
        self.addresses.unlink(missing_ok=True)
        arguments = (self._folder / "lake", self._batch, self._world, self.addresses)
        self._process = multiprocessing.get_context("spawn").Process(target=_serve, args=arguments, daemon=True)
        self._process.start()
        until_s = time.monotonic() + START_S
        while not self.addresses.exists():
            if time.monotonic() > until_s or not self._process.is_alive():
                raise DeviceError(f"The devices did not start in {START_S:g} s; run the study again.")
            time.sleep(0.05)

    def kill(self) -> None:
        """SIGKILL: what the world knew is gone, as after a power cut."""
        if self._process is not None:
            self._process.kill()
            self._process.join()


@contextmanager
def open_outside_bench(
    addresses: Path, tell: Callable[[str], None], mounted: Sequence[ProposedTool]
) -> Iterator[Bench]:
    """The bench behind the addresses; a closed gripper is opened by a person, of whom `tell` hears."""
    settings = BenchSettings(**json.loads(addresses.read_text()))
    rack, clock = rack_of(mounted), ScaledClock(SPEED_UP)
    with ExitStack() as stack:
        try:
            bench = stack.enter_context(open_real_bench(settings, rack, clock))
        except InterlockError as closed:
            if "gripper is closed" not in str(closed):
                raise
            tell("person")
            bench = stack.enter_context(open_real_bench(settings, rack, clock, may_vent=True))
        yield bench


def _serve(root: Path, batch: Batch, world: World, addresses: Path) -> None:
    campaign = batch.open(root)
    rack = rack_of(campaign.state().tools_of(1))
    campaign.lake.close()
    with open_virtual_servers(world, rack, fingerprint, ScaledClock(SPEED_UP)) as virtual:
        at = asdict(virtual.endpoints) | {"transmitter_serial_port": None}
        figures = {"stale_after_s": None, "pressure_time_out_s": PATIENCE_S, "modbus_time_out_s": 2.0}
        partial_file = addresses.with_suffix(".part")
        partial_file.write_text(json.dumps(at | figures))
        partial_file.rename(addresses)
        while True:
            time.sleep(60.0)
