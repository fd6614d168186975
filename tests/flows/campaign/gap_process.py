"""A campaign with `gap.active` in a process of its own; its search is made up, everything else is real.

Arguments: config, lake, and after how many asked grasps the process kills itself (0: never).
"""

import os
import signal
import sys
from itertools import count
from pathlib import Path
from typing import Any

from fast.flows.campaign import launch
from fast.flows.cli.main import leave
from fast.flows.progress import ProgressReporter
from tests.flows.campaign.made_up_search import search_made_up


def main(config: Path, lake: Path, dies_after: int) -> None:
    """Run the campaign to its end, or to its death."""
    configure = launch.configure_client

    def configure_and_patch(api_url: str, root: Path) -> None:
        configure(api_url, root)
        _patch(dies_after)  # Prefect reads its settings when first imported, so only now

    launch.configure_client = configure_and_patch

    def say(line: str) -> None:
        sys.stdout.write(f"{line}\n")
        sys.stdout.flush()

    launch.run_campaign(config, lake, auto_print=True, reporter=ProgressReporter(say, say))


def _patch(dies_after: int) -> None:
    from fast.flows.campaign import gap_step
    from fast.tasks.bench import mount

    gap_step.search_and_announce = search_made_up
    measure, numbers = mount.measure_asked, count(1)

    def measure_and_die(*words: Any, on_grasp: Any, **more: Any) -> None:
        def hear(tool: Any, grasp: Any) -> None:
            on_grasp(tool, grasp)
            if next(numbers) == dies_after:
                os.kill(os.getpid(), signal.SIGKILL)

        measure(*words, on_grasp=hear, **more)

    mount.measure_asked = measure_and_die


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
    leave(0)
