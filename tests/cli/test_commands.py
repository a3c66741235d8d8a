"""Each command from end to end: help, results, exit codes, and messages for mistakes of users."""

import inspect
import json
import re
import shlex
import sys
from importlib.metadata import version

import numpy as np
import pytest
from interruption import interrupt_in_episode
from rich.text import Text
from slide import NAME

from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.cli.app import load_command
from gauge_envs.cli.arguments import parsed_settings, split_values
from gauge_envs.cli.commands import commands, help_lines, listings
from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.runs import batch
from gauge_envs.tools.run.options import parsed_jitter


def rows(result):
    return [json.loads(line) for line in result.stdout.splitlines()]


# --- help ---


@pytest.mark.parametrize("name", commands())
def test_the_help_of_a_group_has_the_first_line_of_the_command(name):
    text = inspect.cleandoc(commands()[name].function().__doc__)
    assert text.partition("\n\n")[0].replace("\n", " ") == help_lines()[name]


def test_the_help_names_all_commands_and_the_version(gauge):
    shown = gauge("--help").stdout
    assert all(name in shown for name in help_lines() if " " not in name)
    assert "versions" in gauge("backend", "--help").stdout
    assert gauge("--version").stdout == f"gauge-envs {version('gauge-envs')}\n"


def test_rich_markup_does_not_remove_text_of_the_help():
    """Rich reads `[mm]` as a tag and does not print it."""
    texts = {
        text
        for command in map(load_command, commands())
        for text in (command.help, *(option.help for option in command.params))
        if text
    }
    assert len(texts) > 80
    assert [text for text in texts if Text.from_markup(text).plain != text] == []


def test_an_option_has_one_unit_and_one_kind_in_all_commands():
    kinds = {}
    for name in commands():
        for option in load_command(name).params:
            if option.param_type_name == "option":
                assert option.help, (name, option.name)
                metavar = {"FILE": "PATH", "DIR": "PATH"}.get(
                    option.metavar, option.metavar
                )
                long_name = max(option.opts, key=len)
                kinds.setdefault(long_name, set()).add((metavar, option.is_flag))
    # These options take other values in each command.
    differing = {name for name, forms in kinds.items() if len(forms) > 1}
    allowed = {"--against", "--out", "--backend", "--format", "--parameter"}
    assert differing <= allowed


# --- list, show, run, score, plot ---


def test_run_reads_overrides_settings_and_seeds(gauge):
    plain, changed = (
        rows(gauge("run", NAME, "--json", "-s", "3", "--set", "iterations=50", *words))
        for words in ((), ("-p", "cube.friction=0.2,cube.mass_kg=0.1"))
    )
    assert plain[0]["seed"] == 3
    assert plain[0]["settings"]["iterations"] == 50
    assert changed[0]["parameters"] == {"cube.friction": 0.2, "cube.mass_kg": 0.1}
    frictions = [row[0]["score"]["estimates"]["friction"] for row in (plain, changed)]
    assert frictions[1]["value"] < frictions[0]["value"] - 0.05


def test_a_diverged_episode_has_exit_code_1_and_its_reason(gauge, monkeypatch):
    monkeypatch.setattr(SimulationMuJoCo, "diverged", lambda _: {0: "it flew away"})
    result = gauge("run", NAME)
    assert result.exit_code == 1
    assert "it flew away" in result.stdout


def test_results_are_scored_again_and_plotted(gauge, tmp_path):
    gauge("run", NAME)
    (file,) = (tmp_path / "results").glob("*.json")
    (again,) = rows(gauge("score", file, "--json"))
    stored = json.loads(file.read_text())["score"]
    assert again["score"]["rmse_aligned"] == pytest.approx(
        stored["rmse_aligned"], rel=1e-9
    )
    assert gauge("plot", "results", "--out", "plots").exit_code == 0
    assert (tmp_path / "plots" / f"{NAME}.png").is_file()


# --- interrupted and damaged ---


def test_ctrl_c_keeps_finished_episodes_and_resume_continues(
    gauge, monkeypatch, tmp_path
):
    with monkeypatch.context() as patched:
        interrupt_in_episode(patched, 3)
        stopped = gauge("run", "SlopeSlider-2-*", "--json")
    assert stopped.exit_code == 130
    assert "--resume" in stopped.stderr
    assert len(list((tmp_path / "results").glob("*.json"))) == len(rows(stopped)) == 2
    damaged = next((tmp_path / "results").glob("*.json"))
    damaged.write_text("{")
    resumed = gauge("run", "SlopeSlider-2-*", "--json", "--resume")
    assert resumed.exit_code == 0
    assert f"{damaged.name}: not a result file" in resumed.stderr
    assert len(rows(resumed)) == 3


