"""Compare two versions on one model: planted changes are detected, equal versions agree, the right side is named."""

import json

import mujoco
import numpy as np
import pytest
from planted_models import SCENE, Planted, side
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.tools.versions.comparison import (
    compare,
    corners_m,
    depth_m,
    find_change,
)
from gauge_envs.tools.versions.report import comparison_document
from gauge_envs.tools.versions.schema import Quantity, Verdict


def compared(folder, *planted, **options):
    return compare(Planted(folder, *planted, **options), side("old"), side("new"))


def test_a_version_is_identical_to_itself(tmp_path):
    comparison = compared(tmp_path)
    assert comparison.verdict is Verdict.IDENTICAL
    # Each side visits the initial state, random controls and a push.
    assert (comparison.states, comparison.differing, comparison.first) == (
        2 * 3 * 20,
        0,
        None,
    )
    assert comparison.fields == ()
    assert "bit for bit" in comparison_document(comparison).parts[0].text


def test_a_step_without_damping_adds_the_acceleration_to_velocities(tmp_path):
    bench = Planted(tmp_path)
    (run,) = bench.work("run", [side("old")])
    (probe,) = bench.work("probe", [side("old")], run.arrays)
    assert np.allclose(probe.arrays["step_acc"], probe.arrays["qacc"], atol=1e-8)


def rounded(arrays):
    arrays["qacc"] *= 1.0 + 1e-12


def test_rounding_is_no_difference(tmp_path):
    comparison = compared(tmp_path, rounded)
    assert (comparison.verdict, comparison.differing) == (Verdict.SAME, 0)


def scaled_constraint(arrays):
    arrays["qacc"][7:, 6] *= 1.5


def fewer_contacts(arrays):
    for pairs in arrays["touching"][5:]:
        pairs.clear()
    arrays["qacc"][5:] *= 2.0


def deeper(arrays):
    for pairs in arrays["touching"]:
        pairs |= {
            pair: [distance_m - 1e-3 for distance_m in pairs[pair]] for pair in pairs
        }
    arrays["qacc"] *= 1.1


def changed_smooth(arrays):
    arrays["smooth"][:, 6] += 1.0
    arrays["qacc"][:, 6] += 1.0


def changed_integration(arrays):
    arrays["step_acc"][3:, 2] += 1.0


@pytest.mark.parametrize(
    ("plant", "step", "quantity"),
    [
        (scaled_constraint, 7, Quantity.CONSTRAINT),
        (fewer_contacts, 5, Quantity.CONTACTS),
        (deeper, 0, Quantity.DEPTH),
        (changed_smooth, 0, Quantity.SMOOTH),
        (changed_integration, 3, Quantity.STEP),
    ],
)
def test_the_report_names_the_first_step_and_quantity_of_a_planted_change(
    tmp_path, plant, step, quantity
):
    comparison = compared(tmp_path, plant)
    assert comparison.verdict is Verdict.DIFFERENT
    first = comparison.first
    assert (first.segment, first.step, first.quantity) == ("start", step, quantity)
    if plant is scaled_constraint:
        assert first.where == "elbow of arm"
        assert first.contacts_before == first.contacts_after == 4
    if plant is fewer_contacts:
        assert first.detail == "floor and box: 4 and 0 contacts"


def unsolved(arrays):
    arrays["qacc"][:, 2] += 5.0


def test_the_side_that_reaches_the_solution_of_its_equations_is_right(tmp_path):
    comparison = compared(tmp_path, unsolved)
    assert [ruling.right for ruling in comparison.rulings] == ["old"]
    assert comparison.right == "old"


def halved(arrays):
    for pairs in arrays["touching"]:
        pairs |= {
            pair: [distance_m / 2.0 for distance_m in pairs[pair]] for pair in pairs
        }
    arrays["qacc"] *= 1.1


BLOCK = '<geom name="block" type="box" size="1 1 0.05" pos="0 0 -0.04"/><body'
SUNK = SCENE.replace("<body", BLOCK, 1).replace("0.0999", "0.1")


