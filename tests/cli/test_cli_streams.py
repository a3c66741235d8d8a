"""Stdout of the command holds results only, and a full disk or Ctrl-C ends it with a message."""

import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import textwrap
from importlib.util import find_spec
from pathlib import Path

import pytest
from forks import Case, run_forks
from hostile import install
from places import ROOT
from programs import run_python

from gauge_envs.errors import ResultFileError
from gauge_envs.runs import batch

NAME = "SlopeSlider-2-wood"
CLOSED = ("stdin", "stdout", "stderr", "stdin stdout stderr")

DROPPED = {
    "an error of a library": (
        "try:\n    os.kill(os.getpid(), signal.SIGINT)\nexcept KeyboardInterrupt:\n    raise ImportError('no module')\n"
    ),
    "a callback, twice": (
        "for _ in range(2):\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "    except KeyboardInterrupt:\n"
        "        pass\n"
        "os.write(2, b'it goes on')\n"
    ),
    "an import": (
        "class Finder:\n"
        "    def find_spec(self, *_):\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "try:\n"
        "    import absent\n"
        "except KeyboardInterrupt:\n"
        "    os.write(2, b'it goes on')\n"
    ),
}
"""What a library does with Ctrl-C."""

LISTED = """
import os, signal, sys
from gauge_envs.tools.catalog import listing


def rows(*_, **__):
{}


listing.list_rows = rows
"""
"""A list of experiments in which a library gets Ctrl-C."""

FRAME_OF_THE_COMMAND = r'File ".*gauge_(command\.py|envs/)'


@pytest.fixture(autouse=True, scope="module")
def interrupts_reach_children():
    """A shell starts background jobs with SIGINT ignored, which children would inherit."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


Outcomes = dict[str, subprocess.CompletedProcess[str]]


def environment():
    """Environment of a process that imports this package, and whose output is buffered."""
    kept = {
        name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"
    }
    return {**kept, "PYTHONPATH": str(ROOT)}


@pytest.fixture(scope="module")
def streams_folder(tmp_path_factory):
    return tmp_path_factory.mktemp("streams")


@pytest.fixture(scope="module")
def outcomes(streams_folder):
    """Outcomes of commands with streams of their own, that get Ctrl-C, or with a hostile backend installed.

    A hostile backend answers in a process of its own.
    """
    full = {"stdout": "/dev/full"}
    folder = streams_folder
    site = folder / "site"
    site.mkdir()
    install(site, "talking", "crash")
    hostile = f"sys.path.insert(0, {str(site)!r})"
    engines = ["--backend", "crash", "--backend", "talking"]
    cases = {
        "full: fabrics": Case(["recipe", "fabrics", "--json"], streams=full),
        "full: list": Case(["list", NAME], streams=full),
        "full: run": Case(["run", NAME, "--json"], streams=full),
        "lost: run": Case(
            ["run", NAME, "SlopeSlider-2-metal", "--json"],
            streams={"stdout": "broken pipe", "stderr": "/dev/full"},
        ),
        "pipe": Case(["list", "--json"], streams={"stdout": "broken pipe"}),
        **{
            f"closed: {names}": Case(
                ["list", NAME, "--json"], streams=dict.fromkeys(names.split(), "closed")
            )
            for names in CLOSED
        },
        **{
            f"Ctrl-C: {name}": Case(
                ["list"], before=LISTED.format(textwrap.indent(body, " "))
            )
            for name, body in DROPPED.items()
        },
        "hostile: run": Case(
            ["run", "SlopeSlider-2-plastic", *engines, "--json"], before=hostile
        ),
        "hostile: list": Case(["list", NAME, "--json"], before=hostile),
    }
    return run_forks(cases, folder, environment())


@pytest.mark.parametrize("command", ["run", "list"])
def test_what_engines_print_never_reaches_json(outcomes, command):
    done = outcomes[f"hostile: {command}"]
    ids = {json.loads(line)["id"] for line in done.stdout.splitlines()}
    assert ids == {
        "GAUGE/SlopeSlider-2-plastic" if command == "run" else f"GAUGE/{NAME}"
    }
    assert "a line of the engine" in done.stderr
    assert "a line of C code" in done.stderr


def test_a_run_goes_on_after_an_engine_that_crashes(outcomes):
    done = outcomes["hostile: run"]
    failed, finished = map(json.loads, done.stdout.splitlines())
    assert (failed["outcome"], finished["outcome"]) == ("failed", "finished")
    assert (failed["backend"], finished["backend"]) == ("crash", "talking")
    assert "segmentation fault" in failed["error"]
    assert done.returncode == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("command", ["fabrics", "list", "run"])
def test_a_full_device_is_an_error_without_a_traceback(outcomes, command):
    done = outcomes[f"full: {command}"]
    assert done.returncode == 2
    assert "error: the output cannot be written: No space left on device" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_run_whose_output_is_lost_writes_all_its_results(outcomes, streams_folder):
    assert outcomes["lost: run"].returncode != 0
    results = streams_folder / "results"
    assert (results / "SlopeSlider-2-metal.mujoco.calibrated.json").exists()


def test_a_closed_pipe_ends_the_command_quietly(outcomes):
    assert "Traceback" not in outcomes["pipe"].stderr
    assert outcomes["pipe"].returncode == 1


def test_a_full_disk_shows_what_is_done_and_how_to_go_on(gauge, monkeypatch):
    write, count = batch.write_result, 0

    def full_after_one(*arguments):
        nonlocal count
        count += 1
        if count > 1:
            raise ResultFileError(
                f"{arguments[1]}: cannot be written: {os.strerror(errno.ENOSPC)}"
            )
        write(*arguments)

    monkeypatch.setattr(batch, "write_result", full_after_one)
    result = gauge("run", "SlopeSlider-2-*")
    assert result.exit_code == 2
    assert "No space left on device" in result.stderr
    assert "1 finished; results in results; --resume continues" in " ".join(
        result.stderr.split()
    )
    assert "SlopeSlider-2-wood" in result.stderr


def test_an_engine_that_exits_ends_no_command_without_a_word(gauge, monkeypatch):
    def exits(*_, **__):
        raise SystemExit(0)

    monkeypatch.setattr("gauge_envs.tools.catalog.listing.list_rows", exits)
    result = gauge("list")
    assert result.exit_code == 1
    assert "an engine or a library ended the command" in result.stderr


def test_ctrl_c_in_the_imports_of_the_command_is_quiet(tmp_path):
    code = (
        "import os, signal, sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'gauge_envs.cli.app':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "from gauge_command import main\n"
        "main()\n"
    )
    done = run_python(
        "-c", code, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert done.returncode == 128 + signal.SIGINT
    assert done.stderr == "interrupted\n"


MOMENTS = """
import json, os, signal, sys, tempfile
EVENTS = 20_000
count, moments = 0, []


