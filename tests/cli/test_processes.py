"""Commands as processes: stdout has only results; Ctrl-C, crashes and full disks give a message."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hostile import install
from places import ROOT
from programs import run_python

NAME = "SlopeSlider-2-wood"
PROGRAM = "import sys; sys.argv = ['gauge', *sys.argv[1:]]; from gauge_envs.__main__ import main; main()"


def start(*words, folder, stdout=subprocess.PIPE, **variables):
    """Start the command in a folder."""
    paths = [str(ROOT), variables.pop("site", "")]
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), **variables},
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
    )


def test_engines_print_to_stderr_and_a_crash_loses_one_episode(tmp_path):
    site = tmp_path / "site"
    site.mkdir()
    install(site, "talking", "crash")
    words = ("SlopeSlider-2-plastic", "-b", "crash", "-b", "talking", "--json")
    process = start("run", *words, folder=tmp_path, site=str(site))
    stdout, stderr = process.communicate()
    failed, finished = map(json.loads, stdout.splitlines())
    assert (failed["backend"], failed["outcome"]) == ("crash", "failed")
    assert "segmentation fault" in failed["error"]
    assert (finished["backend"], finished["outcome"]) == ("talking", "finished")
    assert "a line of the engine" in stderr and "a line of C code" in stderr
    assert process.returncode == 1


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_device_is_an_error_and_the_results_are_written(tmp_path):
    with Path("/dev/full").open("w") as full:
        process = start("run", NAME, "--json", folder=tmp_path, stdout=full)
        _, stderr = process.communicate()
    assert process.returncode == 2
    assert "the output cannot be written: No space left on device" in stderr
    assert "Traceback" not in stderr
    assert (tmp_path / "results" / f"{NAME}.mujoco.published.json").is_file()


def test_a_closed_pipe_ends_the_command_without_a_traceback(tmp_path):
    process = start("list", "--json", folder=tmp_path)
    process.stdout.close()
    process.stdout = None
    _, stderr = process.communicate()
    assert process.returncode == 1
    assert "Traceback" not in stderr


def test_an_exit_of_an_engine_gives_a_message(gauge, monkeypatch):
    def exits(*_, **__):
        raise SystemExit(0)

    monkeypatch.setattr("gauge_envs.tools.catalog.listing.list_rows", exits)
    result = gauge("list", NAME)
    assert result.exit_code == 1
    assert "an engine or a library ended the command" in result.stderr


def test_ctrl_c_ends_a_command_with_one_line(gauge, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("gauge_envs.tools.catalog.listing.list_rows", interrupted)
    result = gauge("list", NAME)
    assert (result.exit_code, result.stdout) == (130, "")
    assert result.stderr == "interrupted\n"


def test_ctrl_c_in_the_imports_of_the_command_is_quiet(tmp_path):
    code = (
        "import os, signal, sys\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Finder:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'gauge_envs.cli.app':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "from gauge_envs.__main__ import main\n"
        "main()\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = run_python("-c", code, cwd=tmp_path, env=environment)
    assert done.returncode == 128 + signal.SIGINT
    assert done.stderr == "interrupted\n"


def test_a_shell_completes_options_and_ids():
    def completed(words):
        variables = {
            "_GAUGE_COMPLETE": "complete_bash",
            "COMP_WORDS": words,
            "COMP_CWORD": str(len(words.split()) - 1),
        }
        done = run_python("-c", PROGRAM, cwd=ROOT, env=os.environ | variables)
        return done.stdout.split()

    assert "--repeats" in completed("gauge run --re")
    assert "SlopeSlider-2-wood" in completed("gauge run SlopeSlider-2-w")


def test_the_help_loads_no_tool_and_no_engine():
    code = (
        "import atexit, sys; sys.argv = ['gauge', '--help']; from gauge_envs.__main__ import main\n"
        "heavy = ('gauge_envs.tools.run', 'scipy', 'pydantic', 'mujoco', 'matplotlib')\n"
        "atexit.register(lambda: print([one for one in sys.modules if one.startswith(heavy)], file=sys.stderr))\n"
        "main()"
    )
    assert run_python("-c", code, cwd=ROOT).stderr == "[]\n"
