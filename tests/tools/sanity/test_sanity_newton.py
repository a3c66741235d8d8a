"""Models and solvers of Newton as targets: real objects of Newton, read and judged as their solver runs them."""

import re
import warnings

import numpy as np
import pytest

newton = pytest.importorskip("newton")

import warp as wp  # noqa: E402

from gauge_envs.errors import TargetError  # noqa: E402
from gauge_envs.scene import Box  # noqa: E402
from gauge_envs.tools.sanity import Need, Verdict, check, configuration  # noqa: E402
from gauge_envs.tools.sanity.measure import Measurements  # noqa: E402
from gauge_envs.tools.sanity.phenomena import phenomena  # noqa: E402
from gauge_envs.tools.sanity.stacks.newton import (  # noqa: E402
    is_newton,
    newton_configuration,
    stiffness_and_damping,
)

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")

ShapeConfig = newton.ModelBuilder.ShapeConfig


def model_of(*shapes, ground=None, **builder_arguments):
    """Return a model of boxes on a plane, each with constants of its shape."""
    builder = newton.ModelBuilder(**builder_arguments)
    builder.add_ground_plane(cfg=ShapeConfig(**(ground or {})))
    for index, shape in enumerate(shapes):
        body = builder.add_body(
            mass=1.0,
            xform=wp.transform(wp.vec3(0.5 * index, 0.0, 0.2), wp.quat_identity()),
        )
        builder.add_shape_box(
            body,
            hx=0.1,
            hy=0.1,
            hz=0.1,
            cfg=ShapeConfig(**shape),
            label=f"foot-{index}",
        )
    return builder.finalize(device="cpu")


def solver_of(model, **arguments):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return newton.solvers.SolverMuJoCo(model, **arguments)


# --- what is read ----------------------------------------------------------------------------------------------------


def test_arguments_of_the_solver_are_the_settings():
    solver = solver_of(
        model_of({}),
        iterations=7,
        ls_iterations=9,
        cone="elliptic",
        impratio=40.0,
        integrator="euler",
        tolerance=1e-5,
        use_mujoco_contacts=False,
    )
    read = newton_configuration(solver, step_s=0.004)
    assert read.backend == "newton" and read.language == "newton"
    assert read.settings == {
        "timestep_s": 0.004,
        "integrator": "euler",
        "cone": "elliptic",
        "impratio": 40.0,
        "iterations": 7,
        "line_search_iterations": 9,
        "tolerance": pytest.approx(1e-5),
        "mujoco_contacts": False,
        "contact_solref": (0.02, 1.0),
        "contact_solimp": (0.9, 0.95, 0.001, 0.5, 2.0),
        "contact_kf_n_s_per_m": 1000.0,
    }
    assert read.origins["timestep_s"] == "dt of SolverMuJoCo.step"
    assert read.origins["contact_solref"] == "ground_plane_0 with foot-0_1"


def test_stiffness_and_damping_of_shapes_are_read_as_the_solver_mixes_them():
    solver = solver_of(
        model_of({"ke": 1e4, "kd": 300.0}, ground={"ke": 1e4, "kd": 300.0})
    )
    assert newton_configuration(solver).settings["contact_solref"] == pytest.approx(
        (2.0 / 300.0, 1.5), rel=1e-5
    )
    solver = solver_of(model_of({"ke": 1e4, "kd": 300.0}))
    mixed = (0.5 * (0.02 + 2.0 / 300.0), 1.25)
    assert newton_configuration(solver).settings["contact_solref"] == pytest.approx(
        mixed, rel=1e-5
    )


def test_every_kind_of_foot_is_a_set_of_its_own():
    stiff, soft = {"ke": 1e4, "kd": 200.0}, {"ke": 200.0, "kd": 20.0}
    read = newton_configuration(
        solver_of(model_of(stiff, soft, ground=stiff)), step_s=0.002
    )
    assert len(read.contact_sets) == 2
    assert [
        group.is_used for group in read.contact_groups if "ground" in group.geoms
    ] == [True, True]
    one = newton_configuration(
        solver_of(model_of(stiff, soft, ground=stiff)),
        pair=("ground_plane_0", "foot-1_2"),
    )
    assert len(one.contact_sets) == 1 and one.settings["contact_solref"][0] > 0.05


