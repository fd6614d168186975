"""What only a process of its own shows: exit statuses, start-up cost, imports, Ctrl-C, help."""

import json
import os
import resource
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fast.flows.cli.main import app, run
from fast.lake.store import Lake
from fast.tasks.simulation.pool import WorkerPool
from tests.flows.cli.cli_lakes import ROOT, WORLD, leaves, proposed_lake, write_config

FAST = ["-m", "fast.flows.cli.main"]
HEAVY = ("torch", "prefect", "pymc", "botorch", "matplotlib", "duckdb", "pyarrow", "rerun", "numpy", "pydantic")
MODELLING = ("torch", "prefect", "pymc", "botorch", "matplotlib", "scipy", "numba", "rerun")
COMMANDS = [
    "ask", "calibrate", "campaign abort", "campaign answer", "campaign leave-out", "campaign list", "campaign pause",
    "campaign run", "campaign status", "campaign stop", "challenge grade", "challenge make", "challenge start",
    "compare", "doctor", "features",
    "gantry faults", "gantry grasp", "gantry home", "gantry lend", "gantry log", "gantry park", "gantry plan",
    "gantry replay", "gantry tare", "gantry tool", "gap", "gap answer", "gap next", "gap plan", "init", "lake check",
    "lake compact", "lake export", "lake import", "lake labs", "lake lineage", "lake publish", "lake stats", "mcp",
    "objects add", "objects check", "objects draw", "objects list", "objects print", "print confirm",
    "print measured", "print mounted", "print sheet", "report", "serve", "simulate", "sql", "tell", "view",
    "virtual arm", "virtual start",
]  # fmt: skip


def python(code: str, *words: object) -> "subprocess.CompletedProcess[str]":
    """What a program did in a process of its own."""
    command = [sys.executable, "-c", code, *map(str, words)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)


def cpu_s(*words: object) -> float:
    """CPU seconds of a program that succeeds."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert (
        subprocess.run([sys.executable, *map(str, words)], cwd=ROOT, capture_output=True, timeout=120).returncode == 0
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def test_help_costs_little_more_than_the_parser():
    """The lower of two measurements each: the first may have to compile."""
    parser, help_ = (min(cpu_s(*words) for _ in range(2)) for words in (["-c", "import cyclopts"], [*FAST, "--help"]))
    assert help_ < 4 * parser


MEASURED_STATUS = """
import json, sys, time
import cyclopts, duckdb, numpy, pandas, pyarrow.dataset, pydantic
libraries_s = time.process_time()
from fast.flows.cli.main import run
status = run(sys.argv[1:])
print(json.dumps([status, libraries_s, time.process_time(), sorted(sys.modules)]))
"""


def test_status_costs_little_more_than_the_libraries_that_read_a_lake(tmp_path):
    done = python(MEASURED_STATUS, "campaign", "status", "--lake", proposed_lake(tmp_path))
    status, libraries_s, all_s, modules = json.loads(done.stdout.splitlines()[-1])
    assert status == 0, done.stderr
    assert [name for name in MODELLING if name in modules] == []
    assert all_s < 3.2 * libraries_s


DEFAULT_RULE = """
import sys
import numpy as np
import fast.flows.campaign.flow
from fast.flows.cli.main import run
from fast.models.scientist.propose import NO_PENDING, propose
from fast.models.scientist.surrogate.fit import fit_surrogate
from tests.studies.benchmarks.scientist import made_up_data
assert run(["sql", "SELECT 1", "--lake", sys.argv[1]]) == 0
assert len(propose(fit_surrogate(made_up_data(5, 5)), 1, 2, NO_PENDING, np.random.default_rng(0))) == 2
print("torch" in sys.modules)
"""


def test_neither_queries_nor_campaigns_with_the_default_rule_import_torch(tmp_path):
    done = python(DEFAULT_RULE, proposed_lake(tmp_path))
    assert (done.returncode, done.stdout.split()[-1]) == (0, "False"), done.stderr


def test_the_command_line_imports_nothing_heavy():
    names = [
        "fast.flows.cli",
        *(f"fast.flows.cli.{path.stem}" for path in sorted((ROOT / "flows" / "cli").glob("[a-z]*.py"))),
    ]
    code = f"import sys, {', '.join(names)}; print([m for m in {HEAVY} if m in sys.modules])"
    done = python(code)
    assert (done.returncode, done.stdout.strip()) == (0, "[]"), done.stderr


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
    # What `fast mcp` says is JSON for programs, always.
    assert name == "mcp" or "--json" in {argument.name for argument in arguments}
    assert run([*name.split(), "--help"]) == 0


def test_wrong_use_exits_with_2(tmp_path):
    words = ["campaign", "run", tmp_path / "none.toml", "--lake", tmp_path / "new"]
    wrong = python("from fast.flows.cli.main import main; main()", *words)
    assert wrong.returncode == 2
    assert (
        wrong.stderr == f"fast: campaign config `{tmp_path}/none.toml` does not exist; give the path of a TOML file.\n"
    )
    assert wrong.stdout == ""


def test_a_bug_exits_with_1(tmp_path):
    code = """
