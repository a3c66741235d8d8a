"""Two versions on one model: a planted change is found first, equal versions are the same, the right side is named."""

import json

import mujoco
import numpy as np
import pytest
from planted_models import SCENE, Planted, side
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.tools.versions import worker
from gauge_envs.tools.versions.comparison import compare, find_change
from gauge_envs.tools.versions.laws import Solid, depth_m
from gauge_envs.tools.versions.report import comparison_document
from gauge_envs.tools.versions.schema import Quantity, Verdict


def compared(folder, *planted, **options):
    return compare(Planted(folder, *planted, **options), side("old"), side("new"))


def test_a_version_is_identical_to_itself(tmp_path):
    found = compared(tmp_path)
    assert found.verdict is Verdict.IDENTICAL
    # The start, random controls and a push, as each side visits them.
    assert (found.states, found.differing, found.first) == (2 * 3 * 20, 0, None)
    assert (found.fields, found.pairs, found.settled) == ((), (), ())
    assert "bit for bit" in comparison_document(found).parts[0].text


def rounded(arrays):
    arrays["qacc"] *= 1.0 + 1e-12


def test_rounding_is_no_difference(tmp_path):
    found = compared(tmp_path, rounded)
    assert (found.verdict, found.differing) == (Verdict.SAME, 0)


def scaled_constraint(arrays):
    arrays["qacc"][7:, 6] *= 1.5


def fewer_contacts(arrays):
    is_left = arrays["contact_state"] < 5
    for name in ("contact_state", "contact_pair", "contact_dist"):
        arrays[name] = arrays[name][is_left]
    arrays["qacc"][5:] *= 2.0


def deeper(arrays):
    arrays["contact_dist"] -= 1e-3
    arrays["qacc"] *= 1.1


def other_smooth(arrays):
    arrays["smooth"][:, 6] += 1.0
    arrays["qacc"][:, 6] += 1.0


def other_integration(arrays):
    arrays["step_acc"][3:, 2] += 1.0


@pytest.mark.parametrize(
    ("plant", "step", "quantity"),
    [
        (scaled_constraint, 7, Quantity.CONSTRAINT),
        (fewer_contacts, 5, Quantity.CONTACTS),
        (deeper, 0, Quantity.DEPTH),
        (other_smooth, 0, Quantity.SMOOTH),
        (other_integration, 3, Quantity.STEP),
    ],
)
def test_the_first_step_and_quantity_of_a_planted_change_are_named(
    tmp_path, plant, step, quantity
):
    found = compared(tmp_path, plant)
    assert found.verdict is Verdict.DIFFERENT
    first = found.first
    assert (first.segment, first.step, first.quantity) == ("start", step, quantity)
    if plant is scaled_constraint:
        assert first.where == "elbow of arm"
        assert first.contacts_before == first.contacts_after == 4
    if plant is fewer_contacts:
        assert found.pairs[0].pair == ("floor", "box")


def unsolved(arrays):
    arrays["qacc"][:, 2] += 5.0


def spun(arrays):
    arrays["spin"] = np.full(len(arrays["qacc"]), 1e-3)


FALLING = SCENE.replace("0 0 0.0999", "0 0 5").replace(
    '<motor name="motor" joint="elbow" ctrlrange="-1 1"/>', ""
)


@pytest.mark.parametrize(
    ("plant", "model", "law"),
    [(unsolved, SCENE, "own equations"), (spun, FALLING, "angular momentum")],
)
def test_a_side_that_misses_a_law_is_wrong(tmp_path, plant, model, law):
    found = compared(tmp_path, plant, model=model)
    (ruling,) = [ruling for ruling in found.rulings if law in ruling.law]
    assert ruling.right == "old"
    assert found.right == ("old" if found.differing else "")


def test_the_spin_of_a_free_body_is_its_inertia_times_its_rate():
    """A brick of 4 kg with half sizes of 0.1 m turns with 2 rad/s: 2 m (2 a)^2 / 6 = 0.05333 kg m^2/s."""
    body = '<body pos="{} 0 1"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="4"/>{}</body>'
    arm = '<body><joint/><geom size="0.1" pos="0.3 0 0" contype="0"/></body>'
    bodies = body.format(0, "") + body.format(1, arm)
    text = f"<mujoco><worldbody>{bodies}</worldbody></mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qvel[3] = data.qvel[9] = 2.0
    mujoco.mj_forward(model, data)
    assert worker.spins(model, data) == pytest.approx(np.array([[0.16 / 3, 0.0, 0.0]]))
    data.xfrc_applied[1, 0] = 1.0
    assert not len(worker.spins(model, data))


def halved(arrays):
    arrays["contact_dist"] /= 2.0
    arrays["qacc"] *= 1.1


def left_out(arrays):
    for name in ("contact_state", "contact_pair", "contact_dist"):
        arrays[name] = arrays[name][:0]
    arrays["qacc"] *= 1.1


BLOCK = '<geom name="block" type="box" size="1 1 0.05" pos="0 0 -0.04"/><body'
SUNK = (
    SCENE.replace("<body", BLOCK, 1)
    .replace('type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"', 'size="0.3"')
    .replace('pos="0.6 0 0.8"', 'pos="0.6 0 0.2"')
    .replace("0.0999", "0.1")
)


