"""Generated files are current or say that they are not, and the table `scripts/generated.toml` names each of them."""

import re
import shutil
import warnings

import pytest
from places import ROOT

from scripts import __main__ as command, inputs
from scripts.generated import same_text, stale_files, stale_note
from scripts.inputs import Row, changed, rows, staleness

ROWS = rows()
SLOW = "recordings"


@pytest.mark.parametrize(
    "row",
    [
        pytest.param(one, marks=[pytest.mark.slow] if one.name == SLOW else [])
        for one in ROWS.values()
    ],
    ids=lambda row: row.name,
)
def test_generated_files_are_current(row):
    """What takes hours may be older than its inputs; the pages that show it say so, and a release makes it anew."""
    assert all(any(ROOT.glob(pattern)) for pattern in row.patterns())
    faults = list(command.not_current(row))
    if row.measured and faults:
        warnings.warn(faults[0], stacklevel=1)
    else:
        assert faults == []


def test_each_row_has_a_builder_with_its_function_or_a_command():
    for row in ROWS.values():
        assert bool(row.builder) != bool(row.command), row.name
        if row.builder:
            wanted = "measure" if row.measured else "contents"
            assert callable(getattr(command.builder_of(row), wanted)), row.name


def test_every_measured_row_states_its_inputs_and_they_are_recorded():
    measured = [row for row in ROWS.values() if row.measured]
    assert set(inputs.recorded()) == {row.name for row in measured}
    assert [row.name for row in measured if not any(inputs.inputs(row))] == []


def test_every_builder_is_in_the_table():
    files = {file.stem for file in (ROOT / "scripts").glob("build_*.py")}
    builders = {row.builder for row in ROWS.values()} - {""}
    assert files == {name for name in builders if "." not in name}


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """A copy of what rows depend on."""
    copy = tmp_path_factory.mktemp("checkout")
    folders = ("tasks", "scoring", "scripts", "examples/sanity", "leaderboard")
    folders += ("studies/coverage",)
    packages = ("backends", "evaluation", "observables", "references", "scene")
    packages += ("runs", "tools")
    for folder in (*folders, *(f"gauge_envs/{one}" for one in packages)):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / folder, copy / folder, ignore=ignored)
    return copy


PRESETS = "gauge_envs/backends/pybullet/presets.toml"
SCORES = "gauge_envs/evaluation/metrics/trajectory.py"
CHANGES = (
    ("tasks/slope_slider.toml", "friction = 0.273673", "friction = 0.28"),
    (PRESETS, "steps_per_s = 9000", "steps_per_s = 18000"),
    (SCORES, "MAX_RELEASE_OFFSET_S = 10 / 30", "MAX_RELEASE_OFFSET_S = 11 / 30"),
    ("scripts/newest_versions.txt", "sapien==", "sapien==9"),
    ("scoring/trials/BouncingBall-rubber.csv", "frame,", "frame ,"),
    (PRESETS, "# Presets of", "# The presets of"),
    ("tasks/slope_slider.toml", "A cube on a board", "One cube on a board"),
    (SCORES, "def trajectory_rmse(", "# A comment.\ndef trajectory_rmse("),
)


def changed_inputs(checkout):
    """Names and digests of the changed inputs of each measured row, which may be older than some already."""
    return {
        row.name: {(one.name, one.digest) for one in changed(row, checkout)}
        for row in ROWS.values()
        if row.measured
    }


def test_a_changed_input_makes_its_measured_files_stale(checkout, approved):
    """The approved file lists, for each change, the rows that it makes stale."""
    before, lines = changed_inputs(checkout), []
    for file, old, new in CHANGES:
        path = checkout / file
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))
        after = changed_inputs(checkout)
        path.write_text(text)
        stale = sorted(name for name in before if after[name] != before[name])
        lines += [f"{file}: {old}", *(f"    {name}" for name in stale)]
    approved("docs/stale", "\n".join(lines))


def test_stale_files_are_named_with_the_input_the_command_and_its_cost(
    checkout, monkeypatch
):
    row = ROWS["sensitivities"]
    current = {one.name: one.digest for one in inputs.inputs(row)}
    monkeypatch.setattr(inputs, "recorded", lambda: {row.name: current})
    assert staleness(row) == "" == staleness(row, checkout)
    current["tasks/turntable.toml"] = "another"
    text = staleness(row)
    assert text.startswith("scoring/sensitivities/")
    assert "Turntable" in text
    assert "SlopeSlider" not in text
    assert "tasks/turntable.toml changed" in text
    assert text.endswith(f"python -m scripts build sensitivities ({row.cost})")
    current["gone"] = "1"
    assert "gone" in staleness(row)


