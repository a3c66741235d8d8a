"""Two versions on one model: what is planted is found first, what is equal is the same, and the right side is named."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
import yaml
from places import ROOT
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.errors import MissingExtraError, ParameterError
from gauge_envs.runs.episodes import run_episode
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import write_result
from gauge_envs.tools.versions import bisection, environments, sides, worker
from gauge_envs.tools.versions.comparison import compare
from gauge_envs.tools.versions.environments import ReleaseError
from gauge_envs.tools.versions.fields import field_changes
from gauge_envs.tools.versions.gap import pair_text
from gauge_envs.tools.versions.model import Quantity, Side, Verdict
from gauge_envs.tools.versions.motions import compare_motions
from gauge_envs.tools.versions.overlap import Solid, depth_m
from gauge_envs.tools.versions.processes import Bench, VersionsError
from gauge_envs.tools.versions.returns import compare_returns
from gauge_envs.tools.versions.sides import are_motions, read_side
from gauge_envs.tools.versions.subject import read_states, read_subject
from gauge_envs.tools.versions.words import CANNOT_TELL, comparison_document
from studies.what_changed import checks, engine_releases, what_changed

SCENE = """<mujoco><option timestep="0.004"/><worldbody><geom name="floor" type="plane" size="3 3 1"/>
<body name="box" pos="0 0 0.0999"><freejoint/><geom name="box" type="box" size="0.1 0.1 0.1"/></body>
<body name="arm" pos="0.6 0 0.8"><joint name="elbow" axis="0 1 0"/>
<geom name="arm" type="capsule" fromto="0 0 0 0.3 0 0" size="0.02"/></body></worldbody>
<actuator><motor name="motor" joint="elbow" ctrlrange="-1 1"/></actuator></mujoco>"""


def side(title, **settings):
    return Side(title=title, python=sys.executable, settings=settings)


WORKING = threading.Lock()


class Planted(Bench):
    """A bench that works in this process, and changes what the side `new` computes.

    Args:
        plant: Changes the arrays of a probe in place.
        xml: Model of the side `new`; that of the bench if it is empty.
    """

    def __init__(self, folder, plant=None, xml="", **options):
        model = folder / "scene.xml"
        model.write_text(SCENE, encoding="utf-8")
        super().__init__(model, folder, **({"steps": 20, "seed": 0} | options))
        self.plant, self.xml = plant, xml

    def execute(self, side, job, worker_arguments):
        stated = json.loads(job.read_text(encoding="utf-8"))
        if side.title.startswith("new") and self.xml:
            changed = job.with_suffix(".xml")
            changed.write_text(self.xml, encoding="utf-8")
            job.write_text(
                json.dumps(stated | {"model": str(changed)}), encoding="utf-8"
            )
        # NumPy parses headers with `ast`, which Python 3.11 may break off in two threads at once.
        with WORKING:
            worker.main(job)
        for file in job.parent.glob(f"{job.name.partition('.')[0]}.probe*.npz"):
            # The second file of such a job has the solution at its end.
            is_exact = stated.get("exact") and file.stem.endswith("probe1")
            if side.title.startswith("new") and self.plant and not is_exact:
                with np.load(file) as arrays:
                    found = {name: np.array(arrays[name]) for name in arrays.files}
                self.plant(found)
                np.savez(file, **found)


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
        bench.model.write_text(deep, encoding="utf-8")
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
    bench.model.write_text(shelf, encoding="utf-8")
    model = mujoco.MjModel.from_xml_string(shelf)
    states = tmp_path / "saved.npz"
    np.savez(states, qpos=model.qpos0[None])
    bench = Planted(tmp_path, None, gone, steps=60, saved=states)
    bench.model.write_text(shelf, encoding="utf-8")
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
    model.write_text(SCENE, encoding="utf-8")
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


# --- motions and returns ---------------------------------------------------------------------------------------------


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
        stated = json.loads(file.read_text(encoding="utf-8"))
        for sample in stated["trajectory"]["samples"]:
            sample[0] += shift_mm
        moved = tmp_path / "moved.json"
        moved.write_text(json.dumps(stated), encoding="utf-8")
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
    (tmp_path / "played.py").write_text(POLICY, encoding="utf-8")
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
        (tmp_path / f"{name}.py").write_text("__version__ = '0.0'", encoding="utf-8")
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


# --- versions and environments ---------------------------------------------------------------------------------------


def test_versions_are_read():
    (one,) = read_side("mujoco==3.3.0:iterations=4", {"iterations": 4})
    assert (one.title, one.requirement) == (
        "mujoco==3.3.0:iterations=4",
        "mujoco==3.3.0",
    )
    assert [end.requirement for end in read_side("mujoco==3.1.0..4.0.0")] == [
        "mujoco==3.1.0",
        "mujoco==4.0.0",
    ]
    assert read_side("mujoco")[0].python == sys.executable
    for wrong in (
        "newton==1.0",
        "mujco==3.3.0",
        "mujoco==new",
        "mujoco=3.3.0",
        "mujoco>=3",
    ):
        with pytest.raises(ParameterError, match="expected mujoco=="):
            read_side(wrong)


LACKS = "ERROR: Could not find a version that satisfies the requirement mujoco==9.9.0"
UNFETCHED = "Could not fetch URL i/simple/: connection error: (Caused by E('[Errno"


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (f"{LACKS} (from versions: 3.3.0, 3.9.0)", "no such version .*has 3.9.0"),
        (f"{LACKS} (from versions: none)", "no package mujoco"),
        (
            f"{UNFETCHED} -3] No name')) - skipping\n{LACKS} (from versions: 3.3.0)",
            "i/simple/ does not answer: No name",
        ),
        (f"{UNFETCHED} 5] No'), ProxyError)) - skipping\n", "the proxy"),
        (
            f"Could not fetch URL i: 404 No - skipping\n{LACKS} (from versions: none)",
            "no package mujoco",
        ),
        (
            f"  Skipping link: none: i/mujoco-9.9.0-cp39.whl\n{LACKS} (from versions: 3.3.0)",
            "no wheel",
        ),
        (
            f"{LACKS.replace('mujoco==9.9.0', 'gltf==1.0 (from mujoco)')} (from versions: none)",
            "needs gltf",
        ),
        ("OSError: [Errno 28] No space left on device", "disk is full"),
        ("[Errno 30] Read-only file system", "cannot be written"),
        ("cause: Because there is no version of mujoco==9.9.0 and", "no such version"),
        (
            "cause: Because mujoco==9.9.0 has no usable wheels and",
            "no wheel of mujoco==9.9.0",
        ),
        (
            "cause: Failed to fetch: `i/`\n  cause: error\n  cause: dns",
            "i/ does not answer: dns",
        ),
        ("hint: unavailable because the network was disabled", "does not answer"),
        (
            f"Ignoring indexes: i/simple\n{LACKS} (from versions: 3.3.0)",
            "no-index .*it has 3.3.0. Environments that can be used without it: none",
        ),
        ("error: something else", "something else"),
    ],
)
def test_why_an_installation_failed(tmp_path, monkeypatch, said, told):
    monkeypatch.setenv("GAUGE_CACHE_DIR", str(tmp_path))
    failed = subprocess.CompletedProcess([], 1, "", said)
    monkeypatch.setattr(environments.venv.EnvBuilder, "create", lambda self, at: None)
    monkeypatch.setattr(environments.shutil, "which", lambda name: None)
    monkeypatch.setattr(environments, "_run", lambda command: failed)
    with pytest.raises(ReleaseError, match=told):
        environments.made_environment("mujoco==9.9.0", lambda text: None)
    assert [one.name for one in (tmp_path / "versions").iterdir()] == [".locks"]


def test_nothing_half_made_is_used(tmp_path, monkeypatch):
    """Ctrl-C during an installation leaves nothing; what a killed process left goes at the next one."""
    monkeypatch.setenv("GAUGE_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(environments.shutil, "which", lambda name: None)

    def create(self, at):
        (at / "bin").mkdir(parents=True)
        (at / "bin" / "python").touch()

    def write_on(folder):
        # A child of pip that was interrupted too ends a moment later.
        for index in range(30):
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{index}.py").touch()
            time.sleep(0.01)

    def interrupted(command):
        child = threading.Thread(target=write_on, args=(Path(command[0]).parent,))
        child.start()
        children.append(child)
        raise KeyboardInterrupt

    children = []
    monkeypatch.setattr(environments.venv.EnvBuilder, "create", create)
    monkeypatch.setattr(environments, "_run", interrupted)
    place = environments.environment_folder("mujoco==3.3.0")
    killed = place.with_name(f".{place.name}.killed")
    killed.mkdir(parents=True)
    with pytest.raises(KeyboardInterrupt):
        environments.made_environment("mujoco==3.3.0", lambda text: None)
    children[0].join()
    assert [one.name for one in (tmp_path / "versions").iterdir()] == [".locks"]
    assert not environments.is_made("mujoco==3.3.0")
    done = subprocess.CompletedProcess([], 0, "", "")
    monkeypatch.setattr(environments, "_run", lambda command: done)
    said = []
    environments.made_environment("mujoco==3.3.0", said.append)
    assert environments.is_made("mujoco==3.3.0")
    assert str(environments.environment_folder("mujoco==3.3.0")) in said[0]
    assert "MB" in said[0]
    environments.made_environment("mujoco==3.3.0", said.append)
    assert len(said) == 2
    # A Python that is gone takes its environments with it.
    (environments.environment_folder("mujoco==3.3.0") / "bin" / "python").unlink()
    assert not environments.is_made("mujoco==3.3.0")
    environments.made_environment("mujoco==3.3.0", said.append)
    assert environments.is_made("mujoco==3.3.0")
    environments.remove_environment("mujoco==3.3.0")
    assert not environments.is_made("mujoco==3.3.0")


def started(folder, model):
    """Start the command on a release that is not installed yet."""
    words = ["backend", "versions", str(model), "mujoco==3.3.0", "mujoco", "--steps=3"]
    return subprocess.Popen(
        [sys.executable, "-c", "import gauge_command; gauge_command.main()", *words],
        env=os.environ | {"GAUGE_CACHE_DIR": str(folder)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # A shell in the background ignores interrupts, which its children inherit.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )


@pytest.mark.slow
def test_an_interrupted_installation_leaves_nothing_and_two_at_once_make_one(tmp_path):
    """It needs a package index."""
    model = tmp_path / "scene.xml"
    model.write_text(SCENE, encoding="utf-8")
    interrupted = started(tmp_path, model)
    assert "installed into" in interrupted.stderr.readline()
    deadline_s = time.monotonic() + 60.0
    while not list((tmp_path / "versions").glob(".mujoco-*")):
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    # A terminal interrupts the command with its children.
    os.killpg(interrupted.pid, signal.SIGINT)
    assert interrupted.wait(timeout=60.0) == 130
    assert [one.name for one in (tmp_path / "versions").iterdir()] == [".locks"]
    both = [started(tmp_path, model) for _ in range(2)]
    said = [one.communicate()[1] for one in both]
    assert [one.returncode for one in both] in ([0, 0], [1, 1])
    assert sum("installed into" in text for text in said) == 1
    made = [one.name for one in (tmp_path / "versions").iterdir()]
    assert len(made) == 2
    assert not [name for name in made if name.startswith(".mujoco")]


def test_a_range_without_two_releases_and_one_without_the_index(tmp_path, monkeypatch):
    python = environments.Environment("mujoco==3.3.0", Path(sys.executable))
    monkeypatch.setattr(sides, "made_environment", lambda *words: python)
    monkeypatch.setattr(sides, "released_versions", lambda *words: ["3.3.0", "3.9.0"])
    with pytest.raises(ParameterError, match=r"no two releases .*3\.3\.0, 3\.9\.0"):
        sides.releases_between(*read_side("mujoco==3.3.0..3.3.9"), print)

    def without_index(*words):
        raise ReleaseError("i does not answer")

    monkeypatch.setattr(sides, "released_versions", without_index)
    made = ["mujoco==3.10.0", "mujoco==3.3.0", "mujoco==3.9.0"]
    monkeypatch.setattr(sides, "made_requirements", lambda: made)
    said = []
    found = sides.releases_between(*read_side("mujoco==3.3.0..4.0.0"), said.append)
    assert [one.title for one in found] == [made[1], made[2], made[0]]
    assert "does not answer" in said[0]


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"jacobian": "densest"}, "jacobian=densest: expected one of dense, sparse"),
        ({"iterations": "many"}, "iterations=many: expected a value as 100"),
        ({"gravity": [0, 0]}, "gravity=.* -9.81"),
        ({"timestep": 0.0}, "positive"),
    ],
)
def test_a_setting_that_is_none_says_what_would_be_one(settings, told):
    with pytest.raises(SystemExit, match=told):
        worker.set_options(mujoco.MjModel.from_xml_string("<mujoco/>"), settings)


@pytest.mark.parametrize(
    ("text", "told"), [("", "cannot be started"), ("#!/bin/sh\n", "it is no Python")]
)
def test_a_file_that_is_no_python_is_named(tmp_path, text, told):
    file = tmp_path / "python"
    file.write_text(text, encoding="utf-8")
    file.chmod(0o755 if text else 0o644)
    bench = Bench(tmp_path / "scene.xml", tmp_path, steps=1, seed=0)
    with pytest.raises(VersionsError, match=told):
        bench.run(sides.of_interpreter(file))


def test_a_worker_that_fails_says_why(tmp_path):
    model = tmp_path / "newer.xml"
    model.write_text(SCENE.replace("<body", "<newer/><body"), encoding="utf-8")
    bench = Bench(model, tmp_path, steps=1, seed=0)
    with pytest.raises(
        VersionsError, match=r"old cannot run .*newer.xml: .*XML.*newer"
    ):
        bench.run(side("old"))


def test_a_setting_that_a_release_lacks_is_left_out_and_listed(tmp_path):
    """The meshes are found from the copy without it."""
    (tmp_path / "made").mkdir()
    (tmp_path / "parts").mkdir()
    text = (
        SCENE.replace(
            "<option", '<compiler meshdir="parts"/><option newer="1" cone="round"'
        )
        .replace(
            "<worldbody>", '<asset><mesh name="m" file="m.obj"/></asset><worldbody>'
        )
        .replace(
            '<geom name="box"',
            '<geom type="mesh" mesh="m" newest="a b"/><geom name="box"',
        )
    )
    model = tmp_path / "scene.xml"
    model.write_text(text, encoding="utf-8")
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    faces = "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "parts" / "m.obj").write_text(corners + faces, encoding="utf-8")
    compiled, dropped = worker.without_unknown(model, tmp_path / "made")
    assert dropped == ['option newer="1"', 'geom newest="a b"', 'option cone="round"']
    assert compiled.opt.timestep == 0.004
    assert compiled.nmesh == 1
    assert model.read_text(encoding="utf-8") == text


class OfMuJoCo3:
    """Reads models as MuJoCo 3.12: MuJoCo 4 writes `input` of all actuators."""

    installed = mujoco.MjModel

    @classmethod
    def from_xml_path(cls, path):
        if ' input="pos"' in Path(path).read_text(encoding="utf-8"):
            raise ValueError(
                "Error: input is only available for so3, pid and dcmotor actuators, actuator 'servo' (id = 0)\n"
                "Element name 'servo', id 0, line 2"
            )
        return cls.installed.from_xml_string("<mujoco/>")


def test_an_attribute_that_a_release_has_for_other_actuators_is_left_out(
    tmp_path, monkeypatch
):
    (tmp_path / "made").mkdir()
    model = tmp_path / "scene.xml"
    servo = '<general name="servo" joint="hinge" input="pos" gainprm="80"/>'
    text = f"<mujoco><actuator>\n{servo}\n</actuator></mujoco>"
    model.write_text(text, encoding="utf-8")
    monkeypatch.setattr(worker.mujoco, "MjModel", OfMuJoCo3)
    _, dropped = worker.without_unknown(model, tmp_path / "made")
    assert dropped == ['actuator input="pos"']


# --- subjects --------------------------------------------------------------------------------------------------------


def made_model():
    return mujoco.MjSpec.from_string(SCENE)


def leaves():
    print("not for the output")
    sys.exit(3)


class Made:
    """An environment that holds a compiled model."""

    def __init__(self):
        self.model = mujoco.MjModel.from_xml_string(SCENE)


class Changed(Made):
    def __init__(self):
        super().__init__()
        self.model.body_mass[1] *= 2.0


class Other(Made):
    """MuJoCo writes the model that it compiled last."""

    def __init__(self):
        super().__init__()
        mujoco.MjModel.from_xml_string("<mujoco/>")


@pytest.mark.parametrize(
    ("name", "mass_kg"), [("made_model", 8.0), ("Made", 8.0), ("Changed", 16.0)]
)
def test_a_function_that_makes_a_model_is_a_subject(tmp_path, name, mass_kg):
    read = read_subject(f"{__name__}:{name}", tmp_path)
    again = mujoco.MjModel.from_xml_path(str(read.file))
    assert again.body_mass[1] == pytest.approx(mass_kg)
    assert again.nv == 7


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (f"{__name__}:Other", "incompatible models"),
        (f"{__name__}:Bench", "argument"),
        (f"{__name__}:nothing", "nothing"),
        (f"{__name__}:leaves", "SystemExit: 3"),
        ("absent.xml", "no such file"),
        ("Absent-v0", "no environment of Gymnasium"),
        ("FoamShearing-soft", "are not compared"),
    ],
)
def test_what_is_no_subject(tmp_path, text, told):
    with pytest.raises(ParameterError, match=told):
        read_subject(text, tmp_path)


LAYER = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Z"
)
def PhysicsScene "scene" {}
def Material "wood" (prepend apiSchemas = ["PhysicsMaterialAPI"])
{
    float physics:dynamicFriction = 0.5
    float physics:staticFriction = 0.5
    float physics:restitution = 0
}
def Cube "block" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMassAPI", "MaterialBindingAPI"])
{
    float physics:mass = 3
    rel material:binding:physics = </wood>
}
"""


