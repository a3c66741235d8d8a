"""The friction of a pair of geoms, what follows from it, and other stacks; plain MuJoCo is the judge."""

import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
from gymnasium.envs import mujoco as environments
from places import ROOT

from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.pair import STACKS, touching_table
from gauge_envs.tools.sanity.pair_bench import bench, touch_of, touching

MODEL = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1" friction="{floor}" priority="{rank}"/>
    <body pos="0 0 0.02"><freejoint/><geom name="foot" size="0.02" friction="{foot}" condim="{condim}"/></body>
  </worldbody>
  {contact}
</mujoco>
"""
PAIR = '<contact><pair geom1="floor" geom2="foot" friction="{value} {value} 0 0 0"/></contact>'

GRIPPER = ROOT / "examples" / "sanity" / "gripper.xml"
"""A capsule between two pads, with the documented settings against slip."""


@pytest.mark.parametrize(
    "seed",
    [*range(4), *(pytest.param(n, marks=pytest.mark.slow) for n in range(4, 20))],
)
def test_the_friction_in_force_is_that_of_mujocos_contact(seed):
    """Priorities, explicit pairs, and the greater value; the judge is the list of contacts of a step."""
    random = np.random.default_rng(seed)
    floor, foot, value = random.uniform(0.1, 2.0, 3).round(2)
    explicit = PAIR.format(value=value) if seed % 4 == 3 else ""
    model = mujoco.MjModel.from_xml_string(
        MODEL.format(
            floor=floor,
            foot=foot,
            rank=seed % 3 - 1,
            condim=random.choice([3, 4, 6]),
            contact=explicit,
        )
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 1
    (row,) = touching_table(configuration(model))[0].rows
    assert row[1].startswith(f"{data.contact.friction[0, 0]:g}, ")
    if explicit:
        assert "stated by their pair" in row[1]
    else:
        assert ("higher priority" in row[1]) == (seed % 3 != 1)


# --- what follows ----------------------------------------------------------------------------------------------------

ASSETS = Path(environments.__file__).parent / "assets"
ROBOTS = {
    "gripper": (GRIPPER, ("left_pad", "capsule")),
    "ant": (ASSETS / "ant.xml", ("floor", "left_ankle_geom")),
    "humanoid": (ASSETS / "humanoid.xml", ("floor", "right_foot")),
    "walker": (ASSETS / "walker2d_v5.xml", ("floor", "foot_geom")),
}


def numbers(values):
    return " ".join(f"{value:.17g}" for value in values)


def judge(measured):
    """Return creep, slide, hop, rebound and a glancing impact of the moving geom on a wide floor, from positions.

    The contact is what `mj_forward` lists, and a wide box or plane stands for the other geom.
    """
    small, touch = measured.model, measured.touch
    data = mujoco.MjData(small)
    data.qpos[2] = measured._start_m - 1e-6
    mujoco.mj_forward(small, data)
    contact, turn = data.contact, touch.moving_pose.as_quat(scalar_first=True)
    cone = "elliptic" if small.opt.cone else "pyramidal"
    solver = ("PGS", "CG", "Newton")[small.opt.solver]
    integrator = {0: "Euler", 1: "RK4", 3: "implicitfast"}[small.opt.integrator]
    kind = {2: "sphere", 3: "capsule", 6: "box"}[small.geom("moving").type[0]]
    model = mujoco.MjModel.from_xml_string(f"""<mujoco>
      <option timestep="{small.opt.timestep}" cone="{cone}" impratio="{small.opt.impratio}" solver="{solver}"
        iterations="{small.opt.iterations}" integrator="{integrator}"/>
      <worldbody><geom name="a" type="plane" size="0 0 1"/><body pos="0 0 1">
        <inertial pos="0 0 0" mass="{touch.mass_kg}" diaginertia="1 1 1"/>
        <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="slide"/>
        <geom name="b" type="{kind}" size="{numbers(small.geom("moving").size)}" quat="{numbers(turn)}"/></body>
      </worldbody>
      <contact><pair geom1="a" geom2="b" condim="{contact.dim[0]}" friction="{numbers(contact.friction[0])}"
        solref="{numbers(contact.solref[0])}" solimp="{numbers(contact.solimp[0])}"
        margin="{contact.includemargin[0]}"/></contact></mujoco>""")
    model.body_invweight0[1] = small.body_invweight0[1]
    mu, mass = contact.friction[0, 0], touch.mass_kg
    press = touch.load_n / mass

    def run(seconds, gravity, height=0.0, velocity=(0.0, 0.0, 0.0)):
        data = mujoco.MjData(model)
        data.qpos[2] = -1.0
        mujoco.mj_forward(model, data)
        data.qpos[2] -= data.contact.dist.min() - height
        data.qvel[:] = velocity
        model.opt.gravity[:] = gravity
        places = [data.qpos.copy()]
        for _ in range(round(seconds / model.opt.timestep)):
            mujoco.mj_step(model, data)
            places.append(data.qpos.copy())
        return np.array(places)

    step, margin = model.opt.timestep, float(model.pair_margin[0])
    rest, own = (
        run(0.5, (0.0, 0.0, -load), margin)[[0, -1], 2] @ [-1.0, 1.0] + margin
        for load in (press, 9.80665)
    )
    crept = run(1.0, (0.9 * mu * press, 0.0, -press), rest)[:, 0]
    late = 3 * len(crept) // 4
    slid = run(0.5, (1.5 * mu * press, 0.0, -press), rest)
    half, times = len(slid) // 2, step * np.arange(len(slid))
    pull, _, lift = 2.0 * np.polyfit(times[half:], slid[half:], 2)[0]
    hopped = run(0.5, (0.0, 0.0, -9.80665), own, (4.0, 0.0, 0.0))[:, 2]
    drops = (
        run(0.5, (0.0, 0.0, 0.0), (1.125 + phase / 4) * step + margin, (0.0, 0.0, -1.0))
        for phase in range(4)
    )
    bounced = np.mean([np.diff(drop[-2:, 2]) for drop in drops]) / step
    return {
        "creep at 0.9 of the limit": 1e6
        * (crept[-1] - crept[late])
        / (step * (len(crept) - 1 - late)),
        "slide at 0 degrees over Coulomb": (1.5 * mu * press - pull)
        / (mu * (press + lift)),
        "hop at 4 m/s": 1e3 * (hopped.max() - hopped[0]),
        "rebound": bounced,
    }


@pytest.mark.parametrize("name", ROBOTS)
def test_what_follows_agrees_with_positions_on_a_wide_floor(name):
    file, geoms = ROBOTS[name]
    robot = configuration(str(file)).robot
    pair = tuple(sorted(robot.model.geom(geom).id for geom in geoms))
    row = np.flatnonzero((robot.pairs.geoms == pair).all(axis=1))[0]
    touch = touch_of(robot, pair, touching(robot).get(pair))
    measured = bench(robot, touch, robot.pairs.constants[row])
    values = {value.name: value.value for value in measured.values()}
    for key, expected in judge(measured).items():
        assert values[key] == pytest.approx(expected, rel=0.03, abs=0.01), key


def fallen_mm_per_s(model):
    """Return the speed with which the capsule leaves its gripper [mm/s], from the second to the fourth second."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 500)
    first = data.body("object").xpos[2]
    mujoco.mj_step(model, data, 1000)
    return -1e3 * (data.body("object").xpos[2] - first) / 2.0