import fast.flows.campaign.status as s; s.read_status = lambda *a: 1 / 0
from fast.flows.cli.main import main; main()
"""
    done = python(code, "campaign", "list", "--lake", proposed_lake(tmp_path))
    assert done.returncode == 1
    assert "ZeroDivisionError" in done.stderr


# One package after the other cannot be found; nothing that was looked for is imported before.
BLOCKED = """
import contextlib, io, json, sys

class Blocker:
    package = ""
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == self.package:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Blocker())
from fast.flows.cli.main import run
for package, _, words in json.loads(sys.argv[1]):
    assert package not in sys.modules, f"{package} was imported by another command"
    Blocker.package = package
    with contextlib.redirect_stderr(io.StringIO()) as said:
        status = run(words)
    print(json.dumps([status, said.getvalue()]))
"""


def test_a_missing_package_is_one_sentence(tmp_path):
    lake, recording, new = proposed_lake(tmp_path), tmp_path / "x.rrd", tmp_path / "new"
    cases = [
        ("duckdb", "duckdb", ["sql", "SELECT 1", "--lake", lake]),
        ("numba", "numba", ["simulate", "--object", "2"]),
        ("serial", "pyserial", ["gantry", "home", "--world", WORLD]),
        ("rerun", "rerun-sdk", ["view", "quick", "--save", recording, "--lake", lake]),
        ("prefect", "prefect", ["campaign", "run", write_config(tmp_path), "--lake", new]),
    ]
    done = python(BLOCKED, json.dumps(cases, default=str))
    assert done.returncode == 0, done.stderr
    for (_, called, _), line in zip(cases, done.stdout.splitlines(), strict=True):
        status, said = json.loads(line)
        assert status == 2
        assert said.startswith(f"fast: the package `{called}` is not installed; run `make setup`")
        assert len(said.splitlines()) == 1
    assert not new.exists()
    assert not recording.exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_virtual_bench_ends_cleanly(number):
    command = [sys.executable, *FAST, "virtual", "start", str(WORLD), "--json"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as bench:
        addresses = json.loads(bench.stdout.readline())
        assert Path(addresses["serial_port"]).exists()
        bench.send_signal(number)
        _, err = bench.communicate(timeout=60)
    assert (bench.returncode, err) == (0, "")


def test_ctrl_c_is_one_sentence():
    code = "import os, signal, fast.models.simulation.grasp as g\n" \
           "g.simulate_grasp = lambda *a, **k: os.kill(os.getpid(), signal.SIGINT)\n" \
           "from fast.flows.cli.main import main\nmain()"  # fmt: skip
    done = python(code, "simulate", "--object", "2")
    assert done.returncode == 130
    assert done.stderr == "fast: interrupted; what was finished is in the lake: give the same command to go on.\n"


def test_sigterm_ends_a_search_as_ctrl_c_does(tmp_path):
    code = "import os, signal, fast.flows.gap.search as s\n" \
           "s.run_gap = lambda *a: os.kill(os.getpid(), signal.SIGTERM)\n" \
           "from fast.flows.cli.main import main\nmain()"  # fmt: skip
    done = python(code, "gap", "--example", "--out", tmp_path / "example")
    assert (done.returncode, done.stderr) == (
        130,
        "fast: interrupted; what was finished is in the lake: give the same command to go on.\n",
    )


CLOSED = """
import os, signal, sys, time
from fast.flows.cli.main import end_with_terminal