def test_a_usd_layer_without_a_duration_is_a_subject(tmp_path):
    layer = tmp_path / "block.usda"
    layer.write_text(LAYER, encoding="utf-8")
    found = read_subject(str(layer), tmp_path)
    assert mujoco.MjModel.from_xml_path(str(found.file)).body_mass[-1] == 3.0


def test_a_driven_body_of_an_id_moves_as_its_driver(tmp_path):
    """The plate of a turntable is at the poses of its motion, one every 1/180 s; the XML has none of them."""
    read = read_subject("Turntable-1-wood", tmp_path)
    assert "numeric" not in read.file.read_text(encoding="utf-8")
    bench = Bench(read.file, tmp_path, steps=300, seed=0, motion=read.motion)
    _, file = bench.run(side("here"))
    with np.load(file) as states, np.load(read.motion) as motions:
        moving = states["segment"] == 0
        angle = 2.0 * np.arctan2(states["qpos"][moving, 13], states["qpos"][moving, 10])
        assert states["qvel"][moving][250, 6:] == pytest.approx(
            motions["plate"][5, 7:13]
        )
        driven = 2.0 * np.arctan2(motions["plate"][:, 6], motions["plate"][:, 3])
    assert driven[5] > 1e-6
    assert angle[250] == pytest.approx(driven[5], rel=1e-3)


