"""A page is written whole or not at all, and a full disk is told in one sentence."""

import errno
from pathlib import Path

import pytest

from fast.flows.report.folder import Folder, write_page
from fast.flows.report.style import new_axes
from fast.models.errors import FastError


def page(folder: Path, words: str) -> Path:
    values = {"title": words, "kicker": "K", "footer": "F", "nav": {}}
    return write_page(Folder(folder), "flows/report/page.html.j2", lambda _folder: values)


def test_a_full_disk_is_one_sentence_and_the_page_before_stays(tmp_path, monkeypatch):
    path = page(tmp_path, "first")
    before = path.read_text()

    def refuse(path: Path, *_: object, **__: object) -> int:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", refuse)
        with pytest.raises(FastError, match=r"could not be written \(No space left on device\); no row .* again\.$"):
            page(tmp_path, "second")
    assert path.read_text() == before
    assert "second" in page(tmp_path, "second").read_text()
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["data", "figures", path.name]


def test_figures_of_a_kind_have_their_axes_where_the_first_one_has_them(tmp_path):
    """Labels of the first need room, which the others get too; figures of no kind are laid out each."""
    folder, places = Folder(tmp_path), {}
    for name, kind, label in (("a", "panel", "force (N)\nof a tool"), ("b", "panel", ""), ("c", None, "")):
        figure, axes = new_axes()
        axes.set_ylabel(label)
        folder.draw(name, figure, kind=kind)
        places[name] = axes.get_position().bounds
    assert places["b"] == places["a"]
    assert places["c"][0] < places["a"][0] - 0.02
