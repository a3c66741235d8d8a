"""A release: the same version everywhere, and workflows with existing commands."""

from __future__ import annotations

import hashlib
import re
import shlex
import tomllib

import pytest
import yaml
from places import ROOT
from texts import parse

from scripts.release import ADDRESSES, left_to_do

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PUBLISHERS = {(name, "publish") for name in ("release.yml", "docs.yml")}
"""Jobs that may write, each in its own environment."""


def workflow(file):
    return yaml.safe_load(file.read_text())


def steps(file):
    return [step for job in workflow(file)["jobs"].values() for step in job["steps"]]


def test_the_version_is_the_same_everywhere():
    version = PROJECT["project"]["version"]
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    released = re.findall(
        r"^## \[(\d.+)\] - (\S+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE
    )
    assert released[0] == (citation["version"], str(citation["date-released"]))
    assert version in (citation["version"], f"{version.partition('.dev')[0]}.dev0")
    written = [
        file
        for file in (ROOT / "gauge_envs").rglob("*.py")
        if f'"{version}"' in file.read_text("utf-8")
    ]
    assert written == []


def test_a_release_names_what_is_left_to_do(tmp_path):
    (tmp_path / "scoring").mkdir()
    (tmp_path / "scoring" / "PROVENANCE.md").write_text("")
    changelog, citation = tmp_path / "CHANGELOG.md", tmp_path / "CITATION.cff"
    changelog.write_text("# Changelog\n\n## [Unreleased]\n\n## [0.3.0] - 2026-11-28\n")
    citation.write_text("version: 0.3.0\ndate-released: 2026-11-28\n")
    left = left_to_do(tmp_path, "1.0.0.dev0", ["Homepage"])
    assert len(left) == 6
    assert "[1.0.0] - DATE in place of [Unreleased]" in left[1]
    assert "lacks Repository, Documentation, Changelog, Issues" in left[-1]
    changelog.write_text(
        f"## [1.0.0] - 2026-11-30\n\n{hashlib.sha256().hexdigest()}\n\n## [0.3.0]\n"
    )
    citation.write_text("version: 1.0.0\ndate-released: 2026-11-30\n")
    assert left_to_do(tmp_path, "1.0.0", ADDRESSES) == []


def test_the_conda_recipe_has_the_requirements_of_the_project():
    recipe = yaml.safe_load((ROOT / "packaging" / "conda" / "recipe.yaml").read_text())
    project = PROJECT["project"]
    assert project["version"].startswith(recipe["context"]["version"])
    assert project["requires-python"] == f">={recipe['context']['python_min']}"
    run = recipe["requirements"]["run"][1:]
    assert [
        line.replace("mujoco-python", "mujoco").replace(" ", "") for line in run
    ] == project["dependencies"]


def test_a_workflow_may_write_only_to_publish():
    for file in WORKFLOWS:
        content = workflow(file)
        assert content["permissions"] == {"contents": "read"}
        writing = {
            (file.name, name)
            for name, job in content["jobs"].items()
            if "permissions" in job
        }
        assert writing <= PUBLISHERS
        assert all("environment" in content["jobs"][name] for _, name in writing)
        assert "secrets." not in file.read_text()


def test_releases_are_installed_on_all_supported_versions():
    versions = [
        text.rpartition(" ")[2]
        for text in PROJECT["project"]["classifiers"]
        if re.fullmatch(r"Programming Language :: Python :: \d\.\d+", text)
    ]
    jobs = workflow(ROOT / ".github" / "workflows" / "release.yml")["jobs"]
    assert jobs["install"]["strategy"]["matrix"]["python"] == versions
    assert PROJECT["project"]["requires-python"] == f">={versions[0]}"


@pytest.mark.parametrize("file", WORKFLOWS, ids=lambda file: file.name)
def test_commands_of_a_workflow_exist(file):
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    extras = PROJECT["project"]["optional-dependencies"]
    for command in (step["run"] for step in steps(file) if "run" in step):
        for target in re.findall(r"\bmake ([\w-]+)", command):
            assert target in targets
        for listed in re.findall(r"\.\[([\w,]+)\]", command):
            assert set(listed.split(",")) <= set(extras)
        if command.startswith("gauge ") and command != "gauge --version":
            parse(shlex.split(command.partition(" >>")[0])[1:])
