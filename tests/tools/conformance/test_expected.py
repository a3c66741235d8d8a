"""The repository of an engine states which checks fail, each with a reason; a badge counts; pytest runs the checks."""

import json
import subprocess
import sys
from xml.etree import ElementTree

import pytest
from faults import FAULTS, Faulty

from gauge_envs.backends import backend, registry

ONLY = ("--only", "slide", "--only", "free-fall", "--only", "cloth-start")
SLIDE = 'slide = "friction is low"\n'


@pytest.fixture
def broken(monkeypatch, tmp_path, gauge):
    """Runs the checks of an engine whose friction is 20 % low with a file of expected failures."""
    engine = Faulty(backend("mujoco"), FAULTS["friction-low"])
    find = "gauge_envs.tools.conformance.run.find_backend"
    monkeypatch.setattr(registry, "is_bundled", lambda name: True)
    monkeypatch.setattr(find, lambda name: engine)

    def run(text, *options):
        file = tmp_path / "known.toml"
        file.write_text(text)
        words = ("backend", "check", "mine", "--expected", file, *ONLY, *options)
        return gauge(*words)

    return run


@pytest.mark.parametrize(
    ("text", "code", "words", "color"),
    [
        (SLIDE, 0, "3 checks, 1 failed", "yellow"),
        ("", 1, "not expected: slide fails, 2.86", "red"),
        (
            SLIDE + 'free-fall = "late"\n',
            1,
            "free-fall passes, but is listed as failing (late): delete its line",
            "red",
        ),
    ],
)
def test_exactly_the_listed_checks_fail(broken, tmp_path, text, code, words, color):
    badge = tmp_path / "badge.json"
    result = broken(text, "--badge", badge)
    assert (result.exit_code, words in " ".join(result.stderr.split())) == (code, True)
    found = json.loads(badge.read_text())
    assert (found["message"], found["color"]) == ("2 of 3 checks", color)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('slid = "low"', "unknown check 'slid'; did you mean slide,"),
        ('slide = ""', "slide needs a reason in words"),
        ("slide", "cannot be read as TOML"),
    ],
)
def test_a_wrong_list_is_refused_before_anything_runs(broken, text, words):
    result = broken(text)
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in " ".join(result.stderr.split())


def test_a_list_is_of_one_engine(broken):
    result = broken(SLIDE, "mujoco")
    assert result.exit_code == 2
    assert "of one engine" in " ".join(result.stderr.split())


def test_checks_are_tests_of_pytest(tmp_path):
    """In an environment without cloth the engine declines it; rebound-flat fails in MuJoCo."""
    (tmp_path / "known.toml").write_text(
        'rebound-flat = "each point rebounds"\ntime = "late"\n'
    )
    words = "-p gauge_pytest -p no:cacheprovider --gauge-engine mujoco --gauge-expected known.toml --junitxml out.xml"
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *words.split(), "-k", "rebound-flat or time"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    cases = {
        one.get("name"): one
        for one in ElementTree.parse(tmp_path / "out.xml").iter("testcase")
    }
    assert cases["rebound-flat"].find("skipped").get("message") == "each point rebounds"
    assert "listed as failing (late)" in cases["time"].find("failure").get("message")
    facts = {
        one.get("name"): one.get("value") for one in cases["time"].iter("property")
    }
    assert facts["versions"] == str(dict(backend("mujoco").versions()))
