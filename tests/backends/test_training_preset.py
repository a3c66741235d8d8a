"""The preset `training` of the engines that build deformable bodies: it exists, follows the scene, and stays near."""

import re
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from studies.steps import starts
from studies.steps.steps import (
    CHOSEN_ON,
    DEFAULT_TOLERANCE,
    SHARES,
    longest_step,
    read_rows,
)

SCENES = (
    "TextileFlinging-satin",
    "TextileStretching-oxford",
    "TableclothPulling-wood",
    "RotatingBall-satin",
    "FoamTwisting-soft",
    "CantileverBeam-soft",
    "RopeWinding-rubber",
    "StickStack-soft",
    "SlopeSlider-3-wood",
    "BouncingBall-rubber",
    "NewtonsCradle-metal",
    "Pendulum-metal",
    "WallBreaking-wood",
)


@pytest.mark.parametrize("engine", ["mujoco", "newton"])
@pytest.mark.parametrize("name", SCENES)
def test_every_scene_has_a_training_preset_that_is_not_finer(engine, name):
    scene = load_experiment(name).scene
    chosen = backend(engine)
    default, training = (
        chosen.resolved_settings(scene, changes)
        for changes in ({}, {"preset": "training"})
    )
    assert training["preset"] == "training"
    assert training["timestep_s"] >= default["timestep_s"]
    if default.get("cell_m") is not None:
        assert training["cell_m"] >= default["cell_m"]
    # What a user states stays.
    stated = chosen.resolved_settings(
        scene, {"preset": "training", "timestep_s": 1 / 1800}
    )
    assert stated["timestep_s"] == 1 / 1800
    assert {
        key: value for key, value in stated.items() if key != "timestep_s"
    }.items() <= training.items()


@pytest.mark.parametrize(
    ("preset", "families"),
    [
        ("training", ("TextileStretching",)),
        ("training", ("FoamTwisting",)),
        ("training", ("FoamBending",)),
        ("default", [f"{family}-soft" for family in DEFAULT_TOLERANCE]),
    ],
)
def test_a_preset_has_the_longest_step_that_the_rule_allows(preset, families):
    """In every material that was measured; of hard foam the table has an exception."""
    rows = [row for row in read_rows() if row.id.startswith(tuple(families))]
    shortest = 0
    for _, group in groupby(rows, key=lambda row: row.id):
        chosen_on = [row for row in group if row.start == CHOSEN_ON]
        steps_per_s = longest_step(chosen_on, SHARES[preset])
        shortest = max(shortest, steps_per_s)
    scene = load_experiment(rows[0].id).scene
    changes = {} if preset == "default" else {"preset": preset}
    settings = backend("mujoco").resolved_settings(scene, changes)
    assert settings["timestep_s"] == pytest.approx(1 / shortest)


def test_one_preset_alone_has_a_step_that_random_starts_refuse():
    """That of RotatingBall, as docs/engines/mujoco.md says: no step that was tried is allowed."""
    refused = set()
    found = 0
    for row in starts.read_rows():
        for preset, share in SHARES.items():
            changes = {} if preset == "default" else {"preset": preset}
            settings = backend("mujoco").resolved_settings(
                load_experiment(row.id).scene, changes
            )
            step = f"1/{round(1 / settings['timestep_s'])} s"
            family_has_one_list = row.id.startswith(("Rope", "Wall", "Stick"))
            listed_as = "default" if family_has_one_list else preset
            if row.setting == f"{listed_as} {step}":
                found += 1
                if starts.verdict(row, share) == "refused":
                    refused.add((row.id, preset))
    assert found == 9
    assert refused == {("RotatingBall-satin", "training")}


def test_the_note_has_the_verdicts_of_its_table():
    verdicts = {
        (row.id, row.setting): [starts.verdict(row, share) for share in (0.1, 0.5)]
        for row in starts.read_rows()
    }
    text = Path(starts.__file__).with_name("README.md").read_text(encoding="utf-8")
    name, seen = "", 0
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("| ").split("|")]
        if len(cells) < 6 or cells[-1] not in ("allowed", "refused", "undecided"):
            continue
        *first, at_default, at_training = cells
        name = next(
            (one.split(",")[0] for one in first if "-" in one and "," in one), name
        )
        setting = next(one for one in first if "1/" in one)
        preset = "training" if setting.startswith("`training`") else "default"
        step = re.search(r"1/\d+ s", setting)[0]
        cap = re.search(r" \d+ iterations", setting)
        row = verdicts[name, f"{preset} {step}{cap[0] if cap else ''}"]
        assert at_training == row[1], line
        assert at_default in ("", row[0]), line
        seen += 1
    assert seen == 18


def test_the_change_of_a_mean_is_that_of_drawn_starts():
    """Of a shift of half a scatter in ten directions; without the correction noise adds 1 / 8 of the variance."""
    random = np.random.default_rng(0)
    shift = np.full(10, 0.5 / np.sqrt(10.0))
    found = [
        starts.mean_change(shift + random.normal(0.0, np.sqrt(0.1), (8, 10)))
        for _ in range(400)
    ]
    changes, errors = np.transpose(found)
    assert changes.mean() == pytest.approx(0.25, abs=4.0 * changes.std() / 20.0)
    assert (np.abs(changes - 0.25) < 2.0 * errors).mean() > 0.9


@pytest.mark.parametrize(
    ("name", "frames", "limit_mm"),
    [
        # The cloth is accelerated through 1 cm; cells twice as wide move its hem late.
        ("TextileFlinging-satin", 12, 1.0),
        # Half the cells of the default move it by 0.3 mm.
        ("FoamTwisting-soft", 8, 0.05),
        # The slide starts within a step of 0.56 ms, at 3.5 m/s^2 after 0.4 s: 0.8 mm.
        ("SlopeSlider-2-wood", 12, 0.8),
    ],
)
def test_a_trajectory_for_training_is_near(name, frames, limit_mm, rollout):
    paths = []
    for settings in ({}, {"preset": "training"}):
        env, trajectory, _ = rollout(
            name, frames=frames, settings=settings, marker_proxy="material"
        )
        paths.append(
            1e3
            * (
                trajectory.bodies[..., :3]
                if trajectory.bodies.size
                else trajectory.markers_m
            )
        )
        env.close()
    apart_mm = np.linalg.norm(paths[1] - paths[0], axis=-1)
    assert 0.0 < apart_mm.max() < limit_mm
    assert np.ptp(paths[0], axis=0).max() > 3.0 * limit_mm, "something moves"
