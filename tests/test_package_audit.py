"""The offline audit of packages: pins, versions, strangers, changed files."""

from importlib.metadata import distribution, version

from fast.flows.dependencies import LOCK, read_lock
from tests.package_audit import changed_files, findings


def test_the_lock_pins_every_package_exactly():
    pins, loose = read_lock(LOCK.read_text())
    assert loose == []
    assert len(pins) > 100
    assert pins["prefect"] == "3.8.8"


def test_what_differs_from_the_lock_is_said():
    said = "\n".join(findings("pydantic==0.0.1\nnosuch-package==1.0\nnumpy>=1\n"))
    assert f"pydantic is {version('pydantic')}, the lock says 0.0.1; run `make clean setup`" in said
    assert "nosuch-package 1.0 is locked but not installed" in said
    assert "`numpy>=1` of the lock is no exact pin" in said
    assert "pytest" in said  # installed, not in this lock


def test_a_changed_file_is_found(tmp_path):
    found = distribution("cyclopts")
    assert list(changed_files(found)) == []
    folder = tmp_path / "made_up-1.0.dist-info"
    folder.mkdir()
    (tmp_path / "made_up.py").write_text("changed")
    (folder / "METADATA").write_text("Name: made-up\nVersion: 1.0\n")
    (folder / "RECORD").write_text("made_up.py,sha256=47DEQpj8HBSa-_TImW-5JCeuQeRkm5NMpJWZG3hSuFU,0\n")
    changed = list(changed_files(type(found).at(folder)))
    assert changed == ["made_up.py of made-up was changed after its installation; run `make clean setup`."]
