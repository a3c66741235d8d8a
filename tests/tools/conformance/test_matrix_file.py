"""Columns of several environments share a page, and a column of other checks or another version is marked."""

import json
import math

import pytest

from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.pages.markdown import as_markdown
from gauge_envs.tools.conformance import Status, checks
from gauge_envs.tools.conformance.matrix import (
    MatrixColumn,
    changes,
    read_columns,
    run_column,
    with_columns,
    write_columns,
)
from gauge_envs.tools.conformance.words import matrix_document, tally

ONLY = ["free-fall", "foam-start", "slide-plane"]


@pytest.fixture(scope="module")
def column():
    found = MatrixColumn(backend="mujoco", name="PGS", settings={"solver": "PGS"})
    assert len(list(run_column(found, ONLY, None))) == 2
    return found


@pytest.fixture
def edited(column, tmp_path):
    """Function that writes the column with a change of its record."""

    def write(change):
        file = write_columns([column], tmp_path / "column.json")
        document = json.loads(file.read_text())
        change(document["columns"][0])
        file.write_text(json.dumps(document))
        return file

    return write


def test_a_column_comes_back_whole(column, tmp_path):
    (found,) = read_columns(write_columns([column], tmp_path / "deep" / "column.json"))
    assert (found.settings, found.refused, found.made) == (
        column.settings,
        column.refused,
        column.made,
    )
    assert found.versions == column.versions
    assert found.outdated == {}
    assert tally(found) == tally(column) == "2 of 2"
    for name, finding in column.findings.items():
        again = found.findings[name]
        assert (again.status, again.of) == (finding.status, finding.of)
        assert again.measured == pytest.approx(finding.measured, rel=1e-8)
        assert again.cpu_s == pytest.approx(finding.cpu_s, rel=1e-8)
        assert again.cpu_s


def test_a_number_that_is_not_finite_comes_back_as_none(edited):
    def change(record):
        record["findings"]["free-fall"]["status"] = "fail"
        del record["findings"]["free-fall"]["measured"]

    (found,) = read_columns(edited(change))
    assert found.findings["free-fall"].measured is not None
    assert math.isnan(found.findings["free-fall"].measured)


def test_a_result_of_another_check_is_marked_and_not_counted(edited):
    def change(record):
        record["findings"]["free-fall"]["fingerprint"] = "0" * 12
        record["findings"]["of-old"] = record["findings"]["free-fall"]

    file = edited(change)
    (found,) = read_columns(file)
    assert set(found.outdated) == {"free-fall", "of-old"}
    assert tally(found) == "1 of 1"
    text = as_markdown(matrix_document([found], checks(ONLY)))
    assert "⚠ other check" in text
    # The mark stays when the file is combined with others.
    assert read_columns(write_columns([found], file))[0].outdated == found.outdated


def test_a_column_of_another_version_is_marked(edited):
    (found,) = read_columns(edited(lambda record: record.update(gauge_envs="0.0.1")))
    assert not found.is_of_this_version
    assert "⚠ " + found.made + ", gauge-envs 0.0.1" in as_markdown(
        matrix_document([found], checks(ONLY))
    )


def test_a_column_is_in_one_file_only(column, tmp_path):
    file = write_columns([column], tmp_path / "column.json")
    with pytest.raises(ParameterError, match=r"mujoco PGS.*leave one of them out"):
        with_columns([column], [file])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("no json", "is no JSON document"),
        ('{"columns": []}', "kind: "),
        ('{"kind": "other", "columns": []}', "its kind is 'other'"),
        (
            '{"kind": "gauge-envs conformance matrix", "columns": [{}]}',
            r"columns\.0\.backend",
        ),
    ],
)
def test_another_file_is_refused_with_its_reason(tmp_path, text, message):
    file = tmp_path / "other.json"
    file.write_text(text)
    with pytest.raises(ResultFileError, match=message):
        read_columns(file)


def test_pages_are_made_of_files_without_a_run(column, tmp_path, gauge):
    """A page of two files has the columns of both, and no check runs."""
    first = write_columns([column], tmp_path / "first.json")
    other = MatrixColumn(
        backend="mine", name="default", settings={}, findings=dict(column.findings)
    )
    other.fingerprints = dict(column.fingerprints)
    second, page = (
        write_columns([other], tmp_path / "second.json"),
        tmp_path / "page.html",
    )
    both = tmp_path / "both.json"
    words = ["backend", "check", str(first), str(second)]
    result = gauge(*words, "--out", page, "--out", both, "--format", "markdown")
    assert result.exit_code == 0, result.output
    assert "| mujoco | PGS | solver = PGS | 2 of 2 |" in result.stdout
    assert "mine" in page.read_text()
    assert [(one.title, tally(one)) for one in read_columns(both)] == [
        ("mujoco PGS", "2 of 2"),
        ("mine", "2 of 2"),
    ]
    assert all(one.status is Status.PASS for one in other.findings.values())


@pytest.mark.parametrize(
    ("edits", "kind"),
    [
        ({}, None),
        ({"measured": 9.811}, None),  # Within the tolerance of 9.8 mm/s^2.
        ({"measured": 9.82}, "moved"),
        ({"status": "fail"}, "mended"),
        ({"status": "declined", "missing": ["it falls"]}, "mended"),
        ({"fingerprint": "another check"}, None),
    ],
)
def test_a_baseline_names_what_changed(column, edited, edits, kind):
    before = read_columns(
        edited(lambda record: record["findings"]["free-fall"].update(edits))
    )
    found = changes([column], before)
    assert [(one.now.check, one.kind) for one in found] == (
        [("free-fall", kind)] if kind else []
    )
    if kind == "mended":
        assert [one.kind for one in changes(before, [column])] == ["worse"]


def test_a_baseline_decides_the_exit_code(column, tmp_path, gauge):
    file = tmp_path / "before.json"
    arguments = ["backend", "check", "mujoco:out_of_box", "--only", "rebound-0.5"]
    assert gauge(*arguments, "--out", file).exit_code == 1
    assert gauge(*arguments, "--baseline", file).exit_code == 0
    file.write_text(
        file.read_text().replace('"status": "fail"', '"status": "pass"'),
    )
    worse = gauge(*arguments, "--baseline", file)
    assert (worse.exit_code, "worse" in worse.stdout) == (1, True)
    assert gauge("backend", "check", "mujoco", "--baseline", file).exit_code == 2