def test_the_side_with_the_geometric_depth_of_boxes_is_right(tmp_path):
    """The side `new` halves the depth of a box in a box."""
    comparison = compared(tmp_path, halved, model=SUNK, steps=5)
    (ruling,) = [
        ruling for ruling in comparison.rulings if "contact depths" in ruling.law
    ]
    assert ruling.right == "old"
    assert ruling.before < 1e-6
    assert ruling.after == pytest.approx(0.5, rel=1e-6)


def test_a_changed_default_is_a_changed_field_that_no_law_decides(tmp_path):
    new = SCENE.replace('name="box" type', 'name="box" solref="0.021 1" type').replace(
        "<option", '<option><flag gravity="disable"/></option><option'
    )
    comparison = compared(tmp_path, None, new, steps=3)
    changes = {change.field: change for change in comparison.fields}
    assert changes["opt.disableflags"].after == [
        float(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    ]
    change = changes["geom_solref"]
    assert (change.where, change.count) == ("box", 1)
    assert (change.before, change.after) == ([0.02, 1.0], [0.021, 1.0])
    assert (comparison.verdict, comparison.right) == (Verdict.DIFFERENT, "")
    last = comparison_document(comparison).parts[-1]
    assert "No checked law" in last.text


def test_a_saved_state_is_compared_and_moves(tmp_path):
    """One side lacks the shelf, so the box falls with g."""
    shelf = '<geom name="shelf" type="box" size="0.3 0.3 0.01" pos="0 0 0.51"/><body name="box"'
    model = SCENE.replace('<body name="box"', shelf).replace("0.0999", "0.6199")
    gone = model.replace('name="shelf"', 'name="shelf" contype="0" conaffinity="0"')
    saved = tmp_path / "saved.npz"
    np.savez(saved, qpos=mujoco.MjModel.from_xml_string(model).qpos0[None])
    comparison = compared(tmp_path, None, gone, model=model, saved=saved)
    assert comparison.states == 2 * (20 + 1)
    first = comparison.first
    assert (first.segment, first.step) == ("settle from state 0", 0)
    assert (first.quantity, first.contacts_after) == (Quantity.CONTACTS, 0)
    assert comparison.worst.acceleration_after == pytest.approx(-9.81)


class Releases(Planted):
    """Releases that differ from the fifth release on."""

    def plant_of(self, side):
        return scaled_constraint if side.title >= "new5" else None


def test_a_bisection_names_the_neighbors(tmp_path):
    releases = [side(f"new{number}") for number in range(8)]
    bench = Releases(tmp_path)
    neighbors, tried = find_change(bench, releases)
    assert [release.title for release in neighbors] == ["new4", "new5"]
    assert [release.like for release in tried] == sorted(
        release.like for release in tried
    )


def test_the_command_runs_a_process_for_each_side(tmp_path):
    model = tmp_path / "scene.xml"
    model.write_text(SCENE)
    sides = ["mujoco", "mujoco:gravity=[0,0,-5]"]
    command = ["backend", "versions", str(model), *sides, "--steps", "3"]
    done = CliRunner().invoke(app, [*command, "--json"])
    assert done.exit_code == 1, done.output
    line = json.loads(done.stdout)
    assert line["first"]["quantity"] == Quantity.SMOOTH.value
    assert [change["field"] for change in line["fields"]] == ["opt.gravity"]
    text = CliRunner().invoke(app, command).stdout
    assert len(text.splitlines()) <= 25


def test_a_depth_is_the_shortest_displacement_in_any_frame():
    """The corner of a box rotated by 45 degrees is at 0.1 sqrt(2)."""
    rotation = Rotation.from_rotvec([0.0, 0.0, np.pi / 4])
    first = corners_m([0.1, 0.2, 0.3], np.zeros(3), np.eye(3))
    second = corners_m(
        [0.1, 0.1, 0.1], np.array([0.24, 0.0, 0.0]), rotation.as_matrix()
    )
    frame = Rotation.from_rotvec([0.3, -0.5, 0.2])
    for bodies in ((first, second), (frame.apply(second), frame.apply(first))):
        assert depth_m(*bodies) == pytest.approx(0.1 * 2**0.5 - 0.14, abs=1e-12)
