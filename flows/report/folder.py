"""The folder a report is written to: figures, data and the page."""

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pyarrow as pa
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from fast.flows.report.campaign.queries import Result
from fast.flows.report.style import figure_style, save_svg
from fast.lake.query.sql import csv_bytes
from fast.lake.storage.files import discard
from fast.models.errors import FastError, UsageError, describe_cause
from fast.tasks.templates import render

_LOG = logging.getLogger(__name__)
PRINT_DPI = 200


class Folder:
    """Writes the figures and data of a page; `written` names the figures and queries."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.written: list[str] = []
        self._places: dict[str, list[Bbox]] = {}
        try:
            for name in ("figures", "data"):
                (root / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(
                f"The report folder {root} cannot be written ({describe_cause(error)}); give another one."
            ) from error

    def draw(self, name: str, figure: Figure, *, for_print: bool = False, kind: str | None = None) -> str:
        """Save a figure as SVG, and as PNG where it may be printed; returns its address in the page.

        Figures of one kind have the same size, axes and limits. The first is laid out, which is half of the work, and
        the others have their axes where it has them.
        """
        if kind in self._places:
            figure.set_layout_engine("none")
            for axes, place in zip(figure.axes, self._places[kind], strict=True):
                axes.set_position(place)
        if for_print:
            figure.savefig(self.root / "figures" / f"{name}.png", dpi=PRINT_DPI, metadata={"Software": "FAST"})
        save_svg(figure, self.root / "figures" / f"{name}.svg")
        if kind is not None:
            self._places.setdefault(kind, [axes.get_position() for axes in figure.axes])
        self.written.append(name)
        return f"figures/{name}.svg"

    def numbers(self, name: str, rows: Sequence[Mapping[str, Any]]) -> None:
        """Save rows that no query gives as CSV; a page links them with `numbers`."""
        (self.root / "data" / f"{name}.csv").write_bytes(csv_bytes(pa.Table.from_pylist(list(rows))))

    def image(self, name: str, rgba: np.ndarray) -> str:
        """Save an RGBA image as PNG; returns its address in the page."""
        path = self.root / "figures" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        matplotlib.image.imsave(path, rgba, metadata={"Software": "FAST"})
        return f"figures/{name}.png"

    def save(self, *results: Result) -> list[Result]:
        """Save results as CSV next to their SQL; a page shows them as `sources`."""
        for result in results:
            self.written.append(result.name)
            (self.root / "data" / f"{result.name}.csv").write_bytes(csv_bytes(result.table))
            (self.root / "data" / f"{result.name}.sql").write_text(result.sql + "\n", encoding="utf-8")
        return list(results)


def write_page(
    folder: Folder, template: str, prepare: Callable[[Folder], Mapping[str, object]], file: str = "index.html"
) -> Path:
    """Write the page of a template into the folder; `prepare` draws its figures and gives its values.

    Returns the path of the page.

    Raises:
        FastError: the disk is full or broken; a page that was there before is as it was.
    """
    path = folder.root / file
    staged = path.with_name(f".{path.name}.writing")
    try:
        with figure_style():
            values = prepare(folder)
        staged.write_text(render(template, **values), encoding="utf-8")
        os.replace(staged, path)
    except OSError as error:
        discard([staged])
        raise FastError(
            f"The report in {folder.root} could not be written ({error.strerror}); no row of the lake is lost: free "
            "disk space or repair the disk, then run the same command again."
        ) from error
    _LOG.info("page written to %s", path)
    return path