@pytest.mark.parametrize(("plant", "right"), [(halved, "old"), (left_out, "")])
def test_the_side_whose_boxes_and_balls_are_as_deep_as_their_geometry_is_right(
    tmp_path, plant, right
):
    """A box and a ball in a box, planted at half of their depth; a pair that one side leaves out is not judged."""
    found = compared(tmp_path, plant, model=SUNK, steps=5)
    depths = [ruling for ruling in found.rulings if "as deep" in ruling.law]
    assert [ruling.right for ruling in depths] == [right] * bool(right)
    for ruling in depths:
        assert ruling.before < 1e-6
        assert ruling.after == pytest.approx(0.5, rel=1e-6)


def test_another_default_is_a_changed_field_and_no_law_decides(tmp_path):
    new = SCENE.replace('name="box" type', 'name="box" solref="0.005 1" type')
    found = compared(tmp_path, None, new)
    (change,) = [each for each in found.fields if each.field == "geom_solref"]
    assert (change.where, change.count) == ("box", 1)
    assert (change.before, change.after) == ([0.02, 1.0], [0.005, 1.0])
    assert (found.verdict, found.right) == (Verdict.DIFFERENT, "")
    last = comparison_document(found).parts[-1]
    assert "No law that was checked" in last.text


def test_a_saved_state_settles_and_the_body_that_falls_is_named(tmp_path):
    """A shelf that one side lacks: the box falls there by g t^2 / 2, 0.28 m in 60 steps of 4 ms."""
    shelf = '<geom name="shelf" type="box" size="0.3 0.3 0.01" pos="0 0 0.51"/><body name="box"'
    model = SCENE.replace('<body name="box"', shelf).replace("0.0999", "0.6199")
    gone = model.replace('name="shelf"', 'name="shelf" contype="0" conaffinity="0"')
    saved = tmp_path / "saved.npz"
    np.savez(saved, qpos=mujoco.MjModel.from_xml_string(model).qpos0[None])
    found = compared(tmp_path, None, gone, model=model, steps=60, saved=saved)
    (end,) = found.settled
    assert (end.segment, end.body) == ("settle from state 0", "box")
    assert (end.end_before, end.end_after) == ("stands", "falls")
    assert end.moved_after_m == pytest.approx(9.81 * 0.24**2 / 2, rel=0.02)
    assert found.first.quantity is Quantity.CONTACTS


class Releases(Planted):
    """Releases of which the fifth and later ones differ."""

    def plant_of(self, side):
        return scaled_constraint if side.title >= "new5" else None


def test_a_bisection_names_the_neighbors(tmp_path):
    releases = [side(f"new{number}") for number in range(8)]
    bench = Releases(tmp_path)
    neighbors, tried = find_change(bench, releases, lambda text: None)
    assert [each.title for each in neighbors] == ["new4", "new5"]
    assert [each.like for each in tried] == sorted(each.like for each in tried)
    ends, tried = find_change(bench, releases[:3], lambda text: None)
    assert ([each.title for each in ends], len(tried)) == (["new0", "new2"], 2)


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
    assert len(text.splitlines()) <= 30


# --- depth by geometry -----------------------------------------------------------------------------------------------


def rotated(axis, angle_rad):
    return Rotation.from_rotvec(angle_rad * np.array(axis, dtype=float)).as_matrix()


def box(position, rotation=None, size=(0.1, 0.2, 0.3)):
    rotation = np.eye(3) if rotation is None else rotation
    return Solid(np.array(size), 0.0, np.array(position, dtype=float), rotation)


def ball(position):
    return Solid(np.zeros(3), 0.1, np.array(position, dtype=float), np.eye(3))


@pytest.mark.parametrize(
    ("first", "second", "expected_m"),
    [
        (box((0, 0, 0)), box((0.19, 0, 0)), 0.01),
        (box((0, 0, 0)), box((0.25, 0, 0)), -0.05),
        # A corner of a box turned by 45 degrees reaches 0.1 sqrt(2).
        (
            box((0, 0, 0)),
            box((0.24, 0, 0), rotated((0, 0, 1), np.pi / 4), (0.1, 0.1, 0.1)),
            0.1 * 2**0.5 - 0.14,
        ),
        # Two square bars cross edge on edge.
        (
            box((0, 0, 0), rotated((1, 0, 0), np.pi / 4), (0.5, 0.1, 0.1)),
            box((0, 0, 0.28), rotated((0, 1, 0), np.pi / 4), (0.1, 0.5, 0.1)),
            0.2 * 2**0.5 - 0.28,
        ),
        (ball((0, 0, 0)), ball((0, 0.15, 0)), 0.05),
        (box((0, 0, 0)), ball((0.15, 0, 0)), 0.05),
        # The center is 0.02 m below the nearest face.
        (ball((0.08, 0, 0)), box((0, 0, 0)), 0.12),
        (box((0, 0, 0)), ball((0.13, 0.24, 0)), 0.05),
    ],
)
def test_a_depth_is_the_shortest_way_out_in_any_frame(first, second, expected_m):
    rotation, shift_m = rotated((0.3, -0.5, 0.2), 1.0), np.array([1.0, -2.0, 0.5])
    moved = [
        solid._replace(
            position_m=rotation @ solid.position_m + shift_m,
            rotation=rotation @ solid.rotation,
        )
        for solid in (first, second)
    ]
    assert depth_m(first, second) == pytest.approx(expected_m, abs=1e-12)
    assert depth_m(*moved) == pytest.approx(expected_m, abs=1e-12)
