"""Entry point of `fast`: the table of commands, and one sentence for every expected error."""

import atexit
import errno
import gc
import io
import os
import signal
import sys

from cyclopts import App, Parameter
from cyclopts.exceptions import CycloptsError, MissingArgumentError

from fast.flows.cli.common import drop, make_app
from fast.flows.server.loopback import settle

_STANDARD_ERROR = 2  # the last number of a stream that every process has


def _read_version() -> str:
    from importlib.metadata import version  # a hundredth of a second that other commands do not need

    return version("fast-gripper-lab")


app = make_app(
    name="fast",
    help="FAST: find better soft grippers with simulations, a printer and a bench. New here: `fast init` makes a "
    "folder of examples and says what to run first.",
    help_epilogue="Exit status: 0 done, 1 failed, 2 wrong use (then nothing was written). "
    "`fast COMMAND --help` explains a command.",
    version=_read_version,
    version_flags=["--version"],
    suppress_keyboard_interrupt=False,
    default_parameter=Parameter(json_list=False, json_dict=False),  # a word in brackets is a word; `[]` raised
)
for _name, _target, _help in (
    ("init", "fast.flows.cli.init:init", "Make a project folder: configs, worlds, material data, first commands."),
    ("campaign", "fast.flows.cli.campaign:app", "Start, continue, watch and stop campaigns."),
    ("ask", "fast.flows.cli.told:ask", "Tools to print and grasps to make next, for a bench of your own."),
    ("tell", "fast.flows.cli.told:tell", "Hand in what a bench of your own has measured."),
    ("print", "fast.flows.cli.printing:app", "Files for the printer, and what became of each print."),
    ("simulate", "fast.flows.cli.simulate:simulate", "Simulate one grasp: peak, contact force, work, trace, picture."),
    ("objects", "fast.flows.cli.objects:app", "List, check, draw and print test objects, and add own ones."),
    ("gantry", "fast.flows.cli.gantry:app", "Move the bench by hand: home, park, tare, grasp, faults."),
    ("virtual", "fast.flows.cli.virtual:app", "A virtual bench that stays up."),
    (
        "lake",
        "fast.flows.cli.lake:app",
        "Import, export, check and compact the lake; where its rows come from.",
    ),
    ("sql", "fast.flows.cli.sql:sql", "Ask the lake a question in SQL (read-only)."),
    ("calibrate", "fast.flows.cli.calibrate:calibrate", "Fit stiffness and friction of the simulator to measurements."),
    (
        "compare",
        "fast.flows.cli.compare:compare",
        "Ways to choose the next designs, side by side on the same virtual benches.",
    ),
    (
        "features",
        "fast.flows.cli.features:features",
        "Features of the measured traces; quality, work and stability by object class and batch.",
    ),
    ("gap", "fast.flows.cli.gap:app", "Find where simulation and measurement disagree, name what is missing, add it."),
    (
        "challenge",
        "fast.flows.cli.challenge:app",
        "Test a method of your own: find what made-up benches hide, and be graded.",
    ),
    ("report", "fast.flows.cli.results:report", "Write a campaign's report: figures, tables, data."),
    ("view", "fast.flows.cli.results:view", "Look at a grasp, design or campaign in Rerun."),
    (
        "serve",
        "fast.flows.cli.serve:serve",
        "The lab's page, Prefect's server, a worker and the deployments; prints the addresses.",
    ),
    ("mcp", "fast.flows.cli.serve:mcp", "The lab's page for AI agents: they read, simulate and propose."),
    (
        "doctor",
        "fast.flows.cli.doctor:doctor",
        "Check dependencies, solver, disk and ports; each failure comes with its fix.",
    ),
):
    app.command(_target, name=_name, help=_help)


def main() -> None:
    """Run `fast`; exit status 0 done, 1 failed, 2 wrong use, 130 interrupted."""
    run_and_leave(app)


def run_and_leave(command_line: App) -> None:
    """Run a command line with the process's arguments, and end the process with its exit status."""
    if sys.getfilesystemencoding() != "utf-8" and os.environ.get("PYTHONUTF8") != "1":
        # Names of files would be no text that DuckDB or a table can hold.
        os.environ["PYTHONUTF8"] = "1"
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])
    _open_closed_streams()
    end_with_terminal()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # where it takes ASCII only
    # Several processes work side by side: one thread each, set before numpy is imported.
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    settle(os.environ)
    os.environ["PYTHONSAFEPATH"] = "1"  # else a `random.py` in the working folder is imported by worker processes
    os.environ.setdefault("DO_NOT_TRACK", "1")  # what libraries would report of their use stays here
    gc.set_threshold(50_000)  # imports make many objects and drop few: the default looks through them 300 times
    status = run(None, command_line)
    if "duckdb" in sys.modules:
        leave(status)
    sys.exit(status)


