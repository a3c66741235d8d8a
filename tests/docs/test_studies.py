"""The script of each study runs as its note says, on the smallest input that it has."""

import csv
import os
import shlex
import shutil
import sys

import pytest
from places import ROOT

from gauge_envs import files

STUDIES = ROOT / "studies"
TIMEOUT_S = 600.0
PROGRAM = """
import runpy, sys

sys.argv[:2] = sys.argv[1:2]
runpy.run_module(f"studies.{sys.argv[0]}", run_name="__main__", alter_sys=True)
"""

COMMANDS = {
    "cost": "cost results",
    "coverage": "interval_coverage out.csv 'drop, 5 % outliers'",
    "joints": "robots 0 1 60",
    "newtons_cradle": "cradle",
    "planted_faults": "random_faults rates",
    "published_scores": "published_scores --backend mujoco --engine isaacsim --only SlopeSlider-2-wood",
    "pushes": "pushes slide",
    "robots": "makers",
    "steps": "steps SlopeSlider-1-wood",
    "what_changed": "what_changed models",
}
SLOW = {"coverage", "joints", "steps"}


def test_every_study_has_a_command_of_a_script_and_its_note_names_all_scripts():
    scripts = sorted(STUDIES.glob("*/*.py"))
    assert {file.parent.name for file in scripts} == set(COMMANDS)
    for file in scripts:
        if "__main__" not in file.read_text():
            continue
        name = f"{file.parent.name}.{file.stem}"
        note = (file.parent / "README.md").read_text()
        assert f"python -m studies.{name}" in note
    for study, command in COMMANDS.items():
        assert (STUDIES / study / f"{command.split()[0]}.py").is_file()


@pytest.mark.parametrize(
    "study",
    [
        pytest.param(one, marks=[pytest.mark.slow] if one in SLOW else [])
        for one in COMMANDS
    ],
)
def test_a_script_runs_as_its_note_says(study, tmp_path, monkeypatch):
    # In a copy, as some write their tables beside them.
    shutil.copytree(STUDIES / study, tmp_path / "studies" / study)
    (tmp_path / "results").mkdir()
    monkeypatch.chdir(tmp_path)
    # A fork where the system has them: see the fixture `forked_children`.
    printed, wrong = tmp_path / "printed.txt", tmp_path / "wrong.txt"
    with printed.open("wb") as output, wrong.open("wb") as errors:
        done = files.subprocess.run(
            [sys.executable, "-c", PROGRAM, *shlex.split(f"{study}.{COMMANDS[study]}")],
            input=b"",
            env=os.environ | {"PYTHONPATH": f"{tmp_path}:{ROOT}:{ROOT / 'tests'}"},
            stdout=output,
            stderr=errors,
            timeout=TIMEOUT_S,
            check=False,
        )
    assert done.returncode == 0, wrong.read_text()
    assert printed.read_bytes() or study == "joints"


def test_the_page_of_sanity_counts_the_blind_draws_as_their_rows_do():
    page = (ROOT / "docs/sanity.md").read_text()
    with (STUDIES / "robots/blind.csv").open() as file:
        mistakes = list(csv.DictReader(file))

    def named(**chosen):
        rows = [row for row in mistakes if chosen.items() <= row.items()]
        count = sum(row["verdict"] == "named" for row in rows)
        return f"{count} of {len(rows)}"

    for quantity in {row["quantity"] for row in mistakes}:
        assert f"| {quantity} | {named(quantity=quantity)} |" in page
    for parts in {row["parts"] for row in mistakes}:
        published = named(parts=parts, published="yes")
        others = named(parts=parts, published="no")
        assert f"| {published} | {others} |" in page
