"""The folder a report is written to: figures, data and the page."""

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import matplotlib.image
import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure

from fast.flows.report.campaign.queries import Result
from fast.flows.report.html import Markup, Page, document, picture, sources
from fast.flows.report.style import figure_style, save_svg
from fast.lake.query.sql import csv_bytes
from fast.lake.storage.files import discard
from fast.models.errors import FastError, UsageError

_LOG = logging.getLogger(__name__)
PRINT_DPI = 200


class Folder:
    """Writes the parts of a report and returns the HTML that shows them; `written` names the figures and queries."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.written: list[str] = []
        try:
            for name in ("figures", "data"):
                (root / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"The report folder {root} cannot be written ({error}); give another one.") from error

    def figure(self, name: str, figure: Figure, alternative: str, caption: object = "") -> Markup:
        """Save a figure as SVG and show it."""
        save_svg(figure, self.root / "figures" / f"{name}.svg")
        self.written.append(name)
        return picture(f"figures/{name}.svg", alternative, caption)

    def print_figure(self, name: str, figure: Figure, alternative: str, caption: object = "") -> Markup:
        """Like `figure`, and save it as PNG for print too."""
        figure.savefig(self.root / "figures" / f"{name}.png", dpi=PRINT_DPI, metadata={"Software": "FAST"})
        return self.figure(name, figure, alternative, caption)

    def numbers(self, name: str, rows: Sequence[Mapping[str, Any]]) -> Markup:
        """Save rows that no query gives as CSV, and link them."""
        (self.root / "data" / f"{name}.csv").write_bytes(csv_bytes(pa.Table.from_pylist(list(rows))))
        return Markup(f'<p class="note">The numbers: <a href="data/{name}.csv">data/{name}.csv</a></p>')

    def image(self, name: str, rgba: np.ndarray) -> str:
        """Save an RGBA image as PNG; returns its address in the page."""
        path = self.root / "figures" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        matplotlib.image.imsave(path, rgba, metadata={"Software": "FAST"})
        return f"figures/{name}.png"

    def sources(self, *results: Result) -> Markup:
        """Save results as CSV next to their SQL, and show both."""
        for result in results:
            self.written.append(result.name)
            (self.root / "data" / f"{result.name}.csv").write_bytes(csv_bytes(result.table))
            (self.root / "data" / f"{result.name}.sql").write_text(result.sql + "\n", encoding="utf-8")
        return sources(*results)


C = TypeVar("C")


def write_page(
    folder: Folder,
    content: C,
    page: Page,
    headline: Callable[[C], Markup],
    sections: Sequence[Callable[[C, Folder], Markup]],
) -> Path:
    """Build the sections in their order and the headline above them, and write the page; returns its path.

    Raises:
        FastError: the disk is full or broken; a page that was there before is as it was.
    """
    path = folder.root / page.file
    staged = path.with_name(f".{path.name}.writing")
    try:
        with figure_style():
            body = "".join(build(content, folder) for build in sections)
            top = headline(content)
        staged.write_text(document(page, top, body), encoding="utf-8")
        os.replace(staged, path)
    except OSError as error:
        discard([staged])
        raise FastError(
            f"The report in {folder.root} could not be written ({error.strerror}); no row of the lake is lost: free "
            "disk space or repair the disk, then run the same command again."
        ) from error
    _LOG.info("%s: page written to %s", page.kicker, path)
    return path
