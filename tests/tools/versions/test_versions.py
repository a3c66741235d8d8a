"""Compare two versions on one model: planted changes are detected, equal versions agree, the right side is named."""

import json

import mujoco
import numpy as np
import pytest
from planted_models import SCENE, plant_workers, side
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.tools.versions import worker
from gauge_envs.tools.versions.comparison import (
    compare,
    corners_m,
    depth_m,
    find_change,
)
from gauge_envs.tools.versions.report import comparison_document
from gauge_envs.tools.versions.schema import Quantity, VersionsVerdict


@pytest.fixture
def compared(monkeypatch, tmp_path):
    """Return a function that compares the sides `old` and `new` with a planted change."""

    def run(*planted, model=SCENE, **entries):
        job = plant_workers(monkeypatch, tmp_path, *planted, model=model)
        return compare({**job, **entries}, side("old"), side("new"))

    return run


def test_a_version_does_not_differ_from_itself(compared):
    comparison = compared()
    # Each side visits the initial state, random controls and a push.
    assert (comparison.verdict, comparison.states) == (VersionsVerdict.SAME, 2 * 3 * 20)
    assert (comparison.largest, comparison.first) == (0, None)
    assert comparison.fields == ()


def rounded(arrays):
    arrays["qacc"] *= 1.0 + 1e-12


def test_rounding_is_no_difference(compared):
    comparison = compared(rounded)
    assert comparison.verdict is VersionsVerdict.SAME
    assert 0.0 < comparison.largest < 1e-11


def scaled_constraint(arrays):
    arrays["qacc"][7:, 6] *= 1.5


def fewer_contacts(arrays):
    arrays["contacts"] = arrays["contacts"][arrays["contacts"][:, 0] < 5]
    arrays["qacc"][5:] *= 2.0


def deeper(arrays):
    arrays["contacts"][:, 3] -= 1e-3
    arrays["qacc"] *= 1.1


def changed_smooth(arrays):
    arrays["smooth"][:, 6] += 1.0
    arrays["qacc"][:, 6] += 1.0


def changed_integration(arrays):
    arrays["step_acc"][3:, 2] += 1.0


@pytest.mark.parametrize(
    ("plant", "step", "quantity", "where"),
    [
        (scaled_constraint, 7, Quantity.CONSTRAINT, "elbow of arm"),
        (fewer_contacts, 5, Quantity.CONTACTS, "floor and box"),
        (deeper, 0, Quantity.DEPTH, "floor and box"),
        (changed_smooth, 0, Quantity.SMOOTH, "elbow of arm"),
        (changed_integration, 3, Quantity.STEP, "joint 0 of box"),
    ],
)
def test_the_report_names_the_first_step_and_quantity_of_a_planted_change(
    compared, plant, step, quantity, where
):
    comparison = compared(plant)
    assert comparison.verdict is VersionsVerdict.DIFFERENT
    first = comparison.first
    assert (first.segment, first.step) == ("start", step)
    assert (first.quantity, first.where) == (quantity, where)
    change = {
        fewer_contacts: -4.0,
        deeper: 1e-3,
        changed_smooth: 1.0,
        changed_integration: 1.0,
        scaled_constraint: 0.5 * first.before,
    }
    assert first.after - first.before == pytest.approx(change[plant])


def unsolved(arrays):
    arrays["qacc"][:, 2] += 5.0


def test_the_side_that_reaches_the_solution_of_its_equations_is_right(compared):
    comparison = compared(unsolved)
    assert [ruling.right for ruling in comparison.rulings] == ["old"]
    assert comparison.right == "old"


def halved(arrays):
    arrays["contacts"][:, 3] /= 2.0
    arrays["qacc"] *= 1.1


BLOCK = '<geom name="block" type="box" size="1 1 0.05" pos="0 0 -0.04"/><body'
SUNK = SCENE.replace("<body", BLOCK, 1).replace("0.0999", "0.1")


