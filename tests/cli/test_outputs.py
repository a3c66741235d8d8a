"""What the commands print, in every format, as a person has approved it."""

import shlex

import approval
import numpy as np
import pytest
from slide import SLIDE, write_csv

from gauge_envs import load_experiment
from gauge_envs.cli.app import load_command
from gauge_envs.cli.commands import commands

STATIC = {
    "list": "list",
    "list-json": "list FoamBending-soft SlopeSlider-2-wood --json",
    "show-trials": "show SlopeSlider-2-wood --format wide",
    "show-deformable": "show FoamBending-soft --format wide",
    "show-json": "show SlopeSlider-3-wood --format json",
}
"""Commands that run no experiment."""

EPISODES = {
    "run": "run 'SlopeSlider-2-*'",
    "run-details": "run NewtonsCradle-metal --details",
    "run-json": "run SlopeSlider-2-wood SlopeSlider-1-wood --json --seed=3 --set iterations=50",
    "run-declined": "run FoamBending-soft SlopeSlider-2-wood",
    "run-gravity": "run NonsmoothContact-1-wood --parameter scene.gravity_m_per_s2=5",
    "score": "score slide.csv --id SlopeSlider-2-wood",
    "score-json": "score slide.csv --id SlopeSlider-2-wood --json",
}


@pytest.mark.usefixtures("rigid_only")
@pytest.mark.parametrize(("name", "command"), [*STATIC.items(), *EPISODES.items()])
def test_an_output_is_the_approved_one(gauge, approved, tmp_path, name, command):
    write_csv(tmp_path / "slide.csv", SLIDE)
    result = gauge(*shlex.split(command))
    approved(f"cli/{name}", approval.readable(result))


def test_the_help_of_every_command(approved):
    """The words of the commands themselves; how they are set is Typer's matter."""
    pytest.importorskip(
        "typer", "0.29", reason="earlier ones keep help of arguments elsewhere"
    )
    lines = []
    for name in commands():
        command = load_command(name)
        lines.append(f"gauge {name}: {command.help}")
        for one in command.params:
            lines.append(f"    {', '.join(one.opts)}: {getattr(one, 'help', '')}")
            if one.default and isinstance(one.default, str | int | float):
                lines.append(f"        default: {one.default}")
    approved("cli/help", "\n".join(lines))


REFUSED = """
lits
list X*
list phenomena slde-wood
list backends mujoko
list materials satn
show SlopeSlider
run
run SlopeSlider-2-gold
run 'SlopSlider-2-woo*'
run 'Sloper*'
run GAUGE/SlopeSlider-9-wood
run SlopeSlider-2-wood --backend mujoko
run SlopeSlider-2-wood --parameter nonsense
run SlopeSlider-2-wood --parameter cube.friction
run SlopeSlider-2-wood --parameter cube.colour=1
run SlopeSlider-2-wood --parameter cube.frction=1
run SlopeSlider-2-wood --parameter cbe.friction=1
run SlopeSlider-2-wood --parameter cube.friction=
run SlopeSlider-2-wood --set timestep_s
run SlopeSlider-2-wood --set iteration=3
run SlopeSlider-2-wood --set preset=dampped
run SlopeSlider-2-wood --parameter effective,calibrated
run SlopeSlider-2-wood --parameter effective,cube.friction=0.3
run SlopeSlider-2-wood --jitter=1
run SlopeSlider-2-wood --use import
run --seed 1
run SlopeSlider-2-wood --jitter=1mm,2mm
run SlopeSlider-2-wood --jitter=real,1mm
score bad.csv --id SlopeSlider-2-wood
score no.csv
score no.csv --id Nothing-2
plot nowhere
backend chek
sweep --backend 1
compare --metric 1
plot --metric rmse
sanity
sanity HalfCheetah-v5 --pair floor
sanity HalfCheetah-v5 --out page.pdf
sanity HalfCheetah-v5 --out a.md --out b.md
recipe friktion=0.3
recipe --mass 1
recipe --damping 1 --backend mujoco
sweep --shard 3 --only SlopeSlider-2-wood
"""
"""Requests that cannot be met, each a line; what a library adds to a message is in no approved text."""


def test_what_cannot_be_met_is_refused_in_the_approved_words(gauge, approved, tmp_path):
    (tmp_path / "bad.csv").write_text("1,2,3\n1,nan,3\n")
    commands = REFUSED.strip().splitlines()
    approved("cli/refused", approval.refused_commands(gauge, *commands))


@pytest.mark.parametrize(
    ("command", "place"),
    [
        ("run SlopeSlider-2-wood --parameter cube.friction=-1", "cube.friction"),
        ("run SlopeSlider-2-wood --out /proc/nowhere", "/proc/nowhere"),
        ("run SlopeSlider-2-wood --seed=-1", "--seed"),
        ("run SlopeSlider-2-wood --seed=x", "--seed"),
        ("run SlopeSlider-2-wood --repeats=0", "--repeats"),
        ("score no.csv --id SlopeSlider-2-wood", "no.csv: cannot be read"),
        ("run SlopeSlider-2-wood --timeout 0", "'0': expected a positive number"),
        ("run SlopeSlider-2-wood --memory 4GiB", "'4GiB': expected a number in GB"),
        ("recipe satin wood-on-wood", "(wood-on-wood)"),
    ],
)
def test_a_refusal_with_words_of_a_library_names_the_place(gauge, command, place):
    result = gauge(*shlex.split(command))
    assert (result.exit_code, result.stdout) == (2, "")
    assert place in result.stderr


def test_neither_zeros_nor_a_frozen_cloth_solve_a_scene(gauge, approved, tmp_path):
    """The published observable of a swinging cloth is zero by symmetry: only its markers tell that nothing moves."""
    experiment = load_experiment("TextileFlinging-satin")
    rest_m = np.array(experiment.scene.markers.positions_m)
    zeros = np.zeros((experiment.frame_count, len(rest_m)))
    frozen_m = np.repeat(rest_m[None], len(zeros), axis=0)
    np.savez(tmp_path / "zeros.npz", g=zeros)
    np.savez(tmp_path / "frozen.npz", g=zeros, markers_m=frozen_m)
    texts = [
        approval.readable(gauge("score", file, "--id", experiment.name))
        for file in ("zeros.npz", "frozen.npz")
    ]
    approved("cli/score-frozen", "\n".join(texts))