def test_states_of_demonstrations_are_read(tmp_path):
    """A row of robosuite has time, qpos and qvel; controls are unknown."""
    h5py = pytest.importorskip("h5py")
    file = tmp_path / "demo.hdf5"
    model = mujoco.MjModel.from_xml_string(SCENE)
    rows = np.zeros((3, 1 + model.nq + model.nv))
    rows[:, 0] = 0.0, 0.1, 0.2
    rows[:, 1 : 1 + model.nq] = model.qpos0
    rows[2, -1] = 0.7
    with h5py.File(file, "w") as demonstrations:
        group = demonstrations.create_group("data/demo_3")
        group["states"] = rows
        group.attrs["model_file"] = SCENE
    read = read_subject(str(file), tmp_path)
    found = worker.saved(model, str(read.states))
    assert found["time"].tolist() == [0.0, 0.1, 0.2]
    assert found["qpos"] == pytest.approx(np.tile(model.qpos0, (3, 1)))
    assert found["qvel"][:, -1].tolist() == [0.0, 0.0, 0.7]
    for wrong, told in (("demo_0", "demo_3"), ("demo_9", "demo_3")):
        with pytest.raises(ParameterError, match=told):
            read_states(tmp_path / f"demo.hdf5:{wrong}", tmp_path)