def test_a_full_disk_keeps_earlier_results(gauge, monkeypatch):
    write, count = batch.write_result, 0

    def full_after_the_first(*arguments):
        nonlocal count
        count += 1
        if count > 1:
            raise ResultFileError("cannot be written: No space left on device")
        write(*arguments)

    monkeypatch.setattr(batch, "write_result", full_after_the_first)
    result = gauge("run", "SlopeSlider-2-*")
    assert result.exit_code == 2
    message = " ".join(result.stderr.split())
    assert "No space left on device" in message
    assert "finished episodes are kept in results; --resume continues" in message


def test_a_missing_extra_is_in_the_message(gauge, monkeypatch):
    gauge("run", NAME)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    result = gauge("plot")
    assert result.exit_code == 2
    assert re.search(r"pip install .*\[plot\]'", result.stderr)


def test_an_output_that_cannot_be_written_stops_before_the_checks(
    gauge, monkeypatch, tmp_path
):
    def fail(*_):
        raise AssertionError("a check ran")

    monkeypatch.setattr("gauge_envs.tools.conformance.results.run_column", fail)
    folder = tmp_path / "a.json"
    folder.mkdir()
    result = gauge("backend", "check", "mujoco", "--out", folder)
    assert result.exit_code == 2
    assert "cannot be written: Is a directory" in result.stderr


# --- mistakes ---

MISTAKES = """
lits -> did you mean list
backend chek -> did you mean backend check
list mujoko -> unknown experiment 'mujoko'
list phenomena slde-wood -> did you mean slide-wood
show SlopeSlider -> did you mean SlopeSlider-1-metal
run -> nothing to run
run SlopeSlider-2-gold -> did you mean SlopeSlider-2-wood
run SlopeSlider-2-wood --backend mujoko -> did you mean mujoco
run SlopeSlider-2-wood --backnd mujoco -> --backend
run SlopeSlider-2-wood -p nonsense -> known: measured, published
run SlopeSlider-2-wood -p cube.frction=1 -> did you mean friction
run SlopeSlider-2-wood -p cbe.friction=1 -> did you mean cube
run SlopeSlider-2-wood -p cube.friction=-1 -> cube.friction
run SlopeSlider-2-wood --set iteration=3 -> did you mean iterations
run SlopeSlider-2-wood --set timestep_s -> expected NAME=VALUE
run SlopeSlider-2-wood --jitter=1 -> 1mm,0.5deg
run SlopeSlider-2-wood --use import -> did you mean imported
run SlopeSlider-2-wood --seed=x -> --seed
run SlopeSlider-2-wood --repeats=0 -> --repeats
run SlopeSlider-2-wood --timeout 0 -> expected a positive number
run SlopeSlider-2-wood --out /proc/nowhere -> /proc/nowhere
score no.csv -> Give one, as --id
score no.csv --id SlopeSlider-2-wood -> no.csv: cannot be read
score bad.csv --id SlopeSlider-2-wood -> bad.csv: line 2: cube.y is 'nan'
plot nowhere -> nowhere: holds no result files
plot --metric rmse -> --metric
compare --metric 1 -> known: dtw
sweep --backend mujoco -> nothing to run
sanity -> no target is given
sanity HalfCheetah-v5 --pair floor -> the names of two geoms
recipe --friction 0.3 -> --backend is missing
recipe --damping 1 --backend mujoco -> no behaviour is requested
recipe satin wood-on-wood -> wood-on-wood
"""
"""Requests with a mistake, and a part of their message."""


@pytest.mark.parametrize("line", MISTAKES.strip().splitlines())
def test_the_message_of_a_mistake_has_a_fix(gauge, tmp_path, line):
    (tmp_path / "bad.csv").write_text("1,2,3\n1,nan,3\n")
    request, _, answer = line.partition(" -> ")
    result = gauge(*shlex.split(request))
    assert (result.exit_code, result.stdout) == (2, "")
    assert answer in " ".join(result.stderr.replace("│", " ").split())


def test_values_of_options_are_parsed():
    assert split_values("newton:dt=1,n=2,rapier", "ENGINE[:NAME=VALUE,...]") == [
        "newton:dt=1,n=2",
        "rapier",
    ]
    assert parsed_settings(["timestep_s=1/1800"]) == {"timestep_s": 1 / 1800}
    with pytest.raises(ParameterError, match="timestep_s is given twice"):
        parsed_settings(["timestep_s=1", "timestep_s=2"])
    jitter = parsed_jitter(split_values("2mm,0.5deg"))
    assert jitter.position_m == 2e-3
    assert jitter.angle_rad == pytest.approx(np.radians(0.5), rel=1e-12)
    assert parsed_jitter(["1mm"]).angle_rad == 0.0


@pytest.mark.parametrize("kind", listings())
def test_list_prints_each_kind(gauge, kind):
    result = gauge("list", kind)
    assert result.exit_code == 0
    assert len(result.stdout.splitlines()) > 3
