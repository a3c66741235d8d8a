"""One damaged trial among clean ones is left out by name, or changes nothing; clean trials are never left out.

A change counts if it moves the mean by more than 1 mm, a prescribed motion by more than 1 mm or 1 mrad, or a baseline
by more than 5 %.
"""

from __future__ import annotations

import copy

import numpy as np
import pytest
from damages import (
    FILE_DAMAGES,
    LOST_DAMAGES,
    RECORDING_DAMAGES,
    as_text,
    clean_contents,
    damaged,
)
from dataset_writer import write_trial
from imports import band_of, imported

from gauge_envs import load_experiment
from gauge_envs.references.band import load_band
from gauge_envs.references.imported import load_imported
from gauge_envs.scoring.user_file.gate import band_fault
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
    ("name", "part"), [(name, part) for name in PARTS for part in PARTS[name]]
)
def test_each_damaged_trial_is_named(name, part, tmp_path):
    rng = np.random.default_rng(22)
    _, marker = part
    damages = ALL_DAMAGES if marker is None else LOST_DAMAGES
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


def test_bundled_real_trials_pass_the_gate():
    for name in (SLIDER, "SlopeSlider-2-plastic", "BouncingBall-rubber"):
        band = load_band(name)
        assert band_fault(band) is None
        trials = band.trials.copy()
        trials[4, 6] = -9999.0
        damaged_band = copy.copy(band)
        object.__setattr__(damaged_band, "trials", trials)
        assert "trial 4, row 6" in str(band_fault(damaged_band))
