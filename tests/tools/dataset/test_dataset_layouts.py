"""Layouts and forms that the dataset may come in: the same trials give the same band, or the reason is named."""

import json

import numpy as np
import pytest
from dataset_writer import (
    AMOUNTS,
    synthetic_trials,
    trial_folder,
    write_synthetic,
    write_trial,
)
from imports import band_of, imported

from gauge_envs.errors import DatasetError
from gauge_envs.tools.dataset.findings import TrialError
from gauge_envs.tools.dataset.forms import Stated
from gauge_envs.tools.dataset.layout import find_trials
from gauge_envs.tools.dataset.trial import parse_trial

SLIDER, FOAM = "SlopeSlider-3-wood", "FoamStretching-soft"
MILLIMETRES = Stated(unit="mm", rate_hz=30.0)

RATE, UNIT = "# fps: 30\n", "# unit: mm\n"


def columns(content):
    """Lists of all assets by dotted names: `cube.x`, `foam.17.x`."""
    found = {}
    for name, asset in content.items():
        for key, entry in asset.items() if isinstance(asset, dict) else ():
            found |= (
                {f"{name}.{key}.{k}": v for k, v in entry.items()}
                if isinstance(entry, dict)
                else {f"{name}.{key}": entry}
            )
    return found


def csv_text(table, comments="", separator=","):
    rows = [
        separator.join(table),
        *(
            separator.join("" if v is None else f"{v}" for v in row)
            for row in zip(*table.values(), strict=False)
        ),
    ]
    return (comments + "\n".join(rows) + "\n").encode()


def plain_csv(content):
    return csv_text(columns(content), RATE + UNIT)


def other_csv(content):
    """Semicolons, another order, and columns that nobody asked for; neither rate nor unit."""
    table = {"Confidence": [1.0] * len(content["cube"]["x"])}
    table |= reversed(columns(content).items())
    table["time_s"] = [frame / 30 for frame in range(len(table["Confidence"]))]
    return csv_text(table, separator=";")


def plain_json(content):
    return json.dumps(content).encode()


LAYOUTS = {
    "columns in place of objects": ("data/rigid/slope slider/csv/wood/task-3/trial-{}.csv", plain_csv, None),
    "other order of folders and columns": ("trajectories/Slope_Slider/task_3/WOOD/{}.csv", other_csv, MILLIMETRES),
    "no folder but those needed": ("slopeslider/wood/task-3/{}.json", plain_json, None),
}  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_same_trials_give_the_same_band_and_driver(layout, tmp_path):
    path, form, stated = LAYOUTS[layout]
    write_synthetic(tmp_path / "published", SLIDER)
    usual = imported(tmp_path / "published")[SLIDER]
    band = band_of(SLIDER)
    for number, content in enumerate(synthetic_trials(SLIDER).contents, start=1):
        file = tmp_path / "other" / path.format(number)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(form(content))
    one = imported(tmp_path / "other", stated=stated)[SLIDER]
    assert (one.used, one.findings) == (len(AMOUNTS), ())
    again = band_of(SLIDER)
    np.testing.assert_allclose(again.mean, band.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(again.sigma, band.sigma, rtol=0, atol=1e-9)
    assert one.facts.drivers[0].residual_mm == pytest.approx(
        usual.facts.drivers[0].residual_mm, abs=1e-9
    )


def test_markers_are_read_in_both_forms():
    (content,) = synthetic_trials(FOAM, [0.3]).contents
    (usual,) = parse_trial(plain_json(content)).markers.values()
    (found,) = parse_trial(plain_csv(content), ".csv").markers.values()
    assert sorted(found) == sorted(usual)
    for marker, positions in usual.items():
        np.testing.assert_array_equal(found[marker], positions)


def test_what_lies_beside_the_trials_is_named_and_is_no_fault(tmp_path, gauge):
    """As published this month: videos of world models and full trajectories beside the trials."""
    write_synthetic(tmp_path, SLIDER)
    slider, table = (
        "data/rigid/slope slider",
        plain_csv(synthetic_trials(SLIDER).contents[0]),
    )
    beside = {
        f"{slider}/full trajectories/wood/task-3": "'full trajectories' is neither",
        f"{slider}/csv/wood/task-3": f"1 files .csv of {SLIDER} are not read; those of .json count",
        "world-model-videos/wan22/slope slider/wood/task-3": "'world-model-videos' is neither",
    }
    for place in beside:
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / "trial-1.csv").write_bytes(table)
    (tmp_path / slider / "video").mkdir()
    (tmp_path / slider / "video" / "trial-1.mp4").write_bytes(b"")
    notes = {finding.file: str(finding) for finding in find_trials(tmp_path).findings}
    assert set(notes) == set(beside)
    for place, words in beside.items():
        assert words in notes[place]
    assert gauge("data", "import", tmp_path).exit_code == 0
    assert imported(tmp_path)[SLIDER].used == len(AMOUNTS)


