"""A campaign in the viewer while it runs: the same recording as afterwards, growing."""

import time
from collections.abc import Callable
from pathlib import Path

import rerun as rr

from flows.report.campaign.content import Content
from flows.viewer.campaign import campaign_blueprint, send_campaign
from flows.viewer.stream import APPLICATION, writable
from lake.store import Lake

POLL_S = 2.0


def follow(
    lake: Lake,
    campaign_id: str,
    path: Path,
    is_running: Callable[[], bool],
    *,
    address: str | None = None,
    tell: Callable[[str], None] | None = None,
    poll_s: float = POLL_S,
) -> int:
    """Write to a file, and to the viewer at `address`, what the campaign measures and proposes, until it ends.

    Looks at the lake every `poll_s`. Ctrl-C ends it too; what was written stays. Returns the number of grasps.

    Raises:
        UsageError: there is no such campaign, or the file cannot be written.
    """
    content = Content.load(lake, campaign_id)
    writable(path)
    sinks: list[rr.FileSink | rr.GrpcSink] = [rr.FileSink(path)]
    if address:
        sinks.append(rr.GrpcSink(address))
    blueprint = campaign_blueprint(content, is_live=True)
    with rr.RecordingStream(APPLICATION, recording_id=f"campaign {campaign_id} live") as stream:
        stream.set_sinks(*sinks, default_blueprint=blueprint)
        stream.log("cell", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        tour = send_campaign(stream, content)
        try:
            is_last = False
            while not is_last:
                is_last = not is_running()  # asked first: what is written until then is still sent
                if tour.update() and tell is not None:
                    tell(f"{tour.n_grasps} grasps of {campaign_id}")
                stream.flush()
                if not is_last:
                    time.sleep(poll_s)
        except KeyboardInterrupt:
            pass
        finally:
            stream.flush()
            stream.disconnect()
    return tour.n_grasps
