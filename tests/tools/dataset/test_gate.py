"""One damaged trial among clean ones is left out by name, or changes nothing; clean trials are never left out.

A change counts if it moves the mean by more than 1 mm, a prescribed motion by more than 1 mm or 1 mrad, or a baseline
by more than 5 %.
"""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest
from damages import (
    FILE_DAMAGES,
    LOST_DAMAGES,
    RECORDING_DAMAGES,
    UNSEEN_LOST_DAMAGES,
    UNSEEN_RECORDING_DAMAGES,
    as_text,
    clean_contents,
    damaged,
)
from dataset_writer import write_trial
from imports import band_of, imported

from gauge_envs import load_experiment
from gauge_envs.references.band import load_band
from gauge_envs.references.imported import load_imported
from gauge_envs.scoring.trajectory import score_trajectory
from gauge_envs.scoring.user_file.gate import band_fault, trial_faults
from gauge_envs.tools.dataset import importer

SLIDER, PLATE, ROPE = "SlopeSlider-2-wood", "Turntable-2-wood", "RopeWinding-rubber"
ALL_DAMAGES = LOST_DAMAGES | RECORDING_DAMAGES

PARTS = {
    SLIDER: [("cube", None)],
    "BouncingBall-rubber": [("ball", None)],
    PLATE: [("cube", None)],
    ROPE: [("ball-1", None), ("billiard", None)],
    "SlopeSlider-3-wood": [("cube", None), ("board", None)],
    "TableclothPulling-wood": [("rod", None)],
    # Its foam bends by 1 mm, so that half of the motion is as near as noise.
    "FoamBending-soft": [("foam", 3), ("cube", None)],
    "FoamStretching-hard": [("foam", 7), ("base-2", None)],
    "StickStack-soft": [("rod", 1), ("base", None)],
}
"""Bodies, markers by their index, and driven bodies of the variants."""


@pytest.fixture(autouse=True)
def without_jackknife(monkeypatch):
    """Leave out the uncertainty of the baseline, which takes most of the time of an import and changes nothing here."""
    monkeypatch.setattr(importer, "baselines_without", lambda trials: None)


def import_files(root, name, files):
    for number, file in enumerate(files):
        write_trial(root, name, number, file.encode())
    return imported(root)[name]


def changes(name, clean, outcome):
    """Return what an import changed, given `facts_of` of the clean one."""
    mean, baselines, driven = clean
    new_mean, new_baselines, new_driven = facts_of(name, outcome)
    found = []
    if band_of(name).unit == "mm":
        distance = np.nan_to_num(np.abs(new_mean - mean), nan=np.inf)
        found += ["mean"] * bool((distance > 1.0).any())
    for metric, value in baselines.items():
        ratio = (new_baselines.get(metric) or 0.0) / value if value else 1.0
        found += [metric] * (abs(ratio - 1.0) > 0.05)
    for body, values in driven.items():
        if (
            body not in new_driven
            or np.nanmax(np.abs(new_driven[body] - values)) > 1e-3
        ):
            found.append(body)
    assert np.isfinite(band_of(name).trial_rmse_aligned).all()
    return found


def facts_of(name, outcome):
    baselines = {line["metric"]: line["own_mean"] for line in outcome.baselines}
    return band_of(name).mean, baselines, load_imported(name).driver_values


def silent(root, name, rng, cases):
    """Return the damages that change an import without a word; `cases` make the text of the first file."""
    contents = clean_contents(name, rng)
    texts = [*map(as_text, contents)]
    outcome = import_files(root, name, texts)
    assert outcome.findings == []
    clean, found = facts_of(name, outcome), []
    for damage, make in cases.items():
        outcome = import_files(root, name, [make(copy.deepcopy(contents)), *texts[1:]])
        is_named = any(
            finding.left_out and finding.problem for finding in outcome.findings
        )
        if not is_named and (changed := changes(name, clean, outcome)):
            found.append((damage, changed))
        assert outcome.used >= len(texts) - 1, (damage, outcome.findings)
    return found


def path_cases(name, part, damages, rng):
    asset, marker = part
    return {
        damage: lambda contents, change=change: as_text(
            damaged(contents[0], load_experiment(name), asset, marker, change, rng)
        )
        for damage, change in damages.items()
    }


def drawn(damages, rng, count):
    names = rng.choice([*damages], size=count, replace=False)
    return {name: damages[name] for name in names}


