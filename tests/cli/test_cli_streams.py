"""Stdout of the command holds results only, and a full disk or Ctrl-C ends it with a message."""

import errno
import json
import os
import signal
import subprocess
from pathlib import Path

import pytest
from forks import Case, run_forks
from hostile import install
from places import ROOT
from programs import run_python

from gauge_envs.errors import ResultFileError
from gauge_envs.runs import batch

NAME = "SlopeSlider-2-wood"


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


def test_a_full_disk_shows_how_much_is_done_and_how_to_go_on(gauge, monkeypatch):
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


def test_ctrl_c_ends_a_command_with_one_line(gauge, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("gauge_envs.tools.catalog.listing.list_rows", interrupted)
    result = gauge("list")
    assert (result.exit_code, result.stdout) == (130, "")
    assert result.stderr == "interrupted\n"