def test_the_side_with_the_geometric_depth_of_boxes_is_right(compared):
    """The side `new` halves the depth of a box in a box."""
    comparison = compared(halved, model=SUNK, steps=5)
    (ruling,) = [
        ruling for ruling in comparison.rulings if "contact depths" in ruling.law
    ]
    assert ruling.right == "old"
    assert ruling.before < 1e-6
    assert ruling.after == pytest.approx(0.5, rel=1e-6)


def test_a_changed_default_is_a_changed_field_that_no_law_decides(compared):
    new = SCENE.replace('name="box" type', 'name="box" solref="0.021 1" type').replace(
        "<option", '<option><flag gravity="disable"/></option><option'
    )
    comparison = compared(None, new, steps=3)
    changes = {change.field: change for change in comparison.fields}
    assert changes["opt.disableflags"].after == [
        float(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    ]
    change = changes["geom_solref"]
    # The box is the second geom.
    assert (change.row, change.count) == (1, 1)
    assert (change.before, change.after) == ([0.02, 1.0], [0.021, 1.0])
    assert (comparison.verdict, comparison.right) == (VersionsVerdict.DIFFERENT, "")
    last = comparison_document(comparison).parts[-1]
    assert "No checked law" in last.text


def test_each_array_of_a_model_is_physical_or_not():
    """A new release of MuJoCo has new fields: add each to one list of model_fields.json."""
    names = worker.array_fields(mujoco.MjModel.from_xml_string(SCENE))
    physical, other = worker.FIELDS["physics"], worker.FIELDS["other"]
    assert not {*physical} & {*other}
    assert {*names} <= {*physical, *other}
    assert {"qpos0", "geom_margin", "site_pos", "hfield_data"} <= {*physical}
    assert {"geom_rgba", "body_dofadr", "names_map"} <= {*other}


def test_a_field_that_is_in_neither_list_is_compared_and_reported(
    compared, monkeypatch
):
    known = {kind: [*names] for kind, names in worker.FIELDS.items()}
    known["physics"].remove("geom_solref")
    monkeypatch.setattr(worker, "FIELDS", known)
    new = SCENE.replace('name="box" type', 'name="box" solref="0.021 1" type')
    comparison = compared(None, new, steps=3)
    assert comparison.unknown_fields == ("geom_solref",)
    assert [change.field for change in comparison.fields] == ["geom_solref"]
    texts = [
        getattr(part, "text", "") for part in comparison_document(comparison).parts
    ]
    assert any("compared as physical ones: geom_solref" in text for text in texts)


def test_a_model_moves_from_saved_states(compared, tmp_path):
    """One side lacks the shelf, so its box falls with g. Two states share the 20 steps."""
    shelf = '<geom name="shelf" type="box" size="0.3 0.3 0.01" pos="0 0 0.51"/><body name="box"'
    model = SCENE.replace('<body name="box"', shelf).replace("0.0999", "0.6199")
    gone = model.replace('name="shelf"', 'name="shelf" contype="0" conaffinity="0"')
    saved = tmp_path / "saved.npz"
    state = mujoco.MjModel.from_xml_string(model).qpos0
    np.savez(saved, qpos=np.array([state, state]))
    comparison = compared(None, gone, model=model, saved=str(saved))
    assert comparison.states == 2 * 20
    first = comparison.first
    assert (first.segment, first.step) == ("saved state 0", 0)
    assert (first.quantity, first.before, first.after) == (Quantity.CONTACTS, 4, 0)


@pytest.mark.parametrize("count", [8, 2])
def test_a_bisection_compares_the_neighbors_of_a_change(monkeypatch, tmp_path, count):
    """The releases differ from the fifth or, of two, from the second on."""
    changed = min(5, count - 1)
    releases = [side(f"new{number}") for number in range(count)]
    job = plant_workers(
        monkeypatch,
        tmp_path,
        scaled_constraint,
        where=lambda side: int(side.title[3:]) >= changed,
    )
    comparison = find_change(job, releases)
    names = (comparison.before, comparison.after)
    assert names == (f"new{changed - 1}", f"new{changed}")
    likes = {release.release: release.like for release in comparison.tried}
    if count == 8:
        assert likes == {"new4": "first", "new5": "last", "new6": "last"}


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