def interrupt_a_fork(*_):
    # The fork is the command at this moment, and the only one that gets the signal.
    global count
    count += 1
    if count % EVENTS:
        return
    with tempfile.TemporaryFile() as stderr:
        pid = os.fork()
        if not pid:
            sys.setprofile(None)
            os.dup2(stderr.fileno(), 2)
            os.dup2(os.open(os.devnull, os.O_RDWR), 1)
            os.kill(os.getpid(), signal.SIGINT)
            return
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        stderr.seek(0)
        moments.append([code, stderr.read().decode()])


command = os.getpid()
sys.setprofile(interrupt_a_fork)
from gauge_command import main

sys.argv = ["gauge", "list", "SlopeSlider-2-wood"]
try:
    main()
finally:
    sys.setprofile(None)
    if os.getpid() == command:
        sys.stderr.write(json.dumps(moments))
"""
"""A command of which a fork gets Ctrl-C at every 20,000th call or return of a function: the clock has no part in it."""


def test_ctrl_c_is_quiet_at_every_moment(tmp_path):
    """Until the first line of the command runs, Python itself handles the signal."""
    done = run_python(
        *("-W", "ignore", "-c", MOMENTS),
        cwd=tmp_path,
        env=environment(),
        timeout=300,
    )
    assert done.returncode == 0 and NAME in done.stdout
    # Under a profiler, CPython 3.12.1 loses `**values` in a comprehension, and the command notes that engine before.
    moments = json.loads(done.stderr.splitlines()[-1])
    assert [
        stderr for _, stderr in moments if re.search(FRAME_OF_THE_COMMAND, stderr)
    ] == []
    # A command that ends well has dropped its signal.
    assert [code for code, _ in moments].count(0) == 0
    ended = [stderr for code, stderr in moments if code == 130]
    assert len(ended) >= 20
    assert set(ended) == {"interrupted\n"}


@pytest.mark.parametrize("how", DROPPED)
def test_ctrl_c_counts_where_a_library_drops_it(outcomes, how):
    done = outcomes[f"Ctrl-C: {how}"]
    assert (done.returncode, done.stderr) == (130, "interrupted\n")


@pytest.mark.parametrize("closed", CLOSED)
def test_a_command_runs_without_its_streams(closed, outcomes):
    done = outcomes[f"closed: {closed}"]
    assert done.returncode == 0 and "Traceback" not in done.stderr
    assert (NAME in done.stdout) == ("stdout" not in closed)


def test_a_path_beyond_ascii_works_in_the_c_locale(tmp_path):
    """MuJoCo imports glfw, which looks for its library with a program that reads ASCII there."""
    glfw = find_spec("glfw")
    if glfw is None:
        pytest.skip("glfw is not installed")
    folder = tmp_path / "pfad-\u00e9"
    folder.mkdir()
    shutil.copytree(Path(glfw.origin).parent, folder / "glfw")
    done = subprocess.run(
        [sys.executable, "-c", "from gauge_command import main; main()", "show", NAME],
        cwd=ROOT,
        env=os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONPATH": str(folder)},
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")


IN_A_CALLBACK = """
import os, signal, weakref
from gauge_envs.cli import interrupts

class Dropped:
    pass

interrupts.handle_interrupts()
with interrupts.command_runs():
    one = Dropped()
    reference = weakref.ref(one, lambda _: os.kill(os.getpid(), signal.SIGINT))
    del one
print(interrupts.was_interrupted())
"""
"""A callback, as those of locks of modules, in which an exception is dropped."""


def test_ctrl_c_in_a_callback_is_quiet_and_remembered(tmp_path):
    done = run_python("-c", IN_A_CALLBACK, cwd=tmp_path, env=environment(), timeout=60)
    assert (done.stdout, done.stderr) == ("True\n", "")