def test_the_step_is_given_or_that_of_a_solver_that_ran():
    model = model_of({})
    solver = solver_of(model)
    read = newton_configuration(solver)
    assert "timestep_s" not in read.settings and "give step_s" in read.notes[0]
    states = model.state(), model.state()
    solver.step(*states, None, None, 0.003)
    assert newton_configuration(solver).settings["timestep_s"] == 0.003
    assert newton_configuration(solver, step_s=0.001).settings["timestep_s"] == 0.001


def test_a_model_alone_has_the_defaults_of_the_solver():
    model = model_of({})
    assert (
        is_newton(model)
        and is_newton(solver_of(model))
        and not is_newton(newton)
        and not is_newton("Model")
    )
    read = configuration(model)
    assert read.settings["cone"] == "pyramidal" and read.settings["iterations"] == 100
    assert "with the defaults of SolverMuJoCo" in read.source


def test_what_is_not_as_it_seems_is_noted():
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    builder.add_ground_plane()
    body = builder.add_body(mass=1.0)
    shape = builder.add_shape_box(
        body, hx=0.1, hy=0.1, hz=0.1, cfg=ShapeConfig(kf=10.0, margin=0.01)
    )
    builder.custom_attributes["mujoco:solref_mode"].values = {shape: 0}
    solver = solver_of(builder.finalize(device="cpu"), use_mujoco_contacts=False)
    notes = "; ".join(newton_configuration(solver, step_s=0.002).notes)
    assert "ke and kd of 1 shapes are forces" in notes
    assert "several friction gains kf" in notes
    assert "margins of shapes are not carried over" in notes


def test_contacts_that_cannot_happen_are_declined():
    builder = newton.ModelBuilder()
    builder.add_shape_box(builder.add_body(mass=1.0), hx=0.1, hy=0.1, hz=0.1)
    read = newton_configuration(solver_of(builder.finalize(device="cpu")), step_s=0.002)
    assert Need.CONTACT in read.inapplicable


@pytest.mark.parametrize("name", ["SolverXPBD", "SolverSemiImplicit"])
def test_other_solvers_are_sent_to_the_export(name):
    solver = getattr(newton.solvers, name)(model_of({}))
    with pytest.raises(
        TargetError, match=f"{name}: rigid bodies are judged with SolverMuJoCo only"
    ):
        configuration(solver)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"solver": "cg"}, "solver CG is not run"),
        ({"integrator": "implicit"}, "integrator implicit is not run"),
    ],
)
def test_an_option_that_is_not_run_is_an_error(arguments, message):
    with pytest.raises(TargetError, match=message):
        newton_configuration(solver_of(model_of({}), **arguments))


# --- what is reported ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "solref", [(0.02, 1.0), (0.005, 1.0), (0.004, 1.2), (0.1, 0.3)]
)
def test_the_reported_stiffness_gives_the_solref_in_newton(solref):
    found = stiffness_and_damping(solref)
    constants = {"ke": found[0], "kd": found[1]}
    solver = solver_of(model_of(constants, ground=constants))
    assert newton_configuration(solver).settings["contact_solref"] == pytest.approx(
        solref, rel=1e-5
    )


def test_a_wrong_gravity_is_found_with_the_call_that_mends_it():
    model = model_of({}, gravity=(0.0, 0.0, -5.0))
    report = check(
        newton_configuration(solver_of(model), step_s=0.002), only=["gravity"]
    )
    (row,) = report.rows
    assert row.verdict is Verdict.WRONG and row.cause is not None
    assert row.cause.line == "model.set_gravity((0, 0, -9.81)) instead of 0 0 -5"
    model.set_gravity((0, 0, -9.81))
    report = check(
        newton_configuration(solver_of(model), step_s=0.002), only=["gravity"]
    )
    assert report.rows[0].verdict is Verdict.INSIDE