def test_demonstrations_without_h5py_name_its_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'gauge-envs\[logs\]'"):
        read_states(tmp_path / "demo.hdf5", tmp_path)


@pytest.mark.parametrize(
    ("arrays", "told"),
    [
        ({"qvel": np.zeros((2, 6))}, "no qpos.*it has qvel"),
        ({"qpos": np.zeros(7)}, r"shape \(7,\)"),
        ({"qpos": np.zeros((0, 7))}, r"shape \(0, 7\)"),
        ({"qpos": np.zeros((2, 7)), "qvel": np.zeros((3, 6))}, "expected 2 rows"),
        ({"flat": np.full((2, 14), np.nan)}, "not finite"),
    ],
)
def test_an_npz_that_holds_no_states_is_refused(tmp_path, arrays, told):
    np.savez(tmp_path / "states.npz", **arrays)
    with pytest.raises(ParameterError, match=told):
        read_states(tmp_path / "states.npz", tmp_path)


def test_states_of_another_model_are_refused(tmp_path):
    model = mujoco.MjModel.from_xml_string(SCENE)
    file = tmp_path / "states.npz"
    for arrays, told in (
        ({"flat": np.zeros((1, 12))}, "12 numbers"),
        ({"qpos": np.zeros((1, 9))}, "qpos"),
    ):
        np.savez(file, **arrays)
        with pytest.raises(SystemExit, match=told):
            worker.saved(model, str(file))


