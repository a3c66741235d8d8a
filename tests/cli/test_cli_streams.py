"""Stdout of the command holds results only, and a full disk or Ctrl-C ends it with a message."""

from __future__ import annotations

import errno
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hostile import install
from places import ROOT
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.errors import ResultFileError
from gauge_envs.runs import batch

NAME = "SlopeSlider-2-wood"
COMMAND = [sys.executable, "-c", "from gauge_command import main; main()"]
FRAME_OF_THE_COMMAND = r'File ".*gauge_(command\.py|envs/)'


@pytest.fixture(autouse=True)
def interrupts_reach_children() -> Iterator[None]:
    """A shell starts background jobs with SIGINT ignored, which children would inherit."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Environment of a process in which hostile backends are installed, and in which output is buffered."""
    site = tmp_path / "site"
    site.mkdir()
    install(site, "talking", "crash", "supports-crash")
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return {**kept, "PYTHONPATH": os.pathsep.join([str(site), str(ROOT)])}


@pytest.mark.parametrize("arguments", [["run", NAME, "--backend", "talking"], ["list", NAME], ["show", NAME]])
def test_what_engines_print_never_reaches_json(
    environment: dict[str, str], tmp_path: Path, arguments: list[str]
) -> None:
    done = subprocess.run(
        [*COMMAND, *arguments, "--json"], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    (row,) = map(json.loads, done.stdout.splitlines())
    assert row["id"] == f"GAUGE/{NAME}"
    assert "a line of the engine" in done.stderr
    assert "a line of C code" in done.stderr


def test_a_run_goes_on_after_an_engine_that_crashes(environment: dict[str, str], tmp_path: Path) -> None:
    arguments = ["run", "SlopeSlider-2-*", "--backend", "crash", "--backend", "mujoco", "--json"]
    done = subprocess.run([*COMMAND, *arguments], env=environment, cwd=tmp_path, capture_output=True, text=True)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row["outcome"] for row in rows].count("finished") == 5
    (failed,) = [row for row in rows if row["outcome"] == "failed"]
    assert (failed["id"], failed["backend"]) == ("GAUGE/SlopeSlider-2-plastic", "crash")
    assert "segmentation fault" in failed["error"]
    assert done.returncode == 1
    assert len(list((tmp_path / "results").iterdir())) == 5


def test_progress_has_a_line_for_each_episode_without_a_terminal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner(env={"COLUMNS": "160"}).invoke(app, ["run", "SlopeSlider-2-*"])
    lines = [line for line in result.stderr.splitlines() if line.startswith(("1/3 ", "2/3 ", "3/3 "))]
    assert lines[0] == "1/3 SlopeSlider-2-wood on mujoco: finished"
    assert len(lines) == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("arguments", [["materials", "--json"], ["list"], ["run", NAME, "--json"]])
def test_a_full_device_is_an_error_without_a_traceback(tmp_path: Path, arguments: list[str]) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*COMMAND, *arguments],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
    assert done.returncode == 2
    assert "error: the output cannot be written: No space left on device" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_closed_pipe_ends_the_command_quietly(tmp_path: Path) -> None:
    line = f"{sys.executable} -c 'from gauge_envs.cli import main; main()' list --json | head -1"
    done = subprocess.run(
        line, shell=True, capture_output=True, text=True, cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert json.loads(done.stdout)["id"]
    assert "Traceback" not in done.stderr


def test_a_full_disk_shows_what_is_done_and_how_to_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write, count = batch.write_result, 0

    def full_after_one(*arguments: object) -> None:
        nonlocal count
        count += 1
        if count > 1:
            raise ResultFileError(f"{arguments[1]}: cannot be written: {os.strerror(errno.ENOSPC)}")
        write(*arguments)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(batch, "write_result", full_after_one)
    result = CliRunner(env={"COLUMNS": "160"}).invoke(app, ["run", "SlopeSlider-2-*"])
    assert result.exit_code == 2
    assert "No space left on device" in result.stderr
    assert "1 finished; results in results; --resume continues" in " ".join(result.stderr.split())
    assert "SlopeSlider-2-wood" in result.stderr


def test_an_engine_that_exits_ends_no_command_without_a_word(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def exits(*_: object, **__: object) -> None:
        raise SystemExit(0)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("gauge_envs.tools.catalog.listing.list_rows", exits)
    result = CliRunner().invoke(app, ["list"])
    assert result.exit_code == 1
    assert "an engine or a library ended the command" in result.stderr


def test_ctrl_c_in_the_imports_of_the_command_is_quiet(tmp_path: Path) -> None:
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
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 128 + signal.SIGINT
    assert done.stderr == "interrupted\n"


def interrupted_after(seconds: float, folder: Path) -> subprocess.CompletedProcess[str]:
    """Outcome of a command that gets SIGINT some time after its start."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [*COMMAND, "list"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder, env=environment
    ) as process:
        time.sleep(seconds)
        process.send_signal(signal.SIGINT)
        stdout, stderr = process.communicate(timeout=60)
    return subprocess.CompletedProcess(process.args, process.returncode, stdout, stderr)


def test_ctrl_c_is_quiet_at_every_moment(tmp_path: Path) -> None:
    """Until the first line of the command runs, Python itself handles the signal."""
    outcomes = [interrupted_after(milliseconds / 1e3, tmp_path) for milliseconds in range(5, 605, 25)]
    assert [done.stderr for done in outcomes if re.search(FRAME_OF_THE_COMMAND, done.stderr)] == []
    ended = [done for done in outcomes if done.returncode == 130]
    assert len(ended) >= 5
    assert all(done.stderr == "interrupted\n" for done in ended)


def test_ctrl_c_counts_where_a_library_drops_it(tmp_path: Path) -> None:
    """A library turns it into an error of its own, and a destructor ignores it."""
    turned = (
        "try:\n    os.kill(os.getpid(), signal.SIGINT)\nexcept KeyboardInterrupt:\n    raise ImportError('no module')\n"
    )
    dropped = (
        "class Held:\n"
        "    def __del__(self):\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "        for _ in range(10**6): pass\n"
        "held = Held()\n"
        "del held\n"
        "for _ in range(10**6): pass\n"
    )
    for body in (turned, dropped):
        code = (
            "import os, signal\n"
            "from gauge_envs.tools.catalog import listing\n"
            "from gauge_envs.cli.app import main\n"
            "def rows(*_, **__):\n"
            f"{textwrap.indent(body, '    ')}"
            "listing.list_rows = rows\n"
            "import sys\n"
            "sys.argv = ['gauge', 'list']\n"
            "main()\n"
        )
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        assert (done.returncode, done.stderr) == (130, "interrupted\n"), body


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_a_command_runs_without_its_streams(closed: str, tmp_path: Path) -> None:
    command = " ".join([shlex.join([*COMMAND, "list", NAME, "--json"]), closed])
    done = subprocess.run(
        ["sh", "-c", command],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and "Traceback" not in done.stderr
    assert (NAME in done.stdout) == (" >&-" not in f" {closed}")