def test_too_little_memory_for_contacts_is_a_row_with_the_numbers_that_suffice():
    feet = [{} for _ in range(6)]
    solver = solver_of(model_of(*feet), njmax=12, nconmax=4)
    (row,) = check(
        newton_configuration(solver, step_s=0.005), only=["contact-capacity"]
    ).rows
    assert row.verdict is Verdict.WRONG and row.cause is not None
    assert row.cause.line.startswith("SolverMuJoCo(model, njmax=")
    changes = {
        name: int(number)
        for name, number in re.findall(r"(njmax|nconmax)=(\d+)", row.cause.line)
    }
    enough = solver_of(model_of(*feet), **{"nconmax": 100, **changes})
    (row,) = check(
        newton_configuration(enough, step_s=0.005), only=["contact-capacity"]
    ).rows
    assert row.verdict is Verdict.INSIDE


# --- truth -----------------------------------------------------------------------------------------------------------

STEP_S = 0.005


def creep_in_plain_newton(arguments, constants):
    """Return the creep of the wooden cube of the check on its board [mm/s], with Newton alone."""
    (phenomenon,) = phenomena(["creep-wood"])
    scene = phenomenon.scenario.scene
    cube, board = scene.body("cube"), scene.body("board")
    assert isinstance(cube.shape, Box) and isinstance(board.shape, Box)
    friction = next(
        contact.friction for contact in scene.contacts if "board" in contact.second
    )
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, -scene.gravity_m_per_s2))
    config = ShapeConfig(
        mu=friction, density=0.0, mu_torsional=0.0, mu_rolling=0.0, **constants
    )
    for body in (board, cube):
        w, x, y, z = body.pose.quaternion
        place = wp.transform(wp.vec3(*body.pose.position_m), wp.quat(x, y, z, w))
        edge = cube.shape.size_m[0]
        inertia = wp.mat33(np.eye(3) * cube.mass_kg * edge**2 / 6.0)
        free = body is cube
        index = (
            builder.add_body(
                xform=place, mass=cube.mass_kg, inertia=inertia, lock_inertia=True
            )
            if free
            else -1
        )
        half = [0.5 * length for length in body.shape.size_m]
        builder.add_shape_box(
            index,
            xform=wp.transform_identity() if free else place,
            hx=half[0],
            hy=half[1],
            hz=half[2],
            cfg=config,
        )
    model = builder.finalize(device="cpu")
    solver = solver_of(model, use_mujoco_contacts=False, **arguments)
    pipeline = newton.CollisionPipeline(model)
    contacts, control = pipeline.contacts(), model.control()
    before, after = model.state(), model.state()
    downhill = board.pose.rotation.apply([1.0, 0.0, 0.0])
    along = []
    for _ in range(round(1.0 / STEP_S) + 1):
        along.append(1e3 * float(before.body_q.numpy()[0, :3].astype(float) @ downhill))
        pipeline.collide(before, contacts)
        solver.step(before, after, control, contacts, STEP_S)
        before, after = after, before
    times = STEP_S * np.arange(len(along))
    late = times >= 0.5 - 1e-9
    return float(np.polyfit(times[late], np.array(along)[late], 1)[0])


@pytest.mark.parametrize(
    ("cone", "constants"),
    [
        pytest.param(
            "pyramidal", {"ke": 100.0, "kd": 20.0}, id="soft", marks=pytest.mark.slow
        ),
        pytest.param("elliptic", {"ke": 2500.0, "kd": 100.0}, id="default"),
    ],
)
def test_a_cube_creeps_as_in_plain_newton(cone, constants):
    arguments = {"iterations": 50, "cone": cone, "impratio": 1.0}
    plain = creep_in_plain_newton(arguments, constants)
    solver = solver_of(
        model_of(constants, ground=constants), use_mujoco_contacts=False, **arguments
    )
    read = newton_configuration(solver, step_s=STEP_S)
    (phenomenon,) = phenomena(["creep-wood"])
    measured = Measurements("newton").measure(phenomenon, read.settings)
    assert measured.value == pytest.approx(plain, rel=1e-3)
