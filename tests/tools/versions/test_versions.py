"""Two versions on one model: what is planted is found first, what is equal is the same, and the right side is named."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from planted_models import SCENE, Planted, side
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.errors import ParameterError
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import write_result
from gauge_envs.tools.versions import bisection, worker
from gauge_envs.tools.versions.comparison import compare
from gauge_envs.tools.versions.fields import field_changes
from gauge_envs.tools.versions.gap import pair_text
from gauge_envs.tools.versions.model import Quantity, Verdict
from gauge_envs.tools.versions.motions import compare_motions
from gauge_envs.tools.versions.overlap import Solid, depth_m
from gauge_envs.tools.versions.returns import compare_returns
from gauge_envs.tools.versions.sides import are_motions, read_side
from gauge_envs.tools.versions.words import CANNOT_TELL, comparison_document


def compared(folder, *planted, **options):
    return compare(Planted(folder, *planted, **options), side("old"), side("new"))


def test_a_version_is_identical_to_itself(tmp_path):
    found = compared(tmp_path)
    assert found.verdict is Verdict.IDENTICAL
    assert (found.differing, found.first, found.fields, found.pairs) == (
        0,
        None,
        (),
        (),
    )
    assert found.states == 2 * 3 * 20
    assert "bit for bit" in comparison_document(found).parts[0].text


def test_rounding_is_no_difference(tmp_path):
    def rounded(found):
        found["qacc"] *= 1.0 + 1e-12

    found = compared(tmp_path, rounded)
    assert (found.verdict, found.differing) == (Verdict.SAME, 0)


def scaled_constraint(found):
    found["qacc"][7:, 6] *= 1.5


def fewer_contacts(found):
    keep = found["contact_state"] < 5
    for name in ("contact_state", "contact_pair", "contact_dist"):
        found[name] = found[name][keep]
    found["qacc"][5:] *= 2.0


def deeper(found):
    found["contact_dist"] -= 1e-3
    found["qacc"] *= 1.1


def other_smooth(found):
    found["smooth"][:, 6] += 1.0
    found["qacc"][:, 6] += 1.0


def other_integration(found):
    found["step_acc"][3:, 2] += 1.0


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
    assert (found.first.segment, found.first.step) == ("start", step)
    assert found.first.quantity is quantity
    if plant is scaled_constraint:
        assert found.first.where == "elbow of arm"
        assert found.first.contacts_before == found.first.contacts_after == 4
    if plant is fewer_contacts:
        assert found.pairs[0].pair == ("floor", "box")


def test_a_side_that_misses_its_own_equations_is_wrong(tmp_path):
    def unbalanced(found):
        found["qacc"][:, 2] += 5.0
        found["imbalance"] += 0.5

    found = compared(tmp_path, unbalanced)
    assert found.right == "old"
    assert {ruling.right for ruling in found.rulings} == {"old"}


def test_a_side_whose_boxes_and_balls_are_as_deep_as_their_geometry_is_right(tmp_path):
    """A box and a ball in a box: planted, half of their depth. A pair that one side leaves out is not judged."""
    xml = SCENE.replace(
        "<body",
        '<geom name="block" type="box" size="1 1 0.05" pos="0 0 -0.04"/><body',
        1,
    ).replace(
        'name="arm" type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"',
        'name="arm" size="0.3"',
    )
    deep = xml.replace('pos="0.6 0 0.8"', 'pos="0.6 0 0.2"').replace("0.0999", "0.1")

    def halved(found):
        found["contact_dist"] /= 2.0
        found["qacc"] *= 1.1

    def left_out(found):
        for name in ("contact_state", "contact_pair", "contact_dist"):
            found[name] = found[name][:0]
        found["qacc"] *= 1.1

    for plant, right in ((halved, "old"), (left_out, "")):
        bench = Planted(tmp_path, plant, steps=5)
        bench.model.write_text(deep)
        found = compare(bench, side("old"), side("new"))
        depths = [one for one in found.rulings if "as deep" in one.law]
        assert [one.right for one in depths] == [right] * bool(right)
        if depths:
            assert depths[0].before < 1e-6
            assert depths[0].after == pytest.approx(0.5, rel=1e-6)


def test_another_default_is_a_field_and_no_law_tells(tmp_path):
    xml = SCENE.replace('name="box" type', 'name="box" solref="0.005 1" type')
    found = compared(tmp_path, None, xml)
    assert found.verdict is Verdict.DIFFERENT
    (field,) = [one for one in found.fields if one.field == "geom_solref"]
    assert (field.where, field.before, field.after) == (
        "box",
        [0.02, 1.0],
        [0.005, 1.0],
    )
    assert found.right == ""
    texts = [getattr(part, "text", "") for part in comparison_document(found).parts]
    assert CANNOT_TELL in texts


def test_a_field_that_one_side_lacks_is_listed_and_flags_go_by_name():
    names = {"geom": ["floor"]}
    one = {"fields": {"opt.disableflags": ["mjDSBL_LIMIT"], "old": [1.0]}}
    two = {"fields": {"opt.disableflags": [], "new": [1.0]}}
    extra = {"names": names}
    changes, new = field_changes(one | extra, two | extra)
    assert [change.field for change in changes] == ["opt.disableflags"]
    assert new == ("new", "old")


def test_a_saved_state_settles_and_the_body_that_falls_is_named(tmp_path):
    """A shelf that one side lacks: the box falls there by g t^2 / 2, 0.28 m in 60 steps of 4 ms."""
    shelf = SCENE.replace('pos="0 0 0.0999"', 'pos="0 0 0.6199"').replace(
        '<body name="box"',
        '<geom name="shelf" type="box" size="0.3 0.3 0.01" pos="0 0 0.51"/><body name="box"',
    )
    gone = shelf.replace('name="shelf"', 'name="shelf" contype="0" conaffinity="0"')
    bench = Planted(tmp_path, None, gone, steps=60)
    bench.model.write_text(shelf)
    model = mujoco.MjModel.from_xml_string(shelf)
    states = tmp_path / "saved.npz"
    np.savez(states, qpos=model.qpos0[None])
    bench = Planted(tmp_path, None, gone, steps=60, saved=states)
    bench.model.write_text(shelf)
    found = compare(bench, side("old"), side("new"))
    (one,) = found.settled
    assert (one.segment, one.body, one.end_before, one.end_after) == (
        "settle from state 0",
        "box",
        "stands",
        "falls",
    )
    assert one.moved_after_m == pytest.approx(9.81 * 0.24**2 / 2, rel=0.02)
    assert found.first.quantity is Quantity.CONTACTS


def test_a_bisection_names_the_neighbours(tmp_path):
    class Releases(Planted):
        def execute(self, side, job, worker_arguments):
            self.plant = scaled_constraint if int(side.title[3:]) >= 5 else None
            super().execute(side, job, worker_arguments)

    bench = Releases(tmp_path)
    releases = [side(f"new{number}") for number in range(8)]
    neighbours, tried = bisection.bisect(bench, releases, lambda text: None)
    assert [one.title for one in neighbours] == ["new4", "new5"]
    assert [one.like for one in tried] == sorted(one.like for one in tried)
    neighbours, _ = bisection.bisect(bench, releases[:3], lambda text: None)
    assert neighbours is None


def test_the_command_runs_a_process_for_each_side(tmp_path):
    model = tmp_path / "scene.xml"
    model.write_text(SCENE)
    words = ["backend", "versions", str(model), "mujoco", "mujoco:gravity=[0,0,-5]"]
    done = CliRunner().invoke(app, [*words, "--steps", "3", "--json"])
    assert done.exit_code == 1, done.output
    line = json.loads(done.stdout)
    assert line["first"]["quantity"] == Quantity.SMOOTH.value
    assert [one["field"] for one in line["fields"]] == ["opt.gravity"]


def test_the_spin_of_a_free_body_is_that_of_its_inertia_and_of_no_tree_with_joints():
    """A brick of 4 kg with half sizes of 0.1 m turns with 2 rad/s: 2 m (2 a)^2 / 6 = 0.05333 kg m^2/s."""
    body = '<body pos="{} 0 1"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="4"/>{}</body>'
    arm = '<body><joint/><geom size="0.1" pos="0.3 0 0" contype="0"/></body>'
    bodies = body.format(0, "") + body.format(1, arm)
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{bodies}</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qvel[3] = data.qvel[9] = 2.0
    mujoco.mj_forward(model, data)
    assert worker.spins(model, data) == pytest.approx(np.array([[0.16 / 3, 0.0, 0.0]]))
    data.qfrc_actuator[0] = 1.0
    assert worker.spins(model, data) is None


def test_numbers_have_the_digits_that_tell_them_apart():
    assert pair_text(7.39512, 7.39548, digits=4) == "7.3951 and 7.3955"
    assert pair_text(0.1, 0.1) == "0.1 and 0.1"
    assert pair_text(float("nan"), float("nan")) == "nan and nan"


def turned(axis, angle):
    return Rotation.from_rotvec(angle * np.array(axis, dtype=float)).as_matrix()


def box(position, rotation=None, size=(0.1, 0.2, 0.3)):
    rotation = np.eye(3) if rotation is None else rotation
    return Solid(np.array(size), 0.0, np.array(position, dtype=float), rotation)


def ball(position, radius=0.1):
    return Solid(np.zeros(3), radius, np.array(position, dtype=float), np.eye(3))


@pytest.mark.parametrize(
    ("one", "two", "expected"),
    [
        (box((0, 0, 0)), box((0.19, 0, 0)), 0.01),
        (box((0, 0, 0)), box((0.25, 0, 0)), -0.05),
        # A corner of a box turned by 45 degrees reaches 0.1 sqrt(2).
        (
            box((0, 0, 0)),
            box((0.24, 0, 0), turned((0, 0, 1), np.pi / 4), (0.1, 0.1, 0.1)),
            0.1 * 2**0.5 - 0.14,
        ),
        # Two square bars cross edge on edge.
        (
            box((0, 0, 0), turned((1, 0, 0), np.pi / 4), (0.5, 0.1, 0.1)),
            box((0, 0, 0.28), turned((0, 1, 0), np.pi / 4), (0.1, 0.5, 0.1)),
            0.2 * 2**0.5 - 0.28,
        ),
        (ball((0, 0, 0)), ball((0, 0.15, 0)), 0.05),
        (box((0, 0, 0)), ball((0.15, 0, 0)), 0.05),
        # The centre is 0.02 m below the nearest face.
        (ball((0.08, 0, 0)), box((0, 0, 0)), 0.12),
        (box((0, 0, 0)), ball((0.13, 0.24, 0)), 0.05),
    ],
)
def test_a_depth_is_the_shortest_way_out(one, two, expected):
    assert depth_m(one, two) == pytest.approx(expected, abs=1e-12)
    turn, shift = turned((0.3, -0.5, 0.2), 1.0), np.array([1.0, -2.0, 0.5])
    moved = [
        replace(
            solid,
            position_m=turn @ solid.position_m + shift,
            rotation=turn @ solid.rotation,
        )
        for solid in (one, two)
    ]
    assert depth_m(*moved) == pytest.approx(expected, abs=1e-12)


def test_engines_and_settings_of_an_experiment_are_compared_as_motions(tmp_path):
    sides = [read_side(text)[0] for text in ("mujoco", "pybullet")]
    assert are_motions("SlopeSlider-2-wood", sides)
    found, scores = compare_motions("SlopeSlider-2-wood", *sides, seed=0)
    assert found.verdict is Verdict.DIFFERENT
    assert found.difference > 10.0 * found.noise
    assert found.first_s < 0.1
    # No score tells both apart: their paths are within 0.3 mm.
    assert (found.right, len(scores.configurations)) == ("", 2)


def test_a_result_file_is_the_motion_of_its_own_run(tmp_path):
    result = run_episode(RunRequest("BouncingBall-rubber"))
    file = tmp_path / "there.json"
    write_result(result, file)
    sides = [read_side(text)[0] for text in (str(file), "mujoco")]
    found, _ = compare_motions("BouncingBall-rubber", *sides, seed=0)
    assert (found.verdict, found.largest) == (Verdict.IDENTICAL, 0.0)
    # What chaos makes of nothing is within the noise, and a millimetre at the start is not.
    for shift_mm, verdict in ((1e-9, Verdict.SAME), (1.0, Verdict.DIFFERENT)):
        stated = json.loads(file.read_text())
        for sample in stated["trajectory"]["samples"]:
            sample[0] += shift_mm
        moved = tmp_path / "moved.json"
        moved.write_text(json.dumps(stated))
        sides[1] = read_side(str(moved))[0]
        found, _ = compare_motions("BouncingBall-rubber", *sides, seed=0)
        assert found.verdict is verdict
    with pytest.raises(ParameterError, match="is a result of GAUGE/BouncingBall"):
        compare_motions("SlopeSlider-2-wood", *sides, seed=0)


@pytest.mark.parametrize(
    ("subject", "texts", "told"),
    [
        ("SlopeSlider-2-wood", ("mujoco==3.3.0", "newton"), "releases are compared"),
        ("scene.xml", ("mujoco", "newton"), "on an id of this suite"),
        ("scene.xml", ("mujoco", "mujoco:preset=training"), "on an id of this suite"),
    ],
)
def test_sides_that_cannot_be_compared(subject, texts, told):
    sides = []
    for text in texts:
        settings = dict([text.partition(":")[2].split("=")]) if ":" in text else {}
        sides.append(read_side(text, settings)[0])
    with pytest.raises(ParameterError, match=told):
        are_motions(subject, sides)


POLICY = """
import gymnasium


