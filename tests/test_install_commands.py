"""Every command of the README and the guides works in an environment with only the packages of its page.

What runs where, and what is skipped for which reason, is in `install_commands.toml`. The environments are made from
the built wheel; `-k default` chooses those without extras.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest
from install_commands import DEFAULT, Table
from places import ROOT

from gauge_envs.errors import SOURCE
from scripts.test_matrix import make_environment

TABLE = Table.read(Path(__file__).with_name("install_commands.toml"))
COMMANDS = TABLE.commands(ROOT)
TIMEOUT_S = 300.0

FINDINGS = ("gauge sanity ", "gauge backend check mujoco", "gauge replay ")
"""Commands whose exit code is 1 where they find a problem."""


def page_runs():
    """Commands for each environment and page, with the default commands of a page, which later ones need."""
    needed = defaultdict(set)
    for command in COMMANDS:
        if command.skip is None:
            needed[command.page].add(command.environment)
    return {
        (environment, page): [
            command
            for command in COMMANDS
            if command.page == page
            and command.skip is None
            and command.environment in {environment, DEFAULT}
        ]
        for page, environments in needed.items()
        for environment in sorted(environments)
    }


RUNS = page_runs()


@pytest.fixture(scope="module")
def commands_of(wheel, tmp_path_factory):
    """The folder of the commands of an environment, created at first use."""
    made = {}

    def make(environment):
        if environment not in made:
            folder = tmp_path_factory.mktemp(environment) / "venv"
            extras = TABLE.environments[environment]
            made[environment] = make_environment(
                folder, python=Path(sys.executable), wheel=wheel, extras=extras
            )
        return made[environment]

    return make


@pytest.mark.slow
@pytest.mark.parametrize(("environment", "page"), list(RUNS), ids=map("-".join, RUNS))
def test_commands_of_a_page(
    commands_of,
    environment,
    page,
    tmp_path,
    gauge_data_dir,
):
    checkout = tmp_path / "checkout"
    checkout.mkdir()
    shutil.copytree(ROOT / "examples", checkout / "examples")
    folder = commands_of(environment)
    variables = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith("PYTHON")
    } | {
        "PATH": os.pathsep.join([str(folder), os.environ["PATH"]]),
        "VIRTUAL_ENV": str(folder.parent),
        "GAUGE_DATA_DIR": str(gauge_data_dir),
        "COLUMNS": "160",
    }
    for command in RUNS[environment, page]:
        done = subprocess.run(
            ["bash", "-c", command.text],
            cwd=checkout / TABLE.page_folders.get(page, "."),
            env=variables,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
        is_finding = command.text.startswith(FINDINGS)
        codes = (0, 1) if is_finding else (0,)
        assert done.returncode in codes, (
            f"{page}: {command.text}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
        )


def test_every_page_installs_the_package_in_the_form_of_the_messages():
    """Until an index has the package, its bare name installs nothing."""
    files = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    files += (ROOT / "examples").glob("*.py")
    found = [
        (file.name, name)
        for file in files
        for name in re.findall(
            r"pip install [\"']?([\w./-]*gauge[-_]envs(?!-)|\.)[\s\"'\[]",
            file.read_text(),
        )
    ]
    assert len(found) > 12
    assert [place for place in found if place[1] != SOURCE] == []


def test_the_readme_has_at_most_700_words():
    words = (ROOT / "README.md").read_text().split()
    assert len(words) <= 700


def test_a_page_names_the_extras_that_its_commands_need():
    missing = [
        f"{page}: {extra}"
        for environment, page in RUNS
        if page != "scripts"
        for extra in TABLE.environments[environment]
        if not re.search(
            rf"`{extra}`|\[[\w,]*\b{extra}\b[\w,]*\]",
            (ROOT / page).read_text(),
        )
    ]
    assert missing == []
