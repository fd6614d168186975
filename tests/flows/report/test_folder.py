"""A page is written whole or not at all, and a full disk is told in one sentence."""

import errno
from pathlib import Path

import pytest

from fast.flows.report.folder import Folder, write_page
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
