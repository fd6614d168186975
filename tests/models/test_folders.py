"""Where the folders of a person are."""

import os
from pathlib import Path

from fast.models.folders import folder_of_person


def test_a_folder_is_named_by_a_variable_or_lies_in_the_home(monkeypatch):
    monkeypatch.setenv("HOME", "/home/ada")
    monkeypatch.setenv("XDG_CACHE_HOME", "/fast/disk")
    assert folder_of_person("XDG_CACHE_HOME", ".cache") == Path("/fast/disk")
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert folder_of_person("XDG_CACHE_HOME", ".cache") == Path("/home/ada/.cache")


def test_a_user_without_a_home_has_a_folder_that_cannot_be_made(monkeypatch):
    monkeypatch.delenv("HOME")
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 54321)  # whom no system knows
    assert folder_of_person("XDG_CACHE_HOME", ".cache") == Path(os.devnull, ".cache")