def test_numbers_have_the_digits_that_tell_them_apart():
    assert pair_text(7.39512, 7.39548, digits=4) == "7.3951 and 7.3955"
    assert pair_text(0.1, 0.1) == "0.1 and 0.1"
    assert pair_text(float("nan"), float("nan")) == "nan and nan"


# --- depths ----------------------------------------------------------------------------------------------------------


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


# --- checks by release -----------------------------------------------------------------------------------------------


def test_the_note_has_the_checks_by_release():
    page = (ROOT / "studies" / "what_changed" / "README.md").read_text(encoding="utf-8")
    assert what_changed.table() in page
    assert json.loads(what_changed.BADGE.read_text()) == what_changed.badge()


def test_a_release_of_an_engine_is_in_table_and_badge(tmp_path, monkeypatch):
    """Planted: a release of Drake in which a box on a slope rests, as in 1.37."""
    page = (ROOT / "studies" / "what_changed" / "README.md").read_text(encoding="utf-8")
    assert engine_releases.table() in page
    before = engine_releases.badges()
    for engine, badge in before.items():
        file = engine_releases.HERE / f"badge_{engine}.json"
        assert json.loads(file.read_text(encoding="utf-8")) == badge
    copied = tmp_path / "engines.csv"
    copied.write_bytes(engine_releases.RESULTS.read_bytes())
    monkeypatch.setattr(engine_releases, "RESULTS", copied)
    row = next(
        one for one in engine_releases.results() if one["release"] == "drake==1.51.1"
    )
    engine_releases.store("drake==1.60.0", row | {"slide": "0"})
    monkeypatch.setattr(
        engine_releases,
        "released_versions",
        lambda engine, *_, **__: ["1.51.1", "1.60.0", "1.61.0"],
    )
    assert "drake==1.61.0" in engine_releases.new_releases(has_candidates=False)
    assert "**1.60.0**: 0" in engine_releases.table()
    after = engine_releases.badges()["drake"]
    assert after["label"] == "Drake 1.60.0"
    count = int(before["drake"]["message"].split()[0])
    assert after["message"] == f"{count - 1} of 5 scenes"


