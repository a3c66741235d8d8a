"""Layouts and forms that the dataset may come in: the same trials give the same band, or the reason is named."""

import io
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


def npz(**arrays):
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def plain_csv(content):
    return csv_text(columns(content), RATE + UNIT)


def renamed_csv(content):
    """Metres, times, another order, case and spelling, and a column that nobody asked for."""
    table = {"Confidence": [1.0] * len(content["cube"]["x"])}
    for name, values in reversed(columns(content).items()):
        asset, _, key = name.rpartition(".")
        if key.startswith("q"):
            table[f"{asset.upper()}_quat_{key[1].upper()}"] = values
        elif key in "xyz":
            table[f"{asset.title()}_pos_{key.upper()} [m]"] = [
                value / 1e3 for value in values
            ]
    table["time_s"] = [
        round(frame / 30, 3) for frame in range(len(table["Confidence"]))
    ]
    return csv_text(table, separator=";")


def arrays(content):
    """Arrays by shape; nothing states unit or rate."""
    found = {}
    for name, asset in content.items():
        if isinstance(asset, dict) and "x" in asset:
            found[name] = np.column_stack([asset[key] for key in "xyz"])
            found[f"{name}_quat_wxyz"] = np.column_stack(
                [asset[f"q{key}"] for key in "wxyz"]
            )
        elif isinstance(asset, dict):
            ids = sorted(asset, key=int)
            found[name] = np.stack(
                [np.column_stack([asset[one][key] for key in "xyz"]) for one in ids],
                axis=1,
            )
    return npz(**found, frame=np.arange(len(next(iter(found.values())))))


def nested_json(content):
    """Assets one level down, rows in place of columns, another case of keys."""
    bodies = {}
    for name, asset in content.items():
        if isinstance(asset, dict) and "x" in asset:
            rows = [
                list(row) for row in zip(*(asset[key] for key in "xyz"), strict=True)
            ]
            bodies[name] = {
                "Position": rows,
                **{key.upper(): asset[key] for key in ("qx", "qy", "qz", "qw")},
            }
        elif isinstance(asset, dict):
            bodies[name] = {
                one: {key.upper(): values for key, values in entry.items()}
                for one, entry in asset.items()
            }
    return json.dumps(
        {"fps": 30, "Units": "Millimeters", "trial": {"bodies": bodies}}
    ).encode()


LAYOUTS = {
    "columns in place of objects": ("data/rigid/slope slider/csv/wood/task-3/trial-{}.csv", plain_csv, None),
    "other names, order, unit, times": ("trajectories/Slope_Slider/task_3/WOOD/trial {}/motion.csv", renamed_csv, None),
    "arrays by shape": ("mocap/wood/slope-slider/task-3/{}.npz", arrays, MILLIMETRES),
    "nested": ("data/rigid/trials/slope slider/wood/task-3/json/run-{}/motion/trial.json", nested_json, None),
    "no folder but those needed": ("slopeslider/wood/task-3/{}.json", nested_json, None),
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


@pytest.mark.parametrize("form", [plain_csv, arrays, nested_json])
def test_markers_are_read_in_every_form(form):
    (content,) = synthetic_trials(FOAM, [0.3]).contents
    suffix = {plain_csv: ".csv", arrays: ".npz", nested_json: ".json"}[form]
    (usual,), (found,) = (
        trial.markers.values()
        for trial in (
            parse_trial(json.dumps(content).encode()),
            parse_trial(form(content), suffix, MILLIMETRES),
        )
    )
    assert len(found) == len(usual)
    ids = sorted(usual, key=int)
    for mine, theirs in zip(sorted(found, key=int), ids, strict=True):
        np.testing.assert_array_equal(found[mine], usual[theirs])


def test_what_lies_beside_the_trials_is_named_and_is_no_fault(tmp_path, gauge):
    """As published this month: videos of world models and full trajectories beside the trials."""
    write_synthetic(tmp_path, SLIDER)
    contents = synthetic_trials(SLIDER).contents
    slider, table = "data/rigid/slope slider", plain_csv(contents[0])
    beside = {
        f"{slider}/full trajectories/wood/task-3": (
            "trial-1.csv",
            "'full trajectories' is neither",
        ),
        f"{slider}/csv/wood/task-3": (
            "trial-1.csv",
            f"1 files .csv of {SLIDER} are not read; its trials in data/",
        ),
        f"{slider}/video/wood": (
            "trial-1.mp4",
            "1 files .mp4 are not read; pictures hold no positions",
        ),
        f"{slider}/table": ("trial-1.parquet", "makes a CSV file of it"),
        "world-model-videos/wan22/slope slider/wood/task-3": (
            "trial-1.csv",
            "'world-model-videos' is neither",
        ),
        "metadata/rigid": ("slope slider.json", ""),
    }
    for place, (name, _) in beside.items():
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / name).write_bytes(table)
    notes = {finding.file: str(finding) for finding in find_trials(tmp_path).findings}
    assert set(notes) == set(beside)
    for place, (_, words) in beside.items():
        assert words in notes[place]
    assert gauge("data", "import", tmp_path).exit_code == 0
    assert imported(tmp_path)[SLIDER].used == len(AMOUNTS)


