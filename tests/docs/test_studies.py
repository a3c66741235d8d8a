"""The script of each study runs as its note says, on the smallest input that it has."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from places import ROOT

STUDIES = ROOT / "studies"
TIMEOUT_S = 600.0

COMMANDS = {
    "control_steps": "control_steps",
    "cost": "cost results",
    "coverage": "interval_coverage out.csv 'drop, 5 % outliers'",
    "euler_order": "euler_order",
    "few_iterations": "few_iterations cases",
    "joints": "pendulums",
    "laws": "laws checks",
    "models": "cantilever",
    "newtons_cradle": "cradle",
    "planted_faults": "planted_faults --only margin",
    "published_scores": "published_scores --backend mujoco --engine isaacsim --only SlopeSlider-2-wood",
    "pushes": "pushes slide",
    "recipes": "hopping_plates",
    "tosses": "cube_toss run mujoco out --every 100",
}
SLOW = {"control_steps", "coverage", "joints", "laws", "models"}


def test_every_study_has_one_script_and_a_command_of_it() -> None:
    scripts = sorted(STUDIES.glob("*/*.py"))
    assert [file.parent.name for file in scripts] == sorted(COMMANDS)
    for file in scripts:
        name = f"{file.parent.name}.{file.stem}"
        note = (file.parent / "README.md").read_text(encoding="utf-8")
        assert f"python -m studies.{name}" in note
        assert COMMANDS[file.parent.name].split()[0] == file.stem


@pytest.mark.parametrize(
    "study",
    [
        pytest.param(one, marks=[pytest.mark.slow] if one in SLOW else [])
        for one in COMMANDS
    ],
)
def test_a_script_runs_as_its_note_says(study: str, tmp_path: Path) -> None:
    # In a copy, as some write their tables beside them.
    shutil.copytree(STUDIES / study, tmp_path / "studies" / study)
    (tmp_path / "results").mkdir()
    command = f"-m studies.{study}.{COMMANDS[study]}"
    done = subprocess.run(
        [sys.executable, *shlex.split(command)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}"},
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout or study == "joints"