def test_the_workflow_of_releases_runs_commands_of_the_study():
    text = (ROOT / ".github" / "workflows" / "releases.yml").read_text("utf-8")
    steps = yaml.safe_load(text)["jobs"]["measure"]["steps"]
    words = [step["run"].split() for step in steps if "studies" in step.get("run", "")]
    run = [line[2:] for line in words if line[0] == "python"]
    assert [line[0] for line in run] == ["studies.what_changed.what_changed"] * 2
    assert [line[1] for line in run] == ["checks", "engines"]
    assert set(what_changed.COMMANDS) >= {"checks", "engines"}


def test_the_badge_counts_the_checks_of_the_newest_release(monkeypatch):
    rows = what_changed.results()
    newest = list(rows)[-1]
    count = int(what_changed.badge()["message"].split()[0])
    worse = rows | {"99.0.0": rows[newest] | {"pad_depth_mm": 0.5}}
    monkeypatch.setattr(what_changed, "results", lambda: worse)
    found = what_changed.badge()
    assert found["label"] == "MuJoCo 99.0.0"
    assert (found["message"], found["color"]) == (f"{count - 1} of 11 checks", "orange")


def test_a_candidate_is_before_its_release():
    versions = ["4.10.0", "4.1.0", "2.3.1.post1", "4.1.0rc1", "2.3.1"]
    assert sorted(versions, key=environments.version_key) == [
        *("2.3.1", "2.3.1.post1", "4.1.0rc1", "4.1.0", "4.10.0")
    ]
    assert environments.version_key("3.1.6") < environments.NUMPY_2_SINCE
    assert environments.version_key("3.2.0") > environments.NUMPY_2_SINCE


def test_the_checks_give_their_stored_numbers_here():
    """The numbers of the installed release, which `checks.csv` has with six digits."""
    stored = what_changed.results().get(mujoco.__version__)
    if stored is None:
        pytest.skip(f"no checks of MuJoCo {mujoco.__version__} are stored")
    names = set(checks.CHECKS) - {"mesh_tilt_deg", "grip_slip_mm"}
    for name in sorted(names):
        assert checks.CHECKS[name]() == pytest.approx(stored[name], rel=0.02, abs=1e-3)


def test_a_move_is_a_change_of_the_number_and_no_rounding():
    assert what_changed.is_same("pad_depth_mm", 1.0, 1.01)
    assert not what_changed.is_same("pad_depth_mm", 0.5, 1.0)
    assert what_changed.is_same("mesh_tilt_deg", 1e-9, 3e-7)
    assert not what_changed.is_same("pad_depth_mm", "XML Error", 1.0)