def hear(number, frame):
    print("said to a terminal that is gone", flush=True)
    open(sys.argv[1], "a").write("heard ")

signal.signal(signal.SIGTERM, hear)
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # whatever the tests run under
end_with_terminal()
print("ready", flush=True)
for _ in range(3000):  # half a minute, in which it hears the terminal close
    if os.path.exists(sys.argv[1]):
        break
    time.sleep(0.01)
os.kill(os.getpid(), signal.SIGHUP)
"""


def test_a_terminal_that_closes_ends_a_command_once_as_sigterm_does(tmp_path):
    """It killed a campaign in the middle of a motion."""
    ours, theirs = os.openpty()
    heard = tmp_path / "heard.txt"
    command = ["setsid", "--ctty", sys.executable, "-c", CLOSED, str(heard)]
    with subprocess.Popen(command, cwd=ROOT, stdin=theirs, stdout=theirs, stderr=theirs) as child:
        os.close(theirs)
        assert os.read(ours, 100).startswith(b"ready")
        os.close(ours)
        try:
            assert child.wait(60) == 0
        finally:
            child.kill()
    assert heard.read_text() == "heard "


def test_a_command_under_nohup_outlives_its_terminal():
    code = "import os, signal\nfrom fast.flows.cli.main import end_with_terminal\nend_with_terminal()\n" \
           "os.kill(os.getpid(), signal.SIGHUP)\nprint('goes on')"  # fmt: skip
    command = ["nohup", sys.executable, "-c", code]
    assert subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60).stdout == "goes on\n"


def test_a_reader_that_goes_away_is_no_bug(tmp_path):
    lake = proposed_lake(tmp_path)
    sql = "fast.flows.cli.main sql 'SELECT * FROM range(200000)'"
    command = f"set -o pipefail; {sys.executable} -m {sql} --format csv --lake {lake} | head -1"
    done = subprocess.run(["bash", "-c", command], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, '"range"\n', "")
    help_text = f"set -o pipefail; {sys.executable} -m fast.flows.cli.main --help | true"
    done = subprocess.run(["bash", "-c", help_text], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize(
    ("redirected", "status", "said"),
    [
        ("<&- >&- 2>&-", 0, ""),
        (">/dev/full", 1, "fast: no space is left where the output is written; free some, then try again.\n"),
    ],
)
def test_closed_streams_and_a_full_disk_are_no_bugs(redirected, status, said):
    command = ["bash", "-c", f'"$@" {redirected}', "-", sys.executable, *FAST, "objects", "list"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (status, "", said)


@pytest.mark.parametrize(
    ("locale", "shown"),
    [({"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}, "ö"), ({"PYTHONIOENCODING": "ascii"}, r"\xf6")],
)
def test_letters_are_kept_where_a_locale_knows_none(locale, shown, tmp_path):
    Lake.open(tmp_path / "läke", create=True).close()
    command = [sys.executable, *FAST, "sql", "SELECT 'ö' AS letter", "--lake", "läke"]
    strange = os.environ | locale | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=tmp_path, env=strange, capture_output=True, encoding="utf-8", timeout=120)
    assert (done.stdout, done.stderr) == (f"letter\n------\n{shown}\n", "")


def test_workers_leave_ctrl_c_to_their_parent():
    pool = WorkerPool(1)
    try:
        assert pool.call(signal.getsignal, signal.SIGINT) == signal.SIG_IGN
    finally:
        pool.close()