@pytest.mark.parametrize("name", [SLIDER, PLATE])
def test_a_damaged_trial_is_named(name, tmp_path):
    rng = np.random.default_rng(5)
    (part,) = PARTS[name]
    cases = path_cases(name, part, drawn(ALL_DAMAGES, rng, 5), rng)
    assert silent(tmp_path, name, rng, cases | drawn(FILE_DAMAGES, rng, 3)) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lost", "recording"),
    [
        (LOST_DAMAGES, RECORDING_DAMAGES),
        (UNSEEN_LOST_DAMAGES, UNSEEN_RECORDING_DAMAGES),
    ],
    ids=["seen", "unseen"],
)
@pytest.mark.parametrize(
    ("name", "part"), [(name, part) for name in PARTS for part in PARTS[name]]
)
def test_each_damaged_trial_is_named(name, part, lost, recording, tmp_path):
    rng = np.random.default_rng(len(lost))
    _, marker = part
    damages = lost | recording if marker is None else lost
    cases = path_cases(name, part, damages, rng) | FILE_DAMAGES
    assert silent(tmp_path, name, rng, cases) == []


def test_exchanged_bodies_are_named(tmp_path):
    def exchange(contents):
        balls = [contents[0][body] for body in ("ball-2", "ball-1")]
        return as_text(
            contents[0] | dict(zip(("ball-1", "ball-2"), balls, strict=True))
        )

    rng = np.random.default_rng(2)
    assert silent(tmp_path, ROPE, rng, {"exchanged": exchange}) == []


CLEAN = [
    {},
    {"noise_mm": 1.0},
    {"lost": 0.05},
    {"noise_mm": 1.0, "lost": 0.05},
    {"count": 2},
    {"count": 5},
    {"count": 9},
    {"count": 59},
    {"offset_mm": (120.0, -180.0, 60.0)},
]


@pytest.mark.parametrize(
    "name",
    [SLIDER, *(pytest.param(n, marks=pytest.mark.slow) for n in PARTS if n != SLIDER)],
)
def test_clean_trials_are_all_imported(name, tmp_path):
    for number, options in enumerate(CLEAN):
        root = tmp_path / str(number)
        rng = np.random.default_rng(100 + number)
        contents = clean_contents(name, rng, **options)
        outcome = import_files(root, name, [*map(as_text, contents)])
        left_out = [finding for finding in outcome.findings if finding.left_out]
        assert (outcome.used, left_out) == (len(contents), []), options


def test_starts_far_apart_with_lost_frames_are_clean(tmp_path):
    """Each trial starts up to 285 mm elsewhere. With lost frames, its offset must not look like a deviation."""
    rng = np.random.default_rng(2)
    name = "SlopeSlider-3-plastic"
    contents = clean_contents(name, rng, noise_mm=1.0, lost=0.05)
    for content in contents:
        offset_mm = rng.normal(size=3)
        offset_mm *= 285.0 * rng.uniform(0.3, 1.0) / np.linalg.norm(offset_mm)
        for asset in content.values():
            if not isinstance(asset, dict) or "x" not in asset:
                continue
            for axis, by_mm in zip("xyz", offset_mm, strict=True):
                asset[axis] = [
                    None if place is None else place + by_mm for place in asset[axis]
                ]
    outcome = import_files(tmp_path, name, [*map(as_text, contents)])
    assert [finding for finding in outcome.findings if finding.left_out] == []


def test_few_trials_are_compared_with_the_reference_or_not_at_all(tmp_path):
    """The board of the free slide has a law; the motion of a turntable may differ from that of the reference."""
    for name, part in ((SLIDER, ("cube", None)), (PLATE, ("cube", None))):
        rng = np.random.default_rng(3)
        contents = clean_contents(name, rng, 3)
        texts = [*map(as_text, contents)]
        outcome = import_files(tmp_path / "clean", name, texts)
        half = {"half": UNSEEN_RECORDING_DAMAGES["half as large"]}
        make = path_cases(name, part, half, rng)["half"]
        damaged = import_files(tmp_path / "half", name, [make(contents), *texts[1:]])
        if name == SLIDER:
            assert (outcome.used, outcome.findings) == (3, [])
            (finding,) = damaged.findings
            assert damaged.used == 2 and "from the reference" in finding.problem
        else:
            (finding,) = outcome.findings
            assert not finding.left_out and "not compared" in finding.problem


@pytest.mark.parametrize("order", [(3, 0, 1, 2), (1, 3, 2, 0)])
def test_an_orientation_in_another_order_is_left_out(order, tmp_path):
    """Option `trial` starts from the rotation relative to the mean of the trials, so a wrong one turns all starts."""
    contents = clean_contents(SLIDER, np.random.default_rng(4))
    keys = np.array(["qx", "qy", "qz", "qw"])
    lists = [contents[0]["cube"][key] for key in keys[[*order]]]
    contents[0]["cube"] |= dict(zip(keys, lists, strict=True))
    outcome = import_files(tmp_path, SLIDER, [*map(as_text, contents)])
    (finding,) = outcome.findings
    assert (outcome.used, finding.key) == (20, "cube.q")
    is_lost = np.isnan(load_imported(SLIDER).start_quaternions).all(axis=(1, 2, 3))
    assert np.flatnonzero(is_lost).tolist() == [0]