def test_a_held_capsule_creeps_as_the_page_says_until_it_has_the_line(gauge):
    """A line is for one pad, so the model gets it for both."""
    words = ("--pair", "left_pad,capsule", "--only", "gravity", "--as", "isaac")
    printed = " ".join(gauge("sanity", str(GRIPPER), *words).stdout.split())
    # The product of 0.7 and 0.7 with the mode multiply, their mean with the default.
    assert "multiply" in printed and " 0.49 " in printed and "Rapier" not in printed
    before, after = re.search(
        r"creep in the run ([\d.]+) um/s -> ([\d.]+) um/s", printed
    ).groups()
    model = GRIPPER.read_text()
    free = fallen_mm_per_s(mujoco.MjModel.from_xml_string(model))
    assert 1e3 * free == pytest.approx(float(before), rel=0.02)
    line = re.search(r"<contact>.*?</contact>", printed)[0]
    both = line + line.replace("left_pad", "right_pad")
    fixed = model.replace("</worldbody>", f"</worldbody>{both}")
    held = fallen_mm_per_s(mujoco.MjModel.from_xml_string(fixed))
    assert 1e3 * held == pytest.approx(float(after), rel=0.05)


def test_a_mesh_has_the_values_of_its_box():
    """A brick of eight vertices on a plane, as a mesh and as a box."""
    corners = " ".join(
        f"{x} {y} {z}"
        for x in (-0.03, 0.03)
        for y in (-0.02, 0.02)
        for z in (-0.01, 0.01)
    )
    tables = []
    for geom in ('type="mesh" mesh="brick"', 'type="box" size=".03 .02 .01"'):
        model = mujoco.MjModel.from_xml_string(f"""<mujoco><asset><mesh name="brick" vertex="{corners}"/></asset>
          <worldbody><geom name="floor" type="plane" size="1 1 1"/><body pos="0 0 .0101"><freejoint/>
          <geom name="foot" {geom} mass=".2"/></body></worldbody></mujoco>""")
        tables.append(touching_table(configuration(model))[0].rows[0])
    assert tables[0] == tables[1] and tables[0][1].startswith("1, ")


# --- other stacks ----------------------------------------------------------------------------------------------------


def test_other_stacks_combine_the_same_materials_differently():
    """0.3 and 1.0: the greater, the mean, the product, and Drake's 2 a b / (a + b)."""
    combined = {(name, title): rule(0.3, 1.0) for name, title, _, rule, *_ in STACKS}
    assert combined["genesis", "Genesis"] == 1.0
    assert combined["pybullet", "PyBullet"] == 0.3
    assert combined["physx", "PhysX, SAPIEN"] == combined["rapier", "Rapier"] == 0.65
    assert combined["drake", "Drake"] == pytest.approx(0.6 / 1.3)


def test_an_unknown_stack_is_an_error_with_the_known_ones(gauge):
    words = ("--pair", "left_pad,capsule", "--only", "gravity", "--as", "isac")
    result = gauge("sanity", str(GRIPPER), *words)
    assert result.exit_code == 2 and "did you mean isaac" in result.output
