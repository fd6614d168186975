"""The first tutorial on the lab's page, as a person follows it, and the pictures of pages that the documents show."""

import re
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image

from fast.lake.store import Lake
from fast.tasks.bench.live import live_path, read_live
from tests.flows.page.served import open_browser, say_name
from tests.studies.benchmarks.base import Options, Tables
from tests.studies.platform.page_story import LIMIT_S, Story

SIZES = {  # px, of docs/images
    "page-start": (1200, 1150),
    "page-todo": (390, 1000),
    "page-now": (1000, 1120),
    "report": (1200, 1050),
}
WIDTH_PX = SIZES["page-start"][0]
_COLOURS = 128
_GRASPS = 35  # measured before the picture of Now: the middle of the second batch
_LIFT_MM = (20.0, 40.0)  # of the grasp in that picture
_LIFT_PAUSE_S = 0.02  # between looks at it: a virtual bench lifts in a second


def measure_pictures(options: Options) -> Tables:
    """The first tutorial goes as it says; --figure docs/images takes the pictures of pages anew."""
    with tempfile.TemporaryDirectory(prefix="fast-pictures-") as folder:
        tutorial = Tutorial(Path(folder), WIDTH_PX, options.figure, options.tell)
        tutorial.tell_all()
    return {"pictures": tutorial.steps}


class Tutorial(Story):
    """The steps of docs/tutorial/first-campaign.md in one browser; pauses, which `page-story` has, are left out."""

    def tell_all(self) -> None:
        """All steps, in order; each raises when the page does not do what the tutorial says."""
        with self._serving() as address, open_browser(address, self._width) as page:
            page.set_default_timeout(1000 * LIMIT_S)
            say_name(page, "Ada")
            self._open(page, "Start")
            page.wait_for_selector("#checked:has-text('12 tools in 3 stages, 96 grasps')")
            self._picture(page, "page-start")
            page.click("button:has-text('Start the campaign')")
            page.wait_for_selector("#word:has-text('waiting')")
            page.wait_for_selector("#n-todos:has-text('1')")
            self._step("started", page.inner_text("#strip"))
            self._confirm(page, "B01")
            self._confirm(page, "B02")
            self._watch_force(page)
            self._confirm(page, "B03")
            self._open(page, "Now")
            page.wait_for_selector("#word:has-text('complete')")
            self._see_result(page)

    def _confirm(self, page: Any, batch: str) -> None:
        """Say that a batch is printed; of the first one T3 is torn, and the walls of T0 are measured."""
        form = f"form[aria-label='Batch quick/{batch}']"
        self._open(page, "To do")
        page.wait_for_selector(form)
        said = "4 tools mounted, 0 rejected"
        if batch == "B01":
            self._wait_for_sheet(page)
            self._picture(page, "page-todo")
            page.check("input[name='fate-3'][value='rejected']")
            page.fill("input[name='reason-3']", "torn tip")
            page.locator("summary").first.click()
            page.fill("input[name='front-0']", "2,21")
            page.fill("input[name='back-0']", "2,84")
            said = "3 tools mounted, 1 rejected"
        page.click(f"{form} button:has-text('Printed and mounted')")
        page.wait_for_selector(f"#said:has-text('{said}')")
        self._step(f"{batch} confirmed", page.inner_text("#said"))

    def _wait_for_sheet(self, page: Any) -> None:
        self._wait(lambda: any(self._lake.glob("outputs/quick/B01-print/*.html")), "the sheet of B01")
        page.reload()

    def _watch_force(self, page: Any) -> None:
        self._open(page, "Now")
        path = live_path(Lake.open(self._lake), "quick")
        self._wait(lambda: int(re.findall(r"(\d+)/88", page.inner_text(".facts"))[0]) >= _GRASPS, "half of B02")
        self._size(page, "page-now")
        self._wait(lambda: _LIFT_MM[0] < _find_lift_mm(path) < _LIFT_MM[1], "the middle of a grasp", _LIFT_PAUSE_S)
        self._picture(page, "page-now")
        self._step("the force moves", page.inner_text("#live-title") + ", " + page.inner_text("#live-force"))

    def _see_result(self, page: Any) -> None:
        self._open(page, "Results")
        page.wait_for_selector("a:has-text('quick/B03T0')")
        page.goto(page.locator("td a:text-is('report')").first.evaluate("one => one.href"))
        self._picture(page, "report")
        self._step("result", page.inner_text("h1"))

    def _size(self, page: Any, name: str) -> None:
        """Make the window as large as a picture, if it is not; drawn anew, it has a moment to settle."""
        size = {"width": SIZES[name][0], "height": SIZES[name][1]}
        if page.viewport_size != size:
            page.set_viewport_size(size)
            page.wait_for_timeout(500)

    def _picture(self, page: Any, name: str) -> None:
        """Take a picture at the size of its kind, in few colours."""
        self._size(page, name)
        if self._pictures is not None:
            path = self._pictures / f"{name}.png"
            page.screenshot(path=path)
            Image.open(path).convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
        page.set_viewport_size({"width": self._width, "height": 900})


def _find_lift_mm(path: Path) -> float:
    """Find how far the present grasp is; 0 before it lifts."""
    found = read_live(path)
    return float(found.lift_mm[-1]) if found is not None and found.lift_mm else 0.0
