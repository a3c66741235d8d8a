"""The row `robot-solver`: a solver that leaves forces in one layout of its matrices is named, and a good one is not."""

import warnings
from contextlib import closing

import gymnasium
import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

from gauge_envs.backends.mujoco.model_settings import contact_pairs
from gauge_envs.cli.app import app
from gauge_envs.tools.assets.build import assets_folder
from gauge_envs.tools.sanity.robot.finding import ROWS
from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.robot.robot import Robot
from gauge_envs.tools.sanity.robot.solver_agreement import NO_MEMORY, imbalance

FAULTY = "4.0.0"
"""Release of MuJoCo whose sparse Newton solver leaves forces (google-deepmind/mujoco#3767)."""


def pile(count, arms, seed):
    """Free boxes with arms of one hinge each, dropped on a plane."""
    draw = np.random.RandomState(seed)
    bodies = []
    for box in range(count):
        x_m, y_m = draw.uniform(-0.25, 0.25, 2)
        limbs = ""
        for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1))[:arms]:
            limbs += f"""<body pos="{0.06 * x} {0.05 * y} 0"><joint axis="{abs(y)} {abs(x)} 0" damping="0.01"/>
                <geom type="capsule" fromto="0 0 0 {0.08 * x} {0.08 * y} 0" size="0.012" density="500"/></body>"""
        bodies.append(
            f"""<body pos="{x_m} {y_m} {0.15 + 0.18 * (box // 2)}"><freejoint/>
            <geom type="box" size="0.06 0.05 0.04" density="500"/>{limbs}</body>"""
        )
    return f"""<mujoco><option jacobian="sparse"/><worldbody><geom type="plane" size="5 5 0.1"/>
        {"".join(bodies)}</worldbody></mujoco>"""


def found(xml):
    model = mujoco.MjModel.from_xml_string(xml)
    robot = Robot(model=model, pairs=contact_pairs(model), up=(0.0, 0.0, 1.0))
    return ROWS["robot-solver"](robot)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_faulty_release_is_named_on_an_articulated_pile(seed):
    value = found(pile(20, 4, seed)).value
    assert value > 0.1 if mujoco.__version__ == FAULTY else value < 1e-6


def is_sparse(model, data):
    return mujoco.mj_isSparse(model) and data.ncon


def is_cg(model, data):
    return model.opt.solver == mujoco.mjtSolver.mjSOL_CG


def is_threaded(model, data):
    return data.threadpool


def is_pgs(model, data):
    return model.opt.solver == mujoco.mjtSolver.mjSOL_PGS


# Scaled as a whole, the forces stay balanced.
BALANCED = ("qacc", "qfrc_smooth", "qfrc_constraint")
SCALED = [
    ("sparse", is_sparse, 1.01, ["qacc"], 'jacobian="dense"'),
    ("dense", is_cg, 0.99, BALANCED, "Newton and CG part by 0.01"),
    ("dense", is_threaded, 1.01, ["qacc"], "one thread and two part by 0.0099"),
]


def scale(monkeypatch, is_scaled, factor, arrays):
    forward = mujoco.mj_forward

    def scaled(model, data):
        forward(model, data)
        for name in arrays if is_scaled(model, data) else ():
            getattr(data, name)[:] *= factor

    monkeypatch.setattr(mujoco, "mj_forward", scaled)


@pytest.mark.parametrize(("layout", "is_scaled", "factor", "arrays", "words"), SCALED)
def test_a_solver_with_other_accelerations_is_named(
    layout, is_scaled, factor, arrays, words, monkeypatch
):
    """Layouts, solvers that go to the end, and threads give the same; planted, 1 % more or less."""
    xml = pile(3, 2, 0).replace("sparse", layout)
    good = found(xml)
    assert good.value < 1e-6 and not good.advice
    scale(monkeypatch, is_scaled, factor, arrays)
    one = found(xml)
    assert one.value == pytest.approx(0.01, rel=0.05)
    assert words in one.remark + one.advice
    assert layout == "sparse" or "dense" not in one.advice


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_pgs_is_compared_where_it_converges(cone, monkeypatch):
    xml = pile(2, 0, 0).replace('"sparse"', f'"dense" cone="{cone}"')
    assert found(xml).value == 0.0
    scale(monkeypatch, is_pgs, 0.99, ["qacc"])
    assert ("Newton and PGS" in found(xml).remark) == (cone == "pyramidal")