def test_another_material_is_named_and_kept_on_request(tmp_path, gauge):
    """A friction that is higher by 0.06 shortens the path by a fifth."""
    rng = np.random.default_rng(0)
    contents = clean_contents(SLIDER, rng)
    damaged(
        contents[3],
        load_experiment(SLIDER),
        "cube",
        None,
        lambda path, rng: path[0] + 0.8 * (path - path[0]),
        rng,
    )
    for number, content in enumerate(contents):
        write_trial(tmp_path, SLIDER, number, as_text(content).encode())
    for options, code, count in (((), 1, 19), (("--keep",), 0, 20)):
        result = gauge("data", "import", tmp_path, *options)
        assert result.exit_code == code
        assert f"{count} trials of 1 experiment" in result.stderr
        said = " ".join((result.stdout + result.stderr).split())
        assert "from the median trial" in said


@pytest.mark.parametrize(
    ("own", "other", "fewest", "most"),
    [("plastic", "metal", 8, 19), ("metal", "wood", 0, 0)],
)
def test_real_trials_of_another_material_are_named_if_their_scatter_allows_it(
    own, other, fewest, most
):
    """The friction of metal scatters by more than its difference from that of wood."""
    bands = {name: load_band(f"SlopeSlider-2-{name}") for name in (own, other)}
    trials = {f"own {k}": trial for k, trial in enumerate(bands[own].trials)}
    others = {other: bands[other].mean}
    names = bands[own].coordinates
    assert trial_faults(names, trials, others=others) == {}
    found = []
    for trial in bands[other].trials:
        wrong = np.full_like(bands[own].mean, np.nan)
        wrong[: len(trial)] = trial[: len(wrong)]
        found.append(trial_faults(names, trials | {"wrong": wrong}, others=others))
    assert all(set(faults) <= {"wrong"} for faults in found)
    named = [fault for faults in found for fault in faults.values()]
    assert fewest <= len(named) <= most
    assert all(f"median trial to {other}" in fault.problem for fault in named)


@pytest.mark.parametrize("name", ["FoamBending-soft"])
def test_markers_of_another_size_are_named(name, tmp_path):
    """A foam of half the size, and a motion of half the size, are smaller than the distance of two trials."""

    def smaller(contents):
        entry = contents[0]["foam"]
        for axis in "xyz":
            centre = np.mean([marker[axis][0] for marker in entry.values()])
            for marker in entry.values():
                column = centre + 0.5 * (np.array(marker[axis]) - centre)
                marker[axis] = column.tolist()
        return as_text(contents[0])

    rng = np.random.default_rng(8)
    kinds = ("half as large", "motion mirrored")
    damages = {k: (UNSEEN_RECORDING_DAMAGES | RECORDING_DAMAGES)[k] for k in kinds}
    cases = path_cases(name, ("foam", None), damages, rng) | {"smaller": smaller}
    assert silent(tmp_path, name, rng, cases) == []


def verdicts():
    """Return the verdicts of exact slides against the import; glued is a friction without motion."""
    experiment = load_experiment(SLIDER, reference="imported")
    start_mm = 1e3 * np.asarray(experiment.scene.body("cube").pose.position_m)
    times_s = np.arange(experiment.frame_count) / 30.0
    found = {}
    for friction in (0.20, 0.257, 0.40, math.inf):
        acceleration = 9806.65 * max(0.0, 0.5 - friction * math.sqrt(0.75))
        path_mm = 0.5 * acceleration * times_s[:, None] ** 2
        values = start_mm + path_mm * [math.sqrt(0.75), 0.0, -0.5]
        score = score_trajectory(
            experiment, band_of(SLIDER), times_s=times_s, values=values
        )
        assert np.isfinite(score.real_limit)
        found[friction] = (score.solves, score.like_reality)
    return found


def test_verdicts_are_those_of_the_clean_trials(tmp_path):
    """A lost coordinate made the limit infinite, so that each motion was inside."""
    rng = np.random.default_rng(1)
    contents = clean_contents(SLIDER, rng)
    texts = [*map(as_text, contents)]
    import_files(tmp_path, SLIDER, texts)
    expected = verdicts()
    assert expected[math.inf][1] == "no"
    damages = drawn(ALL_DAMAGES, rng, 3) | {
        "x": LOST_DAMAGES["x never captured"],
        "half": LOST_DAMAGES["half of the frames"],
    }
    for damage, make in path_cases(SLIDER, ("cube", None), damages, rng).items():
        text = make(copy.deepcopy(contents))
        outcome = import_files(tmp_path, SLIDER, [text, *texts[1:]])
        assert (outcome.used, outcome.left_out) == (19, 1)
        assert verdicts() == expected, damage


def test_bundled_real_trials_pass_the_gate():
    for name in (SLIDER, "SlopeSlider-2-plastic", "BouncingBall-rubber"):
        band = load_band(name)
        assert band_fault(band) is None
        trials = band.trials.copy()
        trials[4, 6] = -9999.0
        damaged_band = copy.copy(band)
        object.__setattr__(damaged_band, "trials", trials)
        assert "trial 4, row 6" in str(band_fault(damaged_band))