def run(words: list[str] | None, command_line: App = app) -> int:
    """Run the command in `words` (default: the process's arguments); returns the exit status.

    An error that nobody expected (a bug) goes through, with its traceback.
    """
    words = sys.argv[1:] if words is None else list(words)
    if unusable := next(filter(_is_unusable, words), None):
        return _fail(f"the argument {ascii(unusable)} is no text that UTF-8 can say; write it again.", 2)
    try:
        command_line(words, exit_on_error=False, print_error=False, result_action="return_value")
    except CycloptsError as error:
        return _fail(_usage_sentence(error, command_line.name[0]), 2)
    except ModuleNotFoundError as error:
        return _missing(error)
    except KeyboardInterrupt:
        return _fail("interrupted; what was finished is in the lake: give the same command to go on.", 130)
    except BrokenPipeError:
        drop(sys.stdout)
        return 1
    except OSError as error:
        if error.errno == errno.ENOSPC:
            drop(sys.stdout)
            return _fail(
                f"no space is left where {error.filename or 'the output'} is written; free some, then try again.", 1
            )
        if error.errno != errno.ENAMETOOLONG:
            raise
        return _fail(f"a file name is too long ({str(error.filename)[:40]}...); give a shorter one.", 2)
    except SystemExit as asked:
        if isinstance(asked.__context__, BrokenPipeError):  # rich, which prints help: the reader has what it wants
            return 0
        return asked.code if isinstance(asked.code, int) else 1
    except Exception as error:
        from fast.models.errors import FastError

        if not isinstance(error, FastError):
            raise
        return _fail(str(error), error.exit_status)
    return 0


def _is_unusable(word: str) -> bool:
    """Return whether an argument has what no file name, SQL or name may; nearly all are printable, which is quick."""
    if word.isprintable():
        return False
    from fast.models.validation import is_text

    return not is_text(word)


def _usage_sentence(error: CycloptsError, program: str) -> str:
    """Say what cyclopts found wrong, on one line, and where the right use is explained."""
    error.verbose = False
    command = " ".join([program, *(error.command_chain or [])])
    sentence = " ".join(str(error).split())
    if isinstance(error, MissingArgumentError) and error.argument is not None and not error.argument.tokens:
        name = error.argument.name  # a word by its place is written without its name, as the usage line has it
        wanted = name if error.argument.index is None else name.lstrip("-").upper()
        sentence = f"`{command}` needs {wanted}: {error.argument.parameter.help}"
    sentence = sentence.replace("into int", "into a whole number").replace("into float", "into a number")
    return f"{sentence} See `{command} --help`."


def _missing(error: ModuleNotFoundError) -> int:
    from fast.flows.dependencies import OWN, missing_sentence

    name = (error.name or "").partition(".")[0]
    if not name or name in OWN:
        raise error  # a bug of ours, not something to install
    return _fail(missing_sentence([name]), 2)


def _fail(sentence: str, status: int) -> int:
    print(f"fast: {sentence}", file=sys.stderr)
    return status


def _open_closed_streams() -> None:
    """Open the null device where a stream was closed (`>&-`), else the next file that is opened gets its number."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= _STANDARD_ERROR:
        os.set_inheritable(number, True)
    os.close(number)
    sys.stdin = sys.stdin or open(os.devnull)
    sys.stdout = sys.stdout or open(os.devnull, "w")
    sys.stderr = sys.stderr or open(os.devnull, "w")


def end_with_terminal() -> None:
    """Have a terminal or connection that closes (SIGHUP) end the command as SIGTERM does, but for one under `nohup`.

    By itself it would kill the process, in the middle of a motion too. It comes from the shell and from the system, and
    counts once. What is written to the terminal from then on would be an error.
    """
    shown = [number for number in range(_STANDARD_ERROR + 1) if os.isatty(number)]

    def hear(signal_number: int, frame: object) -> None:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        nowhere = os.open(os.devnull, os.O_RDWR)
        for number in shown:
            os.dup2(nowhere, number)
        os.close(nowhere)
        signal.raise_signal(signal.SIGTERM)

    if signal.getsignal(signal.SIGHUP) is signal.SIG_DFL:
        signal.signal(signal.SIGHUP, hear)


def leave(status: int) -> None:
    """End the process without tearing the interpreter down.

    Prefect's service threads live until the end, and DuckDB's binding prints what they hold as leaks. It also saves a
    tenth of a second.
    """
    atexit._run_exitfuncs()  # noqa: SLF001 - there is no public way to run them before os._exit
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


if __name__ == "__main__":
    main()
