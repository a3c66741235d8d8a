"""`gauge backend check`: screen, JSON, expected failures, files of results, a baseline, and engines that die."""

import json
import math
import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest
from faults import FAULTS, Faulty
from test_conformance import KnowsNoCloth

from gauge_envs.backends import backend, registry
from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.runs import workers
from gauge_envs.tools.conformance import Status
from gauge_envs.tools.conformance.expectations import StoredBaseline, read_baseline
from gauge_envs.tools.conformance.report import comparison
from gauge_envs.tools.conformance.results import (
    engine_columns,
    read_columns,
    run_column,
    write_columns,
)
from gauge_envs.tools.conformance.run import run_check

FIND = "gauge_envs.tools.conformance.run.find_backend"
RUN = "gauge_envs.tools.conformance.run.run_check"
ONLY = ("--only", "slide", "--only", "free-fall", "--only", "cloth-stretch")


@pytest.fixture(scope="module")
def measured():
    """Each check of `mine` runs once for all tests."""
    results = {}

    def run(lab, check):
        if check.id not in results:
            results[check.id] = run_check(lab, check)
        return results[check.id]

    return run


@pytest.fixture
def broken(monkeypatch, gauge, measured):
    """Run the command on `mine`, an engine with 20 % too little friction and without cloth."""
    engine = KnowsNoCloth(backend("mujoco"), FAULTS["friction 20 % low"])
    engine.name = "mine"
    monkeypatch.setattr(RUN, measured)
    monkeypatch.setattr(registry, "is_bundled", lambda name: True)
    results = "gauge_envs.tools.conformance.results.backend_names"
    monkeypatch.setattr(results, lambda: ["mine"])
    monkeypatch.setattr(FIND, lambda name: engine)
    return lambda *words: gauge("backend", "check", "mine", *words)


def joined(text):
    return " ".join(text.split())


def rows_of(result):
    return [json.loads(line) for line in result.stdout.splitlines()]


# --- one engine ------------------------------------------------------------------------------------------------------


def test_the_screen_has_counts_failures_and_unsupported_checks(broken):
    result = broken(*ONLY)
    counts = "1 pass, 1 fail, 0 error, 1 unsupported of 3"
    assert re.match(rf"mine \(mujoco [\d.]+\): {counts}", joined(result.stdout))
    assert "slide" in result.stdout
    assert "Unsupported, 1: it knows no cloth" in result.stdout
    assert counts not in joined(result.stderr)
    assert result.exit_code == 1


@pytest.mark.parametrize(
    ("options", "statuses", "code"),
    [
        (("--only", "free-fall"), ["pass"], 0),
        (("--only", "cloth-stretch"), ["unsupported"], 1),
        (ONLY, ["pass", "fail", "unsupported"], 1),
    ],
)
def test_each_line_of_json_is_a_result(broken, options, statuses, code):
    result = broken(*options, "--json")
    assert [row["status"] for row in rows_of(result)] == statuses
    assert result.exit_code == code


def test_determinism_is_checked_whatever_is_chosen(monkeypatch, gauge):
    engine = Faulty(backend("mujoco"), FAULTS["noise"])
    monkeypatch.setattr(FIND, lambda name: engine)
    result = gauge("backend", "check", "mujoco", "--only", "free-fall", "--json")
    statuses = {row["check"]: row["status"] for row in rows_of(result)}
    assert statuses["determinism"] == "fail"
    assert result.exit_code == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("nope",), "unknown backend 'nope'"),
        (("mujoco", "--only", "nope"), "unknown check 'nope'"),
        (("mujoco", "--only", "free-fall", "slide"), "'slide' is a check and no back"),
        (("mujoco", "--only", "time", "--set", "nope=1"), "unknown setting"),
        (("mujoco", "--out", "page.txt"), "page.txt"),
        (("mujoco", "--timeout", "0"), "expected a positive number"),
    ],
)
def test_a_wrong_request_ends_with_2_and_says_why(gauge, words, message):
    result = gauge("backend", "check", *words)
    assert (result.exit_code, result.stdout) == (2, "")
    assert message in joined(result.stderr)


# --- expected failures -----------------------------------------------------------------------------------------------

CLOTH = '[unsupported]\n"cloth-*" = "no cloth"\n'