def test_a_page_says_that_its_data_are_older_than_an_input(monkeypatch):
    row = ROWS["conformance-data"]
    current = {one.name: one.digest for one in inputs.inputs(row)}
    monkeypatch.setattr(inputs, "recorded", lambda: {row.name: current})
    assert stale_note(row.name) == []
    preset = "gauge_envs/backends/rapier/presets.toml"
    current[preset] = "another"
    (line, _) = stale_note(row.name)
    assert preset in line
    (page,) = (
        text
        for file, text in command.builder_of(ROWS["conformance"]).contents().items()
        if file.name == "conformance.md"
    )
    assert line in page


def test_files_that_name_their_script_are_in_its_row():
    by_builder = {}
    for row in ROWS.values():
        by_builder.setdefault(row.builder, set()).update(row.files())
    marked = 0
    copies = ROOT / "docs" / "studies"  # Of a build of the docs.
    for folder in ("docs", "scoring", "studies"):
        for file in (ROOT / folder).rglob("*"):
            if (
                file.suffix in (".md", ".toml", ".csv")
                and "_build" not in file.parts
                and file.parent != copies
            ):
                for script in re.findall(
                    r"ritten by scripts/(\w+)\.py", file.read_text()
                ):
                    marked += 1
                    assert file in by_builder[script], f"{file} names {script}"
    assert marked > 40


PRINTED = (
    "frame,mean\n12,501.235,-0.0274632,0.5,8.1e-05,0.030000000000000013\n"
    "sha256 = 1e5f, version 3.11.0, 17.5 mm.\n"
)


@pytest.mark.parametrize(
    ("stored", "generated"),
    [
        ("501.235", "501.236"),
        ("-0.0274632", "-0.0274633"),
        ("8.1e-05", "8.11e-05"),
        ("8.1e-05", "8.0e-05"),
        ("0.030000000000000013", "0.03"),
        ("0.030000000000000013", "0.03000000000000032"),
    ],
)
def test_the_last_printed_place_of_a_number_is_that_of_another_processor(
    stored, generated
):
    assert same_text(PRINTED, PRINTED.replace(stored, generated))
    assert same_text(PRINTED.replace(stored, generated), PRINTED)


@pytest.mark.parametrize(
    ("stored", "generated"),
    [
        ("12", "13"),
        ("501.235", "501.237"),
        ("501.235", "501"),
        ("-0.0274632", "-0.0274634"),
        ("-0.0274632", "0.0274632"),
        ("0.5", "0.6"),
        ("0.5", "5"),
        ("17.5", "17.6"),
        ("8.1e-05", "8.1e-04"),
        ("8.1e-05", "8.3e-05"),
        ("0.030000000000000013", "0.0300000001"),
        ("mean", "means"),
        ("version", "Version"),
        ("1e5f", "1e6f"),
        ("3.11.0", "3.11.1"),
        (",501.235", ", 501.235"),
        (",501.235", ""),
        (",501.235", ",501.235,501.235"),
        ("12,", "11,0.0\n12,"),
        ("mm.\n", "mm."),
        ("mm.\n", "mm.\n\n"),
    ],
)
def test_every_other_difference_of_a_generated_file_is_found(
    stored, generated, tmp_path
):
    file = tmp_path / "a.csv"
    assert stale_files({file: PRINTED}) == [file]
    file.write_text(PRINTED.replace(stored, generated))
    assert stale_files({file: PRINTED}) == [file]
    file.write_text(PRINTED)
    assert stale_files({file: PRINTED}) == []


def test_the_command_writes_what_is_stale_and_checks_it(tmp_path, monkeypatch, capsys):
    builder = command.builder_of(ROWS["silicone-beam"])
    file = tmp_path / "a.csv"
    monkeypatch.setattr(builder, "contents", lambda: {file: PRINTED})
    monkeypatch.setattr(command, "ROOT", tmp_path)
    monkeypatch.setattr(Row, "patterns", lambda row: ["a.csv"])
    assert command.main(["build", "--check", "silicone-beam"]) == 1
    assert "run python -m scripts build silicone-beam" in capsys.readouterr().err
    assert command.main(["build", "silicone-beam"]) == 0
    assert command.main(["build", "--check", "silicone-beam"]) == 0
    assert command.main(["build", "--check", "nothing"]) == 2
    assert command.main(["build", "--list", "sensitivities"]) == 0
    assert ROWS["sensitivities"].cost in capsys.readouterr().out
