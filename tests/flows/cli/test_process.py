"""What only a process of its own shows: exit statuses, start-up cost, imports, Ctrl-C, help."""

import json
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from flows.cli.main import app, run
from tasks.simulation.pool import WorkerPool
from tests.flows.cli.cli_lakes import ROOT, WORLD, proposed_lake, write_config

FAST = [sys.executable, "-m", "flows.cli.main"]
HEAVY = ("torch", "prefect", "pymc", "botorch", "matplotlib", "duckdb", "pyarrow", "rerun", "numpy", "pydantic")
MODELLING = ("torch", "prefect", "pymc", "botorch", "matplotlib", "scipy", "numba", "rerun")
COMMANDS = [
    "bench list", "bench run", "calibrate", "campaign abort", "campaign list", "campaign pause", "campaign run",
    "campaign status", "campaign stop", "compare", "doctor", "features", "gap", "gantry diagnose", "gantry faults",
    "gantry grasp", "gantry home", "gantry log", "gantry park", "gantry plan", "gantry replay", "gantry tare",
    "gantry tool", "lake check", "lake compact", "lake export", "lake import", "lake lineage", "lake stats",
    "print confirm", "print sheet", "report", "serve", "simulate", "sql", "view", "virtual start",
]  # fmt: skip


def cpu_s(*words: str, **options) -> tuple[float, "subprocess.CompletedProcess[str]"]:
    """CPU seconds of a command, and how it ended."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, timeout=120, **options)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, done


def cheapest(*words: str, **options) -> float:
    """The lower of two measurements: the first may have to compile."""
    return min(cpu_s(*words, **options)[0] for _ in range(2))


def test_help_is_quick():
    assert cheapest(*FAST, "--help") < 0.5


def test_status_takes_little_more_than_its_libraries(tmp_path):
    words = ["campaign", "status", "--lake", str(proposed_lake(tmp_path))]
    libraries = cheapest(sys.executable, "-c", "import cyclopts, duckdb, numpy, pandas, pyarrow.dataset, pydantic")
    assert cheapest(*FAST, *words) < 3.2 * libraries


def test_status_imports_only_what_reads_the_lake(tmp_path):
    words = ["campaign", "status", "--lake", str(proposed_lake(tmp_path))]
    code = (
        f"import sys; from flows.cli.main import run; run({words}); print([m for m in {MODELLING} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.stdout.splitlines()[-1] == "[]", done.stderr


def test_the_command_line_imports_nothing_heavy():
    names = ["flows.cli", *(f"flows.cli.{path.stem}" for path in sorted((ROOT / "flows" / "cli").glob("[a-z]*.py")))]
    code = f"import sys, {', '.join(names)}; print([m for m in {HEAVY} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout.strip()) == (0, "[]"), done.stderr


def leaves(found, path=()):
    for name in found:
        if name.startswith("-"):
            continue
        child = found[name]
        if child.default_command is None:
            yield from leaves(child, (*path, name))
        else:
            yield " ".join((*path, name)), child


def test_every_command_is_known_here():
    assert sorted(name for name, _ in leaves(app)) == sorted(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_explains_every_parameter(name):
    command = dict(leaves(app))[name]
    arguments = command.assemble_argument_collection()
    # `*` is a group of options without a name; each of its options is an argument of its own here.
    named = [argument for argument in arguments if argument.name != "*"]
    unexplained = [argument.name for argument in named if not argument.parameter.help]
    assert unexplained == []
    assert "--json" in {argument.name for argument in arguments}
    assert run([*name.split(), "--help"]) == 0


def test_exit_statuses(tmp_path):
    assert cpu_s(*FAST, "sql", "SELECT 1", "--lake", str(proposed_lake(tmp_path)))[1].returncode == 0
    wrong = cpu_s(*FAST, "campaign", "run", str(tmp_path / "none.toml"), "--lake", str(tmp_path / "new"))[1]
    assert wrong.returncode == 2
    assert (
        wrong.stderr == f"fast: campaign config `{tmp_path}/none.toml` does not exist; give the path of a TOML file.\n"
    )
    assert wrong.stdout == ""


def test_a_bug_exits_with_1(tmp_path):
    lake = proposed_lake(tmp_path)
    code = (
        "import flows.campaign.status as s; s.read_status = lambda *a: 1 / 0\nfrom flows.cli.main import main; main()"
    )
    words = ["campaign", "list", "--lake", str(lake)]
    done = subprocess.run([sys.executable, "-c", code, *words], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert "ZeroDivisionError" in done.stderr


BLOCKED = """
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == {package!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Blocker())
from flows.cli.main import main
main()
"""


@pytest.mark.parametrize(
    ("package", "called", "words"),
    [
        ("duckdb", "duckdb", ["sql", "SELECT 1", "--lake", "LAKE"]),
        ("numba", "numba", ["simulate", "--object", "2"]),
        ("serial", "pyserial", ["gantry", "home", "--world", str(WORLD)]),
        ("rerun", "rerun-sdk", ["view", "quick", "--save", "LAKE.rrd", "--lake", "LAKE"]),
        ("prefect", "prefect", ["campaign", "run", "CONFIG", "--lake", "NEW"]),
    ],
)
def test_a_missing_package_is_one_sentence(tmp_path, package, called, words):
    lake = proposed_lake(tmp_path)
    places = {"LAKE": lake, "LAKE.rrd": tmp_path / "x.rrd", "CONFIG": write_config(tmp_path), "NEW": tmp_path / "new"}
    given = [str(places.get(word, word)) for word in words]
    code = BLOCKED.format(package=package)
    done = subprocess.run([sys.executable, "-c", code, *given], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(f"fast: the package `{called}` is not installed; run `make setup`")
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "new").exists()
    assert not (tmp_path / "x.rrd").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_virtual_bench_ends_cleanly(number):
    command = [*FAST, "virtual", "start", str(WORLD), "--json"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as bench:
        addresses = json.loads(bench.stdout.readline())
        assert Path(addresses["serial_port"]).exists()
        bench.send_signal(number)
        _, err = bench.communicate(timeout=60)
    assert (bench.returncode, err) == (0, "")


def test_ctrl_c_is_one_sentence():
    code = "import os, signal, models.simulation.grasp as g\n" \
           "g.simulate_grasp = lambda *a, **k: os.kill(os.getpid(), signal.SIGINT)\n" \
           "from flows.cli.main import main\nmain()"  # fmt: skip
    command = [sys.executable, "-c", code, "simulate", "--object", "2"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 130
    assert done.stderr == "fast: interrupted; what was finished is in the lake.\n"


def test_a_reader_that_goes_away_is_no_bug(tmp_path):
    lake = proposed_lake(tmp_path)
    command = (
        f"{sys.executable} -m flows.cli.main sql 'SELECT * FROM range(200000)' --format csv --lake {lake} | head -1"
    )
    done = subprocess.run(command, shell=True, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.stdout == '"range"\n'
    assert "Traceback" not in done.stderr


def test_workers_leave_ctrl_c_to_their_parent():
    pool = WorkerPool(1)
    try:
        assert pool.call(signal.getsignal, signal.SIGINT) == signal.SIG_IGN
    finally:
        pool.close()
