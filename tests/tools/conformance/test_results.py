"""`gauge backend check`: its screen, its files, expected failures, a baseline, and checks as tests of pytest."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree

import pytest
from faults import FAULTS, Faulty

from gauge_envs.backends import Support, backend, registry
from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.tools.conformance import Status, checks, run_checks
from gauge_envs.tools.conformance.results import (
    changes,
    engine_columns,
    levels,
    read_columns,
    run_column,
    with_columns,
    write_columns,
)

ONLY = ("--only", "slide", "--only", "free-fall", "--only", "cloth-stretch")


class KnowsNoCloth(Faulty):
    def supports(self, scene):
        return Support(("it knows no cloth",) if scene.deformables else ())


@pytest.fixture
def broken(monkeypatch, gauge):
    """Runs the command; `mine` is an engine whose friction is 20 % low and that knows no cloth."""
    engine = KnowsNoCloth(backend("mujoco"), FAULTS["friction 20 % low"])
    engine.name = "mine"
    known = registry.backend
    names = registry.backend_names()
    monkeypatch.setattr(registry, "is_bundled", lambda name: True)
    results = "gauge_envs.tools.conformance.results"
    monkeypatch.setattr(f"{results}.backend_names", lambda: [*names, "mine"])
    monkeypatch.setattr(
        "gauge_envs.tools.conformance.run.find_backend",
        lambda name: engine if name == "mine" else known(name),
    )
    return lambda *words: gauge("backend", "check", "mine", *words)


def words_of(text):
    return " ".join(text.split())


def test_the_screen_counts_names_and_says_what_is_declined(broken):
    result = broken(*ONLY)
    lines = result.stdout.splitlines()
    assert re.match(
        r"mine \(mujoco [\d.]+\): 1 pass, 1 fail, 0 error, 1 decl", lines[0]
    )
    assert "Friction" in result.stdout or "friction" in result.stdout
    assert "Declined, 1: it knows no cloth" in result.stdout
    assert result.exit_code == 1
    assert "1 pass, 1 fail, 0 error, 1 declined of 3" in words_of(result.stderr)


@pytest.mark.parametrize(
    ("options", "statuses", "code"),
    [
        (("--only", "free-fall"), ["pass"], 0),
        (("--only", "cloth-stretch"), ["declined"], 1),
        (ONLY, ["pass", "fail", "declined"], 1),
    ],
)
def test_each_line_of_json_is_a_result(broken, options, statuses, code):
    result = broken(*options, "--json")
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert [row["status"] for row in rows] == statuses
    assert result.exit_code == code


def test_determinism_is_checked_whatever_is_chosen(monkeypatch, gauge):
    engine = Faulty(backend("mujoco"), FAULTS["noise"])
    find = "gauge_envs.tools.conformance.run.find_backend"
    monkeypatch.setattr(find, lambda name: engine)
    result = gauge("backend", "check", "mujoco", "--only", "free-fall", "--json")
    rows = {row["check"]: row for row in map(json.loads, result.stdout.splitlines())}
    assert rows["determinism"]["status"] == "fail"
    assert result.exit_code == 1


@pytest.mark.parametrize(
    "words",
    [
        ("nope",),
        ("mujoco", "--only", "nope"),
        ("--only", "free-fall"),
        ("mujoco", "--only", "free-fall", "slide"),
        ("mujoco", "--only", "free-fall", "--set", "nope=1"),
        ("x.json",),
        ("mujoco", "--out", "page.txt"),
    ],
)
def test_a_wrong_request_ends_with_2(gauge, words):
    result = gauge("backend", "check", *words)
    assert (result.exit_code, result.stdout) == (2, "")


def test_a_long_check_is_named(broken, monkeypatch):
    command = "gauge_envs.tools.conformance.command"
    monkeypatch.setattr(f"{command}.LONG_S", 0.001)
    monkeypatch.setattr(f"{command}.LINE_INTERVAL_S", 0.0)
    text = words_of(broken("--only", "slide").stderr)
    assert "mine: slide has run for" in text
    assert "1/1 mine: slide" in text


def test_levels_need_what_is_not_optional():
    results = list(run_checks("mujoco", only=["free-fall"]))
    assert levels(results) == {}
    passed = [replace(results[0], of=one, status=Status.PASS) for one in checks()]
    assert set(levels(passed).values()) == {"pass"}
    for one in checks():
        declined = [
            replace(result, status=Status.DECLINED) if result.of is one else result
            for result in passed
        ]
        verdict = levels(declined)[one.level]
        assert verdict == (
            "pass" if one.is_optional else f"incomplete, {one.id} declined"
        )


# --- expected failures -----------------------------------------------------------------------------------------------

VALUE = json.loads(
    json.dumps(
        next(
            run_checks(
                Faulty(backend("mujoco"), FAULTS["friction 20 % low"]), only=["slide"]
            )
        ).to_dict()
    )
)["measured"]
SLIDE = f'slide = {{ measured = {VALUE:.6g}, reason = "friction is low" }}\n'
CLOTH = '[declined]\n"cloth-*" = "no cloth"\n'


@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        (SLIDE + CLOTH, 0, ""),
        (CLOTH, 1, "slide fails, "),
        (SLIDE, 1, "cloth-stretch is declined (it knows no cloth); if that is right"),
        (SLIDE.replace("= 0", "= 9") + CLOTH, 1, "the list has 9."),
        (
            'free-fall = { measured = 1.0, reason = "late" }\n' + SLIDE + CLOTH,
            1,
            "free-fall passes, but is listed as failing (late): delete its line",
        ),
    ],
)
def test_exactly_the_listed_failures_happen(broken, tmp_path, text, code, words):
    file, badge = tmp_path / "known.toml", tmp_path / "badge.json"
    file.write_text(text)
    result = broken("--expected", file, "--badge", badge, *ONLY)
    assert result.exit_code == code
    assert words in words_of(result.stderr)
    found = json.loads(badge.read_text())
    assert found["message"] == "1 pass, 1 fail, 0 error, 1 declined of 3"
    assert (found["color"] == "red") == bool(code)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('slid = "low"', "unknown check 'slid'; did you mean slide,"),
        ('slide = "low"', "slide needs a value and a reason, as slide = { measured"),
        ('[declined]\n"clot-*" = "none"', "unknown check 'clot-*'"),
        ("slide", "cannot be read as TOML"),
    ],
)
def test_a_wrong_list_is_refused_before_anything_runs(broken, tmp_path, text, words):
    file = tmp_path / "known.toml"
    file.write_text(text)
    result = broken("--expected", file, *ONLY)
    assert (result.exit_code, result.stdout) == (2, "")
    assert words in words_of(result.stderr)


def test_checks_are_tests_of_pytest(tmp_path):
    known = 'time = { measured = 2.0, reason = "late" }\n[declined]\n"*" = "any"\n'
    (tmp_path / "known.toml").write_text(known)
    words = "-p gauge_pytest -p no:cacheprovider --gauge-engine mujoco --gauge-expected known.toml --junitxml out.xml"
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *words.split(), "-k", "free-fall or time"],
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
    assert cases["free-fall"].find("failure") is None
    assert "listed as failing (late)" in cases["time"].find("failure").get("message")


# --- columns ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def column():
    (found,) = engine_columns(["mujoco:PGS"], isolate=False)
    assert (
        len(list(run_column(found, ["free-fall", "foam-tension", "slide"], None))) == 3
    )
    return found


def test_columns_are_chosen_by_name():
    columns = engine_columns(["mujoco:*", "mujoco:PGS"], isolate=False)
    assert [one.name for one in columns] == ["default", "PGS", "CG", "out_of_box"]
    assert [one.name for one in engine_columns(["mujoco"], isolate=False)] == [
        "default"
    ]


def test_a_refused_scene_costs_one_check(column):
    found = {name: one.status.value for name, one in column.results.items()}
    assert found == {"free-fall": "pass", "slide": "pass", "foam-tension": "declined"}


def test_a_column_comes_back_and_another_check_is_not_counted(column, tmp_path):
    file = write_columns([column], tmp_path / "deep" / "column.json")
    (found,) = read_columns(file)
    assert (found.settings, found.versions, found.made) == (
        column.settings,
        column.versions,
        column.made,
    )
    for name, result in column.results.items():
        again = found.results[name]
        assert (again.of, again.status, again.missing, again.measured) == (
            result.of,
            result.status,
            result.missing,
            result.measured,
        )
    document = json.loads(file.read_text())
    document["columns"][0]["findings"]["slide"]["fingerprint"] = "0" * 12
    file.write_text(json.dumps(document))
    (found,) = read_columns(file)
    assert found.outdated == ("slide",)
    assert "slide" not in found.results
    with pytest.raises(ParameterError, match="mujoco PGS' is there twice"):
        with_columns([column], [file])


def test_another_file_is_refused(tmp_path):
    file = tmp_path / "other.json"
    for text in ("no json", '{"columns": []}', "[]"):
        file.write_text(text)
        with pytest.raises(ResultFileError, match="write it with gauge backend check"):
            read_columns(file)


def test_pages_are_made_of_files_without_a_run(column, tmp_path, gauge):
    first = write_columns([column], tmp_path / "first.json")
    other = replace(column, backend="other", name="default")
    second = write_columns([other], tmp_path / "second.json")
    page, both = tmp_path / "page.html", tmp_path / "both.json"
    result = gauge("backend", "check", first, second, "--out", page, "--out", both)
    assert result.exit_code == 0, result.output
    assert "mujoco PGS" in page.read_text() and "<td>other" in page.read_text()
    assert [one.title for one in read_columns(both)] == ["mujoco PGS", "other"]


@pytest.mark.parametrize(
    ("edits", "kind"),
    [
        ({}, None),
        ({"widths": 0.5}, None),
        ({"widths": 2.0}, "moved"),
        ({"status": Status.FAIL}, "mended"),
        ({"status": Status.DECLINED, "measured": None}, "mended"),
    ],
)
def test_a_baseline_names_what_changed(column, edits, kind):
    edited, now = dict(column.results), column.results["free-fall"]
    if "widths" in edits:
        edits = {"measured": now.measured + edits["widths"] * now.width}
    edited["free-fall"] = replace(now, **edits)
    before = replace(column, results=edited)
    found = [(one.now.check, one.kind) for one in changes([column], [before])]
    assert found == ([("free-fall", kind)] if kind else [])
    worse = [one.kind for one in changes([before], [column])]
    assert worse == {None: [], "moved": ["moved"], "mended": ["worse"]}[kind]


def test_results_so_far_are_in_the_file_where_a_run_is_stopped(
    tmp_path, monkeypatch, gauge
):
    from gauge_envs.tools.conformance import command

    file = tmp_path / "part.json"
    run = command._run

    def stopped(column, chosen, worker):
        yield next(run(column, chosen, worker))
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "_run", stopped)
    result = gauge("backend", "check", "mujoco", "--out", file, "--only", "time")
    assert result.exit_code != 0
    (found,) = read_columns(file)
    assert list(found.results) == ["time"]