@pytest.mark.parametrize(
    ("text", "code", "message"),
    [
        ("SLIDE" + CLOTH, 0, ""),
        (CLOTH, 1, "slide fails, "),
        (
            "SLIDE",
            1,
            "cloth-stretch is unsupported (it knows no cloth); if that is right",
        ),
        ("9SLIDE" + CLOTH, 1, "the list has 9"),
        (
            'cloth-stretch = { measured = 1.0, reason = "soft" }\nSLIDE' + CLOTH,
            1,
            "cloth-stretch is unsupported, but is listed as failing (soft)",
        ),
        (
            'free-fall = { measured = 1.0, reason = "late" }\nSLIDE' + CLOTH,
            1,
            "free-fall passes, but is listed as failing (late): delete its line",
        ),
    ],
)
def test_exactly_the_listed_failures_happen(broken, tmp_path, text, code, message):
    """`SLIDE` stands for the line with the slide's value, `9SLIDE` for a line with the value 9."""
    file = tmp_path / "known.toml"
    (row,) = rows_of(broken("--only", "slide", "--json"))
    for mark, value in (("9SLIDE", 9.0), ("SLIDE", row["measured"])):
        line = f'slide = {{ measured = {value:.6g}, reason = "friction is low" }}\n'
        text = text.replace(mark, line)
    file.write_text(text)
    result = broken("--expected", file, *ONLY)
    assert result.exit_code == code
    assert message in joined(result.stderr)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('slid = "low"', "unknown check 'slid'; did you mean slide,"),
        ('slide = "low"', "slide: Input should be a valid dictionary"),
        ("unsupported = 3", "a valid dictionary (given: 3); write slide = { measured"),
        ('[unsupported]\n"cloth-*" = 3', "cloth-*: Input should be a valid string"),
        ('[unsuported]\n"cloth-*" = "x"', "did you mean unsupported?"),
        (
            'slide = { measured = "9", reason = "low" }',
            "slide.measured: Input should be",
        ),
        (
            'slide = { measured = 9.0, reason = " " }',
            "slide.reason: String should have",
        ),
        ('slide = { value = 9.0, reason = "low" }', "slide.value: unknown key; write"),
        ('[unsupported]\n"cloth-*" = ""', "cloth-*: String should have at least 1"),
    ],
)
def test_a_wrong_list_is_rejected_before_anything_runs(broken, tmp_path, text, message):
    file = tmp_path / "known.toml"
    file.write_text(text)
    result = broken("--expected", file, *ONLY)
    assert (result.exit_code, result.stdout) == (2, "")
    assert message in joined(result.stderr)


class Here:
    """A worker that calls in this process."""

    def __init__(self, time_limit_s):
        self.close = lambda: None

    def call(self, function, *arguments):
        return function(*arguments)


@pytest.fixture
def failed_tests(tmp_path, monkeypatch, capsys):
    """Return a function: messages of the failed tests by name, of pytest with an option of the plug-in."""
    monkeypatch.setattr(workers, "Worker", Here)
    # The entry point may be that of another installed version.
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.chdir(tmp_path)

    def run(option, file):
        options = "-p gauge_envs.pytest_plugin -p no:cacheprovider"
        options += " -p no:faulthandler --junitxml out.xml --gauge-engine mujoco"
        options += f" --rootdir {tmp_path}"
        command = [*options.split(), option, file, "-k", "start- or time"]
        assert pytest.main(command) == pytest.ExitCode.TESTS_FAILED
        cases = list(ElementTree.parse(tmp_path / "out.xml").iter("testcase"))
        assert len(cases) > 2
        failures = {case.get("name"): case.find("failure") for case in cases}
        return {
            name: failure.get("message")
            for name, failure in failures.items()
            if failure is not None
        }

    return run


def test_checks_are_tests_of_pytest(failed_tests, tmp_path):
    known = 'time = { measured = 2.0, reason = "late" }\n[unsupported]\n"*" = "any"\n'
    (tmp_path / "known.toml").write_text(known)
    failures = failed_tests("--gauge-expected", "known.toml")
    assert [*failures] == ["time"]
    assert "listed as failing (late)" in failures["time"]


def test_a_value_that_moved_since_the_baseline_fails(failed_tests, tmp_path, column):
    earlier = replace(column, name="default", results={})
    list(run_column(earlier, ["start-*", "time"], None))
    result = earlier.results["time"]
    earlier.results["time"] = replace(result, measured=result.measured + 2.0)
    write_columns([earlier], tmp_path / "before.json")
    failures = failed_tests("--gauge-baseline", "before.json")
    assert [*failures] == ["time"]
    assert "moved: pass" in failures["time"]


# --- columns ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def column():
    (column,) = engine_columns(["mujoco:PGS"], isolate=False)
    list(run_column(column, ["free-fall", "foam-tension", "slide"], None))
    return column


def test_a_column_comes_back_from_its_file_except_a_changed_check(column, tmp_path):
    file = write_columns([column], tmp_path / "deep" / "column.json")
    (stored,) = read_columns(file)
    assert (stored.settings, stored.versions) == (column.settings, column.versions)
    for name, result in column.results.items():
        again = stored.results[name]
        for key in ("of", "status", "missing", "measured", "expected", "width"):
            assert getattr(again, key) == getattr(result, key)
    document = json.loads(file.read_text())
    document["columns"][0]["results"]["slide"]["fingerprint"] = "0" * 12
    file.write_text(json.dumps(document))
    (stored,) = read_columns(file)
    assert "slide" not in stored.results
    file.write_text('{"columns": []}')
    with pytest.raises(ResultFileError, match="write it with gauge backend check"):
        read_columns(file)