def test_a_model_without_memory_for_dense_matrices_is_not_measured():
    xml = pile(20, 4, 0).replace("<worldbody>", '<size memory="200K"/><worldbody>', 1)
    assert found(xml).unmeasured == NO_MEMORY


MESH = " ".join(
    f"{x} {y} {z}" for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.04, 0.05)
)
BODIES = {
    "pile of meshes": "".join(
        f'<body pos="{0.02 * i} 0 {0.06 + 0.12 * i}"><freejoint/><geom type="mesh" mesh="block"/></body>'
        for i in range(3)
    ),
    "compound of boxes": "".join(
        f'<body pos="{0.02 * i} 0 {0.06 + 0.12 * i}"><freejoint/><geom type="box" size="0.1 0.03 0.03"/>'
        '<geom type="box" size="0.03 0.1 0.03" pos="0 0 0.04"/></body>'
        for i in range(3)
    ),
    "cloth on a body": '<body pos="0 0 0.1"><freejoint/><geom size="0.1"/></body>'
    '<flexcomp name="cloth" type="grid" dim="2" count="5 5 1" spacing="0.06 0.06 0.06" pos="0 0 0.25" radius="0.005"'
    ' mass="0.1"><edge equality="true"/></flexcomp>',
}


@pytest.mark.parametrize(
    "layout", ["sparse", pytest.param("dense", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("kind", BODIES)
def test_solvers_layouts_and_threads_agree_on(kind, layout):
    one = found(
        f"""<mujoco><option jacobian="{layout}"/><asset><mesh name="block" vertex="{MESH}"/></asset>
        <worldbody><geom type="plane" size="5 5 0.1"/>{BODIES[kind]}</worldbody></mujoco>"""
    )
    assert (one.value, one.unmeasured, one.declined) == (0.0, "", "")


def test_what_few_iterations_leave_is_said_and_is_no_fault():
    xml = pile(3, 2, 0).replace("sparse", "dense")
    few = xml.replace("<option", '<option iterations="1"')
    assert "iterations leave" not in found(xml).remark
    one = found(few)
    assert "1 iterations leave up to" in one.remark
    assert one.advice == ""


def test_the_imbalance_is_the_missing_share_of_the_forces():
    """A ball that falls: without its weight, all of `M a` is missing."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><freejoint/><geom size="0.1"/></body></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert imbalance(model, data) < 1e-12
    data.qfrc_smooth[:] = 0.0
    assert imbalance(model, data) == pytest.approx(1.0)


@pytest.mark.parametrize("layout", ["sparse", "dense"])
def test_the_faulty_release_is_noted_for_sparse_models_alone(layout, monkeypatch):
    monkeypatch.setattr(mujoco, "__version__", FAULTY)
    model = mujoco.MjModel.from_xml_string(pile(2, 1, 0).replace("sparse", layout))
    read = mujoco_configuration(model, name="pile", source="a test")
    assert [note for note in read.notes if FAULTY in note] == (
        [
            f"MuJoCo {FAULTY} solves some sparse models wrongly: set "
            '<option jacobian="dense"/>, as robot-solver measures'
        ]
        if layout == "sparse"
        else []
    )


@pytest.mark.parametrize("layout", ["sparse", "dense"])
def test_a_sparse_file_of_the_user_warns_under_the_faulty_release(
    layout, monkeypatch, tmp_path
):
    monkeypatch.setattr(mujoco, "__version__", FAULTY)
    sliding = (assets_folder() / "mjcf" / "SlopeSlider-2-wood.xml").read_text()
    scene = tmp_path / "slide.xml"
    scene.write_text(
        sliding.replace("<option ", f'<option jacobian="{layout}" ', 1), "utf-8"
    )
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        with closing(gymnasium.make("GAUGE/SlopeSlider-2-wood", asset=scene)):
            pass
    found = {str(one.message) for one in seen if FAULTY in str(one.message)}
    expected = {f"{scene.name}: {sparse_text()}"}
    assert found == (expected if layout == "sparse" else set())


def sparse_text():
    return f'MuJoCo {FAULTY} solves some sparse models wrongly: set <option jacobian="dense"/>'


def test_a_check_without_flags_names_the_faulty_release(monkeypatch, tmp_path):
    monkeypatch.setattr(mujoco, "__version__", FAULTY)
    file = tmp_path / "pile.xml"
    file.write_text(pile(1, 0, 0))
    told = CliRunner().invoke(app, ["sanity", str(file), "--only", "robot-solver"])
    words = " ".join(told.output.split())
    assert "No flags" in words
    assert "note: " + sparse_text() in words