class Counter(gymnasium.Env):
    observation_space = action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,))

    def __init__(self):
        import mujoco
        self.model = mujoco.MjModel.from_xml_string("<mujoco/>")

    def reset(self, seed=None, options=None):
        self.offset, self.steps = float(seed), 0
        return self.observation_space.low, {}

    def step(self, action):
        self.steps += 1
        reward = float(action[0]) + self.offset - self.model.opt.timestep
        return action, reward, self.steps == 3, False, {"is_success": action[0] > 1.0}


def policy():
    return lambda observation: observation + 2.0
"""


@pytest.mark.parametrize(
    "is_scripted", [False, pytest.param(True, marks=pytest.mark.slow)]
)
def test_returns_of_a_policy_are_compared_seed_by_seed(
    tmp_path, monkeypatch, is_scripted
):
    """Three steps of reward action + seed - time step: the sides differ by 0.003 in each episode."""
    (tmp_path / "played.py").write_text(POLICY)
    np.save(tmp_path / "actions.npy", np.array([[0.5], [0.25]]))
    monkeypatch.chdir(tmp_path)
    policy = "actions.npy" if is_scripted else "played:policy"
    sides = [side("old"), side("new", timestep=0.003)]
    found = compare_returns(
        "played:Counter", *sides, policy=policy, seeds=3, seed=5, say=print
    )
    # The policy adds 2 to an observation of -1, then of its own actions.
    first = 1.0 if is_scripted else 1.0 + 3.0 + 5.0
    assert found.returns[0].value == pytest.approx(3 * 6.0 + first - 0.006, abs=1e-6)
    assert found.change.value == pytest.approx(-0.003)
    assert found.verdict is Verdict.DIFFERENT
    assert [one.value for one in found.success] == [float(not is_scripted)] * 2
    assert found.returns[0].low < found.returns[0].value - 3.0
    again = compare_returns(
        "played:Counter", *sides[:1] * 2, policy=policy, seeds=2, seed=5, say=print
    )
    assert again.verdict is Verdict.IDENTICAL


@pytest.mark.parametrize("policy", ["word", "absent.npy"])
def test_what_is_no_policy(policy):
    wanted = {"policy": policy, "seeds": 1, "seed": 0, "say": print}
    with pytest.raises(ParameterError, match=rf"--policy {policy}"):
        compare_returns("Hopper-v5", side("old"), side("new"), **wanted)


def test_a_release_is_imported_in_place_of_the_installed_one(tmp_path):
    """The folder of a release has precedence for MuJoCo alone."""
    for name in ("mujoco", "typer"):
        (tmp_path / f"{name}.py").write_text("__version__ = '0.0'")
    code = (
        f"import sys; sys.path.insert(0, {str(Path(worker.__file__).parent)!r})\n"
        "from episodes_worker import use_release\n"
        f"use_release({{'release': {str(tmp_path)!r}, 'has_numpy': False}})\n"
        "import mujoco, typer; print(mujoco.__version__, typer.__version__)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    release, typer_version = done.stdout.split()
    assert release == "0.0"
    assert typer_version != "0.0"
