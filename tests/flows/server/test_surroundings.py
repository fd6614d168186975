"""What a machine must grant is looked at before anything is written."""

import resource
import subprocess
import sys

import pytest

from fast.flows.server import surroundings
from fast.flows.server.surroundings import check_loopback, check_surroundings
from fast.models.errors import UsageError


@pytest.fixture(autouse=True)
def _no_settings(monkeypatch):
    monkeypatch.delenv("FAST_PREFECT_API_URL", raising=False)


def test_few_open_files_are_refused_or_more_are_taken():
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_NOFILE, (64, int(sys.argv[1])));"
        "from fast.flows.server.surroundings import check_surroundings; check_surroundings();"
        "print(resource.getrlimit(resource.RLIMIT_NOFILE)[0])"
    )
    refused, taken = (
        subprocess.run([sys.executable, "-c", code, allowed], capture_output=True, text=True, check=False)
        for allowed in ("64", "200")
    )
    assert "UsageError: this process may have 64 open files at once, at least 128 are needed" in refused.stderr
    assert taken.stdout == "128\n", taken.stderr


def test_a_machine_on_which_programs_do_not_reach_each_other_is_refused(monkeypatch):
    assert check_loopback() > 0
    monkeypatch.setattr(surroundings, "LOOPBACK", "203.0.113.1")  # an address of nobody
    with pytest.raises(UsageError, match=r"programs on this machine cannot reach each other at 203\.0\.113\.1"):
        check_surroundings()


@pytest.mark.parametrize(
    ("name", "value", "problem"),
    [
        ("FAST_PREFECT_LOGGING_LEVEL", "nonsense", "Input should be 'DEBUG', 'INFO'"),
        ("FAST_PREFECT_LOGGIN_LEVEL", "INFO", "is no setting of Prefect; correct it or unset it"),
    ],
)
def test_a_setting_of_no_use_to_prefect_is_named(name, value, problem, monkeypatch):
    monkeypatch.setenv("FAST_PREFECT_CLIENT_MAX_RETRIES", "3")
    monkeypatch.setenv(name, value)
    with pytest.raises(UsageError, match=f"{name} is `{value}`: {problem}"):
        check_surroundings()


def test_settings_that_prefect_knows_are_taken(monkeypatch):
    monkeypatch.setenv("FAST_PREFECT_LOGGING_LEVEL", "DEBUG")
    monkeypatch.setenv("PREFECT_LOGGING_LEVEL", "nonsense")
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)
    check_surroundings()
    assert resource.getrlimit(resource.RLIMIT_NOFILE) == limit