def test_a_folder_that_the_user_names_is_read(tmp_path):
    folder = tmp_path / "slope slider" / "full trajectories"
    for number, content in enumerate(synthetic_trials(SLIDER).contents):
        file = folder / "wood" / "task-3" / f"{number}.csv"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(plain_csv(content))
    words = r"(?s)no trial.*'full trajectories' is neither"
    with pytest.raises(DatasetError, match=words):
        find_trials(tmp_path)
    for named in (folder, folder / "wood" / "task-3"):
        assert imported(named)[SLIDER].used == len(AMOUNTS)


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


STATES = "--unit mm says that of files without one"


@pytest.mark.parametrize(
    ("content", "suffix", "what"),
    [
        (lambda c: arrays(c), ".npz", "FPS: it is missing; 30 is expected; --rate 30"),
        (lambda c: csv_text(columns(c), RATE), ".csv", STATES),
        (lambda c: csv_text({**columns(c), "Cube x": [1.0]}), ".csv", "Cube x: the key occurs twice"),
        (lambda c: csv_text({"cube.x [mm]": [1.0], "cube.y [m]": [1.0]}), ".csv", "columns are in mm, m"),
        (lambda c: csv_text({"cube.x [m]": [1.0]}, UNIT), ".csv", "it is mm, and columns are in m"),
        (lambda c: csv_text({"a": [1], "b": [2]}), ".csv", "no name of a column is known: a, b"),
        (lambda c: b"1,2,3\n4,5,6\n", ".csv", "it has no header"),
        (lambda c: b"cube.x,cube.y\n1\n", ".csv", "row 1: it has 1 columns; 2 are expected"),
        (lambda c: csv_text({"time_s": [0.0, 0.1, 0.15], "cube.x": [1, 1, 1]}), ".csv", "not evenly spaced"),
        (lambda c: csv_text({"time": [0.0, 0.01], "cube.x": [1, 1]}, UNIT), ".csv", "FPS: it is 100"),
        (lambda c: csv_text({"frame": [0, 1, 3], "cube.x": [1, 1, 1]}), ".csv", "it does not count by 1"),
        (lambda c: npz(cube=np.zeros((9, 7))), ".npz", r"its shape is \[9, 7\]"),
        (lambda c: npz(cube=np.array([{}], dtype=object)), ".npz", "it is not an NPZ file of numbers"),
        (lambda c: b"PK\x03\x04 cut", ".npz", "it is not an NPZ file of numbers"),
    ],
)  # fmt: skip
def test_what_cannot_be_told_is_an_error_that_says_what_to_do(content, suffix, what):
    (trial,) = synthetic_trials(SLIDER, [0.3]).contents
    with pytest.raises(TrialError, match=what):
        parse_trial(content(trial), suffix)


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


def test_empty_rows_are_a_fault_of_their_body_and_names_beside_lists_are_not():
    lists = {"x": [1.0], "y": [2.0], "z": [3.0]}
    content = {
        "FPS": 30,
        "unit": "mm",
        "cube": {"positions": []},
        "foam": {"1": lists | {"note": "left"}},
    }
    trial = parse_trial(json.dumps(content).encode())
    assert list(trial.faults) == ["cube"]
    np.testing.assert_array_equal(trial.markers["foam"]["1"], [[1.0, 2.0, 3.0]])
