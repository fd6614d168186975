"""Settings for another Prefect, proxies and files of the working folder do not reach what FAST starts."""

import tempfile
from pathlib import Path

import httpx
import pytest

from fast.flows.server.access import Api
from fast.flows.server.environment import list_ignored, make_environment, named_server
from fast.flows.server.loopback import settle
from tests.studies.platform.environment_list import COMPUTER_OF_OTHERS, CONTAINER
from tests.studies.platform.environments import judge

OTHERS = {
    "PREFECT_API_URL": "http://127.0.0.1:9/api",
    "PREFECT_API_KEY": "pnu_other",
    "PREFECT_API_AUTH_STRING": "a:b",
    "PREFECT_SERVER_API_AUTH_STRING": "a:b",
    "PREFECT_PROFILE": "other",
    "PREFECT_SERVER_DATABASE_CONNECTION_URL": "sqlite+aiosqlite:////nowhere/x.db",
    "PREFECT_LOGGING_LEVEL": "nonsense",
    "PREFECT_TASK_DEFAULT_RETRIES": "x",
}


def test_settings_for_another_prefect_are_left_aside_and_those_for_fast_are_taken(tmp_path):
    mine = {"FAST_PREFECT_LOGGING_LEVEL": "DEBUG", "HOME": "ada"}
    api = Api("http://127.0.0.1:4200/api", "fast:key")
    found = make_environment(api, tmp_path, OTHERS | mine)
    assert found["PREFECT_API_URL"] == api.url
    assert found["PREFECT_API_AUTH_STRING"] == "fast:key"
    assert found["PREFECT_LOGGING_LEVEL"] == "DEBUG"
    assert found["HOME"] == "ada"
    left = {name: value for name, value in OTHERS.items() if found.get(name) == value}
    assert left == {}
    assert list_ignored(OTHERS | mine) == sorted(OTHERS)


def test_a_server_is_named_by_one_setting(monkeypatch):
    monkeypatch.setenv("PREFECT_API_URL", "http://127.0.0.1:9/api")
    monkeypatch.delenv("FAST_PREFECT_API_URL", raising=False)
    assert named_server() is None
    monkeypatch.setenv("FAST_PREFECT_API_URL", "http://127.0.0.1:8/api/")
    monkeypatch.setenv("FAST_PREFECT_API_AUTH_STRING", "a:b")
    assert named_server() == Api("http://127.0.0.1:8/api", "a:b")


def test_this_machine_is_asked_without_a_proxy_and_others_as_before():
    environment = {"NO_PROXY": "lab.example, localhost"}
    settle(environment)
    assert environment["NO_PROXY"] == "lab.example,localhost,127.0.0.1,::1"
    assert environment["no_proxy"] == "127.0.0.1,localhost,::1"


def test_a_client_of_this_machine_is_made_where_a_proxy_of_socks_is_set(monkeypatch):
    monkeypatch.setenv("ALL_PROXY", "socks5://127.0.0.1:9")
    with httpx.Client() as client:
        assert client.trust_env


def test_certificates_that_are_not_there_are_not_looked_for(tmp_path):
    environment = {"SSL_CERT_FILE": "/nowhere.pem", "SSL_CERT_DIR": str(tmp_path)}
    settle(environment)
    assert {name: value for name, value in environment.items() if name.startswith("SSL")} == {
        "SSL_CERT_DIR": str(tmp_path)
    }


def test_a_user_without_name_and_home_gets_one_that_nobody_else_writes(monkeypatch, tmp_path):
    environment = {"HOME": "somewhere"}
    settle(environment)
    assert environment["HOME"] == "somewhere"
    monkeypatch.setattr(Path, "home", _find_no_home)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    settle(environment)
    usual = Path(environment["HOME"])
    settle(environment)
    assert environment["HOME"] == str(usual)  # what is compiled there is found again
    usual.chmod(0o777)
    settle(environment)
    assert environment["HOME"] != str(usual)
    assert Path(environment["HOME"]).stat().st_mode & 0o077 == 0


def _find_no_home():
    raise RuntimeError("Could not determine home directory.")


# A campaign that is killed on the one and continued on the other runs each time (`test_campaign`).
@pytest.mark.study
@pytest.mark.parametrize("environment", [COMPUTER_OF_OTHERS, CONTAINER], ids=lambda environment: environment.name)
def test_a_campaign_runs_on_a_machine_that_is_not_ours(environment, tmp_path):
    assert judge(environment, tmp_path).problem == ""