# --- an earlier version ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("widths", "status", "kind"),
    [
        (0.5, Status.PASS, None),
        (2.0, Status.PASS, "moved"),
        (math.inf, Status.PASS, "moved"),
        (0.0, Status.FAIL, "worse"),
        (None, Status.UNSUPPORTED, "worse"),
    ],
)
def test_a_baseline_names_what_moved_or_got_worse(column, widths, status, kind):
    """A value moved if it differs by more than the tolerance of its check."""
    earlier = column.results["free-fall"]
    value = None if widths is None else earlier.measured + widths * earlier.width
    now = replace(earlier, status=status, measured=value)
    difference = baseline_of(earlier).difference(now)
    assert (difference or "").partition(":")[0] == (kind or "")
    # What is fixed is no reason to fail.
    fixed = baseline_of(now).difference(earlier)
    assert (fixed is None) == (kind in (None, "worse"))


def baseline_of(result):
    return StoredBaseline(results={(result.configuration, result.check): result})


def test_a_baseline_without_the_configuration_is_rejected(column, tmp_path, gauge):
    file = write_columns([column], tmp_path / "before.json")
    with pytest.raises(ParameterError, match="no results of mujoco:CG; it has PGS"):
        read_baseline(file, "mujoco", ["CG"])
    result = gauge("backend", "check", "mujoco", "--baseline", file, "--only", "time")
    assert (result.exit_code, result.stdout) == (2, "")


def test_a_baseline_decides_the_exit_code(column, tmp_path, broken):
    slow = replace(column, backend="mine", name="default", results={})
    for name, result in column.results.items():
        slow.results[name] = replace(result, backend="mine", configuration="default")
    file = write_columns([slow], tmp_path / "before.json")
    result = broken("--baseline", file, *ONLY)
    assert result.exit_code == 1
    assert "not expected: slide worse: pass, " in joined(result.stderr)
    result = broken("--baseline", file, "--only", "free-fall")
    assert result.exit_code == 0


# --- a stopped run ---------------------------------------------------------------------------------------------------


def test_results_so_far_are_in_the_file_where_a_run_is_stopped(
    tmp_path, monkeypatch, gauge
):
    file = tmp_path / "part.json"

    def stopped(column, chosen, worker):
        yield next(run_column(column, ["time"], None))
        raise KeyboardInterrupt

    place = "gauge_envs.tools.conformance.results.run_column"
    monkeypatch.setattr(place, stopped)
    result = gauge("backend", "check", "mujoco", "--out", file, "--only", "time")
    assert result.exit_code != 0
    (column,) = read_columns(file)
    assert list(column.results) == ["time"]


# --- engines that die ------------------------------------------------------------------------------------------------

THREE = ("--only", "free-fall", "--only", "slide", "--only", "stated-inertia")
"""Checks of which only the second has contacts."""


@pytest.mark.parametrize(
    ("name", "options", "cause"),
    [
        ("contact-crash", ("--isolate",), "the engine's process died with signal 11"),
        pytest.param(
            "contact-exit", ("--isolate",), "SystemExit: 5", marks=pytest.mark.slow
        ),
        pytest.param(
            "contact-hang",
            ("--timeout", "10s"),
            "the engine did not finish within the time limit of 10 s",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "contact-greedy",
            ("--timeout", "60s", "--memory", "0.8GB"),
            "MemoryError",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_an_engine_that_dies_costs_one_check(installed, gauge, name, options, cause):
    installed(name)
    result = gauge("backend", "check", name, "--json", *THREE, *options)
    rows = {row["check"]: row for row in rows_of(result)}
    assert cause in rows["slide"]["diagnosis"]
    statuses = [row["status"] for row in rows.values()]
    assert sorted(statuses) == ["error", "pass", "pass"]
    assert result.exit_code == 1


def test_an_engine_that_cannot_be_imported_is_an_error(installed, gauge):
    installed("at-import")
    result = gauge("backend", "check", "at-import", *THREE)
    assert (result.exit_code, result.stdout) == (2, "")
    assert "SystemExit: 3" in result.stderr


def test_several_engines_are_columns_of_one_table(column):
    slide = replace(column.results["slide"], status=Status.FAIL, measured=0.8)
    other = replace(column, name="CG", results={**column.results, "slide": slide})
    table = comparison([column, other])
    assert [entry.title for entry in table.columns][2:] == ["mujoco PGS", "mujoco CG"]
    counts, failed = table.rows
    assert counts == ["passed", "", "2 of 2", "1 of 2"]
    assert failed == ["slide", "1 +- 0.01", "✓", "✗ 0.8"]