def test_a_folder_of_a_task_is_read_and_one_of_another_name_is_not(tmp_path):
    for number, content in enumerate(synthetic_trials(SLIDER).contents):
        for name in ("trials", "full trajectories"):
            folder = tmp_path / name / "slope slider" / "wood" / "task-3"
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{number}.csv").write_bytes(plain_csv(content))
    task = tmp_path / "trials" / "slope slider"
    for named in (task, task / "wood", task / "wood" / "task-3"):
        assert imported(named)[SLIDER].used == len(AMOUNTS)
    task.rename(tmp_path / "trials" / "slider")
    words = r"(?s)no trial.*'full trajectories' is neither"
    with pytest.raises(DatasetError, match=words):
        find_trials(tmp_path)


def test_a_part_of_the_dataset_is_read(tmp_path):
    """One task without its other materials; a trial without the driver; samples that were not captured."""
    contents = synthetic_trials(SLIDER).contents
    del contents[0]["board"]
    tables = [columns(content) for content in contents]
    tables[1]["cube.x"][4] = None
    folder = tmp_path / "rigid" / "slope slider" / "json" / "wood" / "task-3"
    folder.mkdir(parents=True)
    for number, table in enumerate(tables):
        (folder / f"{number}.csv").write_bytes(csv_text(table, RATE + UNIT))
    one = imported(tmp_path)[SLIDER]
    assert (one.used, one.facts.drivers[0].trial_count) == (4, 3)
    (finding,) = one.findings
    assert (finding.key, finding.left_out) == ("board", False)


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (lambda c: csv_text(columns(c), UNIT), "FPS: it is missing; 30 is expected; --rate 30"),
        (lambda c: csv_text(columns(c), RATE), "--unit mm states that of files without one"),
        (lambda c: csv_text({"a": [1], "b": [2]}, RATE + UNIT), "it holds no asset"),
        (lambda c: csv_text(columns(c)).replace(b"cube.qx", b"cube.x"), "a column occurs twice"),
        (lambda c: b"cube.x,cube.y\n", "a header and rows of equal length are needed"),
        (lambda c: b"cube.x,cube.y\n1\n", "a header and rows of equal length are needed"),
        (lambda c: b"\xff\xfe", "it is not CSV"),
    ],
)  # fmt: skip
def test_what_cannot_be_told_is_an_error_that_says_what_to_do(content, what):
    (trial,) = synthetic_trials(SLIDER, [0.3]).contents
    with pytest.raises(TrialError, match=what):
        parse_trial(content(trial), ".csv")


def test_links_and_empty_tables_cost_nothing_but_their_files(tmp_path):
    folder = tmp_path / trial_folder(SLIDER)
    folder.mkdir(parents=True)
    contents = synthetic_trials(SLIDER).contents
    for number, content in enumerate(contents):
        (folder / f"{number}.csv").write_bytes(plain_csv(content))
    (folder / "up").symlink_to(tmp_path)
    empty = {name: [None] * 40 for name in columns(contents[0])}
    (folder / "never.csv").write_bytes(csv_text(empty, RATE + UNIT))
    one = imported(tmp_path)[SLIDER]
    assert one.used == len(AMOUNTS)
    (finding,) = one.findings
    assert finding.file.endswith("never.csv")
    assert finding.problem == "it was never captured"


def test_the_command_takes_unit_and_rate(tmp_path, gauge):
    for number, content in enumerate(synthetic_trials(SLIDER).contents):
        bodies = {key: content[key] for key in ("cube", "board")}
        write_trial(tmp_path, SLIDER, number, bodies)
    refused = gauge("data", "import", tmp_path, "--rate=30")
    assert refused.exit_code == 1 and "--unit mm" in refused.stderr
    assert gauge("data", "import", tmp_path, "--rate=30", "--unit=mm").exit_code == 0
