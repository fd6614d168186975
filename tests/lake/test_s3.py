import pytest

from lake.maintenance import check, compact, stats
from lake.store import Lake
from lake.tables import TABLES, GraspRow, TraceRow
from tests.lake.object_server import BUCKET, READER, ObjectServer


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    server = ObjectServer(tmp_path_factory.mktemp("objects") / "server")
    server.start()
    yield server
    server.kill()


@pytest.fixture
def address(server, tmp_path, monkeypatch):
    for name, value in server.environment().items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return f"s3://{BUCKET}/labs/{tmp_path.name}"


@pytest.fixture
def lake(address):
    return Lake.open(address, create=True)


def peaks(lake: Lake) -> list[float]:
    return sorted(row["peak_force_n"] for row in lake.rows(GraspRow))


def test_rows_and_traces_come_back(lake, address, server, provenance, make_grasp, make_trace, monkeypatch, tmp_path):
    for repeat in range(3):
        lake.append(make_grasp(repeat=repeat, peak_n=10.0 + repeat), provenance)
    assert len(server.keys(address)) == 7
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another machine"))
    there = Lake.open(address)
    assert there.root != lake.root
    assert peaks(there) == peaks(lake) == pytest.approx([10, 11, 12])
    name = make_grasp(repeat=2)[0].grasp_id
    assert there.trace(name).force_n == pytest.approx(make_trace(12.0).force_n)
    assert there.query("SELECT count(*) AS n FROM traces").to_pylist() == [{"n": 3}]
    with there.connect() as connection:
        assert connection.sql("SELECT max(list_max(force_n)) FROM traces").fetchone()[0] == pytest.approx(12)
