"""Planted faults: each is caught by a check whose diagnosis names it, and every check can fail."""

import re

import mujoco
import numpy as np
import pytest
from mutations import FAULTS, Fault, Mutant, Passed, first_failure, is_of_the_fault
from mutations.generated import KINDS, generated, is_held_out
from mutations.worlds import RAISES

from gauge_envs.backends import backend
from gauge_envs.backends.mujoco.versions import FAULTY_SPARSE
from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import Scene
from gauge_envs.tools.bench.parts import ball
from gauge_envs.tools.conformance import Status, checks, run_checks, solver, worlds
from gauge_envs.tools.conformance.differences import cause_of
from gauge_envs.tools.conformance.facts import facts

MUJOCO = backend("mujoco")

ALSO = """
angular-velocity         quaternion-order                                   another order inside
carry-slip               friction-low                                       is not the pair's
cloth-reset              no-reset                                           positions and velocities of nodes
cloth-restore            restore.velocity:drop:all                          velocities
drop-energy              gains-energy                                       the engine makes energy
foam-pinned-face         nodes-lag                                          one interval (1/180 s) late
foam-start               nodes-millimetres                                  nodes are world positions
free-fall-turn           RigidBody.angular_velocity_rad_per_s:offset:2-True of the brick at the start is
inertia-box              quaternion-inside                                  w, x, y, z was read as x, y, z, w
joint-stick              joint-dry-viscous                                  viscous at low speed
pendulum-energy          hinge-damping                                      viscous friction
pendulum-long-energy     hinge-damping                                      damped slowly
pendulum-long-period     hinge-damping                                      damped slowly
reset-course             reset.velocity:stale:all                           does not restore velocities
rest-box                 margin                                             half sizes
rest-convex              margin                                             a margin, or its size
rest-cylinder            Cylinder.length_m:side:dynamic-0.5                 its length is half
rest-driven              margin                                             a margin, or its size
rest-lying-cylinder      Cylinder.radius_m:side:dynamic-0.5                 its radius is half
rest-sphere              margin                                             a margin, or its size
foam-restore             restore.velocity:drop:all                          after restore()
rope-restore             restore.velocity:drop:all                          after restore()
copies-alike             engine.spin:side:negative                          the order of bodies and pairs
tether-place             Tether.anchor_m:offset:0-False                     furthest for the
restore-edge             restore.velocity:drop:all                          after restore()
restore-impact           restore.velocity:drop:all                          after restore()
reset-start              reset.velocity:stale:all                           velocities are kept
restore                  restore.velocity:drop:all                          velocities
joint-delay              command.value:stale:one-call                       the next advance()
start-velocity           reset.velocity:drop:all                            starts at rest
spin-fast                engine.spin:saturate:3                             limits or damps angular velocities
glide-speed              engine.velocity:threshold:slow-frozen              sleep
rod-start                lines-turned                                       z for a rod
roll-cylinder            rolling-friction                                   rolling friction were
slide-plane              plane-level                                        that the plane's normal
slide-plane              friction-holds                                     friction holds the brick
spin-momentum            hinge-damping                                      angular damping
start-rest               steps-at-build                                     must not step
start-velocity-reset     reset.velocity:drop:all                            at rest after the reset
centre-union             centre-elsewhere                                   centre of mass should be
new-arrays               buffer.states:stale:reused                         reused buffer
cloth-new-arrays         buffer.nodes:stale:reused                          reused buffer
settings-step            settings.timestep_s:scale:0.1                      settings state
two-at-once              Scene.gravity_m_per_s2:stale:last-built            share constants
reset-command            reset.command:stale:all                            outlives reset
restore-command          restore.command:stale:all                          the command of a motor
glide-speed              engine.velocity:saturate:3                         a limit of speed
glide-turn               engine.hinge_rate:scale:damped-0.05                viscous friction
driven-turned-path       drive.position:kth:first                           the first block is off
glide-reports            report.spin:side:negative                          the reported angular velocity
volley-order             Contact.restitution:side:fixed-first-0.8           is first
volley-fast              Contact.restitution:threshold:above-8m/s           depends on speed
volley-late              Contact.restitution:threshold:after-2s             depends on time
volley-momentum          RigidBody.mass_kg:kth:third-0.5                    mass of a body
crossed-edges            Contact.pair:frame:crossed-boxes                   fall through each other
pucks-friction           Contact.friction:side:fixed-first-0.8              is listed first
carry-late               Contact.friction:threshold:after-1s                depends on time
driven-turned-path       drive.spin:frame:body                              its orientation by
driven-turned-rate       report.spin:frame:body                             in the body frame
cloth-rests-on           Contact.pair:side:deformable-Cloth-dynamic         falls through the free
foam-rests-on            Contact.pair:side:deformable-SoftBody-fixed        falls through the fixed
rope-rests-on            Contact.pair:side:deformable-Rope-kinematic        falls through the driven
rod-rests-on             Contact.pair:side:deformable-Rod-fixed             falls through the fixed
cloth-carry-slip         Contact.friction:side:driven-0.5                   carried as if
cloth-strike             Cloth.areal_density_kg_per_m2:scale:1.25           the momentum is
foam-strike              SoftBody.mass_kg:scale:1.25                        the momentum is
rope-strike              Rope.mass_kg:scale:1.25                            the momentum is
rod-strike               Rod.mass_kg:scale:1.25                             the momentum is
rope-mass                Rope.mass_kg:threshold:after-1s                    from 0 to 0.9 s
rope-pulled-length       Rope.length_m:kth:second-1.25                      right: rope 0, rope 2
cloth-held               Region.depth_m:scale:0.5                           not attached over its depth
foam-held                attachments-drift                                  an attachment drifts
rod-held                 attachments-drift                                  an attachment drifts
foam-clamp               Region.depth_m:kth:second-1.25                     furthest for the second bar
slider-fall              Scene.gravity_m_per_s2:scale:0.8                   acceleration along the axis
slider-line              Slider.axis:names:late-0.5                         from the axis of its slider
slider-limit             Slider.limits_m:scale:1.25                         goes as far as
hinge-limit              Hinge.limits_rad:scale:1.25                        goes as far as
hinge-radius             Hinge.anchor_m:offset:2-False                      mm from the anchor
joint-dry                Hinge.axis:swap:0-2                                from the axis of its hinge
all-bodies-move          Scene.gravity_m_per_s2:crowd:above-2-bodies-0.5    times the gravity
rest-driven              drive.position:offset:1                            from where it is driven
worlds-single            batch.Contact.friction:stale:first-for-all         friction
start-velocity           RigidBody.linear_velocity_m_per_s:drop:zero        at rest
driven-turned-path       drive.spin:swap:0-1                                orientation by
worlds-reset             batch.reset:kth:last                               reset must return all worlds
worlds-restart           batch.restart:crowd:all                            which goes on, differs most
worlds-restart           batch.restart:crowd:next-too                       which goes on, differs most
worlds-wrench            batch.RigidBody.mass_kg:kth:second-0.8             0.8 times the mass
worlds-command           batch.command:stale:first-for-all                  command of the first world
rod-bending              Rod.young_modulus_pa:scale:1.25                    bends
rod-bending              Rod.radius_m:scale:1.25                            radius
rod-bending              Rod.mass_kg:scale:1.25                             mass of the nodes
foam-tension             SoftBody.mass_kg:scale:1.25                        mass of the nodes
worlds-single            batch.states:stale:one-before                      has the values of world 0, of all
worlds-single            batch.states:side:odd-0.8                          that are read are 0.8 times
worlds-single            batch.states:mixed:half                            0.5 times the mean
worlds-single            batch.states:kth:second-late                       the reading is late
worlds-single            batch.drive:kth:second-0.8                         driven plate is elsewhere
worlds-single            batch.Contact.restitution:kth:second-0.8           its restitution is
worlds-single            batch.advance:kth:second-10th                      leave the world out
worlds-restart           batch.restart:swap:reversed                        restart must return
ball-joint-cone          BallJoint.anchor_m:offset:2-True                   its height changes
cloth-shear              Cloth.shear_stiffness_n_per_m:scale:1.25           shear
cloth-bending            Cloth.bend_stiffness_n_m_per_rad:scale:1.6         bends 0.
cloth-stretch            Cloth.areal_density_kg_per_m2:scale:1.25           mass of the nodes
cloth-slide              Contact.friction:scale:0.8                         friction were 0.24
cloth-start              Cloth.size_m:swap:0-1                              warp along x
cloth-rests              Contact.pair:drop:all                              falls through
foam-tension             SoftBody.young_modulus_pa:scale:1.25               stretches 0.
foam-poisson             SoftBody.poisson_ratio:drop:none                   nu = 0
rope-start               Rope.length_m:scale:1.25                           mm long instead of 300
air-terminal             Air.normal_coefficient:drop:none                   no effect
air-terminal             Air.density_kg_per_m3:scale:1.6                    times
air-pressure             Air.wind_m_per_s:drop:zero                         the force of the air is 0
air-friction             Air.tangential_coefficient:scale:0.5               counts both sides
air-lift                 Air.lift_coefficient:drop:none                     perpendicular
tether-rest              Tether.length_m:scale:1.25                         its length is not length_m
tether-rest              Tether.anchor_m:names:late-0.5                     the third bob hangs
joint-viscous            JointDynamics.viscous_friction_n_m_s_per_rad:rounded:4-bits friction of its hinge were 0.0195
joint-between            BodyHinge.axis:swap:0-2                            of its hinge to the lower
tether-length            Tether.length_m:scale:1.25                         375
rope-length              Rope.length_m:scale:1.25                           becomes 376
tether-length            Tether.joint:drop:all                              missing
tether-slack             Tether.length_m:scale:0.8                          shorter than its length_m
wrench-force             RigidBody.mass_kg:scale:1.25                       mass were 1.25
wrench-force             wrench.force:drop:all                              the wrench is ignored
inertia-box              wrench.torque:drop:all                             torque
inertia-box              Box.size_m:scale:1.6                               edges were
inertia-cylinder         Cylinder.length_m:scale:0.5                        radius and length were 20, 45 mm
inertia-cylinder         Cylinder.radius_m:scale:0.5                        radius and length were 10, 90 mm
inertia-sphere           Sphere.radius_m:scale:1.25                         its radius were
contact-listed           Sphere.radius_m:scale:1.25                         radius is too large
contact-listed           Contact.pair:drop:all                              does not collide
pile-sinks               Contact.pair:drop:all                              tunnel
wrench-frame             wrench.force:frame:body                            world frame
stated-inertia           RigidBody.inertia_kg_m2:drop:none                  inertia were 0.000145
pendulum-period          Hinge.joint:drop:all                               hinge is missing
pendulum-period          Hinge.anchor_m:offset:0-False                      anchor of its hinge
hinged-closed            BodyHinge.joint:drop:all                           the hinge is missing
joint-dry                JointDynamics.dry_friction_n_m:scale:1.25          dry friction of its hinge were 0.025
joint-slip               JointDynamics.dry_friction_n_m:scale:1.25          friction at rest
joint-viscous            JointDynamics.viscous_friction_n_m_s_per_rad:scale:1.25 friction of its hinge were 0.025
wrench-reset             reset.wrench:stale:all                             reset must clear
restore-wrench           restore.wrench:drop:all                            wrench
joint-dry-servo          JointDynamics.dry_friction_n_m:drop:none           dry friction of its hinge were 0
pendulum-period          JointDynamics.armature_kg_m2:offset:False          armature
grasp-holds              command.value:threshold:after-2                    than torque over length
hinged-energy            JointDynamics.viscous_friction_n_m_s_per_rad:offset:False damping
joint-servo              Servo.kp_n_m_per_rad:scale:1.25                    kp of its servo were 2.5
joint-torque             command.value:scale:1.25                           share of its motor's torque were 1.25
copies-alike             Servo.kv_n_m_s_per_rad:stale:first-for-all         the kv of its servo were
pendulum-period          Hinge.anchor_m:alternates:odd-0.5s-1.6             at once: the anchor moves
joint-servo              Servo.kp_n_m_per_rad:alternates:odd-0.5s-0.5       instead of 2 for part of the time
joint-armature           JointDynamics.armature_kg_m2:drop:none             armature of its hinge were 0
joint-backlash           JointDynamics.backlash_rad:scale:1.6               half of the play
joint-limit              Servo.torque_limit_n_m:saturate:most               torque limit of its servo were 0.02
joint-between            BodyHinge.anchor_m:drop:zero                       from the anchor of its hinge
grasp-slips              Contact.friction:scale:0.8                         that both pads rub
driven-velocity          drive.velocity:drop:all                            without velocity
carry-line               drive.velocity:drop:all                            without velocity
carry-turn               drive.spin:drop:all                                without velocity
carry-slip               Contact.friction:scale:0.8                         is not the pair's
pushed-ball              drive.velocity:drop:all                            without velocity
driven-turned-path       drive.acceleration:drop:all                        acceleration that drive() gives
carry-line               drive.acceleration:drop:all                        drive() gives is ignored
angular-velocity         report.spin:frame:body                             body frame
velocity-of-origin       report.velocity:frame:body                         body frame
rebound-0.2              Contact.restitution:drop:none                      restitution
rebound-0.5              Contact.restitution:drop:none                      restitution enters
rebound-0.95             Contact.restitution:offset:True                    restitution
oblique-slip-rebound     Contact.restitution:drop:none                      slip adds to the rebound
oblique-grip-speed       Contact.friction:drop:none                         the impact has no friction
oblique-grip-spin        Contact.friction:drop:none                         the impact has no friction
oblique-slip-friction    Contact.friction:drop:none                         the impact has no friction
hold                     Contact.friction:drop:none                         creeps
slide                    Contact.friction:drop:none                         friction were
slide-between            Contact.friction:side:dynamic-pair-0.5             two dynamic bodies
hold-steep               Contact.friction:saturate:most                     limits friction
rolling                  Contact.rolling_m:drop:none                        the dimension of rolling friction
torsion                  Contact.torsion_m:scale:0.5                        a share of the friction
"""
"""Further checks that see a fault: check, fault (of the table, or a generated one), and words of the diagnosis."""
ALL = FAULTS | {name: one.fault for name, one in generated().items()}
CASES = (
    *((fault.caught_by, name, fault.says) for name, fault in FAULTS.items()),
    *(row.split(maxsplit=2) for row in ALSO.strip().splitlines()),
)
SLOW = re.compile(r"foam-|rope-|(cloth|rod)-(held|rests-on|strike)")
"""Checks of scenes that take half a second or more; laws of cloth and rods stay."""
FIRST = {check: name for check, name, _ in reversed(CASES)}
"""A fault for each check."""


def marks_of(check, name):
    """Return the marks of a case: by default one fault of each check runs."""
    is_slow = SLOW.match(check) or name != FIRST[check]
    return [pytest.mark.slow] if is_slow else []


@pytest.mark.parametrize(
    ("check", "name", "says"),
    [
        pytest.param(
            *case,
            marks=marks_of(case[0], case[1]),
            id=f"{case[0]}-{case[1]}",
        )
        for case in CASES
    ],
)
def test_a_check_names_the_fault_of_a_mutant(check, name, says, monkeypatch):
    # Few worlds of MuJoCo, which are simulations of their own.
    monkeypatch.setattr(worlds, "TOGETHER", 6)
    monkeypatch.setattr(worlds, "SINGLES", (0, 1, 5))
    mutant = Mutant(MUJOCO, ALL[name])
    (result,) = run_checks(mutant, only=[check])
    assert result.status is Status.FAIL
    assert is_of_the_fault(mutant, result)
    assert says in result.diagnosis


@pytest.mark.parametrize(
    ("off_m", "is_late"), [(0.0, True), (1e-6, True), (0.004, False)]
)
def test_a_reading_is_late_where_rounding_alone_is_left(off_m, is_late):
    """A ball passes 1 m in an interval; what is late by all but 4 mm of it starts elsewhere."""
    law = np.zeros((42, 3, 13))
    law[:, 0, 0] = np.arange(42)
    read = np.concatenate([law[:1], law[:-1]])
    read[:, 0, 0] += off_m
    cause = cause_of(read, law, {}, np.zeros_like(law))
    assert ("the reading is late" in cause) == is_late
    assert "advance()" not in cause


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ((0.001, 0.0, 0.0, 0.0), "position of the ball at the start is off by (1,"),
        ((0.0, 0.0, 0.0, 0.01), "orientation of the ball at the start is off by 1.15"),
        ((0.0004, 0.0, 0.0, 0.004), ""),
    ],
)
def test_a_start_elsewhere_is_a_fact_from_half_a_millimetre_and_degree_on(change, says):
    one = ball("ball", (0.1, 0.2, 0.3))
    states = np.zeros((3, 13))
    # A turn about x by twice the last value [rad].
    states[:, :5] = [*np.add(one.pose.position_m, change[:3]), 1.0, change[3]]
    scene = Scene(bodies=(one,), duration_s=0.1, gravity_m_per_s2=0.0)
    found = facts(Rollout(scene=scene, times_s=np.arange(3.0), states={"ball": states}))
    assert bool(found) == bool(says)
    assert says in found


def test_every_check_can_fail():
    mutants = {check for check, _, _ in CASES}
    known = mutants | {*solver.SCENES, "solver-heap"}
    assert known == {check.id for check in checks()}


def test_iterations_that_end_before_the_solution_are_named():
    given, ended = (
        next(iter(run_checks("mujoco", only=["solver-heap"], settings=settings)))
        for settings in (None, {"iterations": 2})
    )
    assert given.status is Status.PASS
    assert given.measured < 1e-6
    assert ended.status is Status.FAIL
    assert "2 and 20 iterations part by" in ended.diagnosis


def test_a_batch_whose_worlds_take_one_start_is_named(monkeypatch):
    """Rapier builds worlds together: planted, all start as the first."""
    pytest.importorskip("rapier3d")
    together = solver._together
    monkeypatch.setattr(
        solver,
        "_together",
        lambda lab, scenes: together(lab, [scenes[0]] * len(scenes)),
    )
    (found,) = run_checks("rapier", only=["solver-heap"])
    assert found.measured > 0.9
    assert "one world and 6 part by" in found.diagnosis


@pytest.mark.parametrize(
    "check",
    [
        pytest.param(one, marks=[pytest.mark.slow] if one == "solver-pile" else [])
        for one in solver.SCENES
    ],
)
def test_a_solver_that_leaves_a_hundredth_of_the_accelerations_is_named(
    check, monkeypatch
):
    """The checks of solutions read MJCF files, which no mutant of the contract reaches."""
    healthy = check != "solver-pile" or mujoco.__version__ not in FAULTY_SPARSE
    (result,) = run_checks("mujoco", only=[check])
    assert result.status is (Status.PASS if healthy else Status.FAIL)
    forward = mujoco.mj_forward

    def scaled(model, data):
        forward(model, data)
        if data.ncon and model.opt.jacobian == mujoco.mjtJacobian.mjJAC_AUTO:
            data.qacc *= 1.01

    monkeypatch.setattr(mujoco, "mj_forward", scaled)
    (result,) = run_checks("mujoco", only=[check])
    assert result.measured > 0.009
    assert "sparse and dense part by" in result.diagnosis


def test_batches_that_raise_are_an_error():
    results = run_checks(Mutant(MUJOCO, RAISES), only=["worlds-*"])
    assert {one.status for one in results} == {Status.ERROR}


def test_simpler_checks_run_after_a_failure_until_one_cause_is_left():
    """A wrong report fails the check of a start at rest, and the tried motion tells it from a body that moves."""
    reports = Mutant(MUJOCO, ALL["report.velocity:offset:2"])
    moves = Mutant(MUJOCO, ALL["engine.velocity:frame:axis-damped"])
    (told,), (plain,) = (
        run_checks(reports, only=["start-rest"], eliminates=how) for how in (True, None)
    )
    assert told.diagnosis.startswith(plain.diagnosis)
    assert "Tried: order-of-names to time (4 checks) pass." in told.diagnosis
    assert "fails is glide-reports: the reported velocity of" in told.diagnosis
    assert "Tried" not in plain.diagnosis
    (slowed,) = run_checks(moves, only=["start-velocity"], eliminates=True)
    assert "fails is glide-speed: the speed is 0.7" in slowed.diagnosis
    calm = Mutant(MUJOCO, ALL["Air.wind_m_per_s:drop:zero"])
    (still,) = run_checks(calm, only=["air-pressure"], eliminates=True)
    assert "Left (air-friction: fail; air-terminal: pass): the wind" in still.diagnosis
    for check, name, says in (
        ("slide", "Contact.rolling_m:offset:True", "friction against rolling"),
        (
            "stated-inertia",
            "RigidBody.mass_kg:threshold:after-1s",
            "explained by: mass",
        ),
    ):
        mutant = Mutant(MUJOCO, ALL[name])
        (found,) = run_checks(mutant, only=[check], eliminates=True)
        assert says in found.diagnosis
    # That no simpler check fails is said once.
    rolls = Mutant(MUJOCO, ALL["rolling-friction"])
    names = ["roll-ball", "roll-cylinder"]
    first, second = run_checks(rolls, only=names, eliminates=True)
    assert first.diagnosis.endswith("No simpler check fails.")
    assert "Tried" not in second.diagnosis


class OtherSign(Passed):
    """Reports each quaternion with the other sign at every second reading, which is the same rotation."""

    count = 0

    def body_states(self, names):
        states = super().body_states(names)
        self.count += 1
        states[:, 3:7] *= (-1.0) ** self.count
        return states


def test_the_sign_of_a_quaternion_is_no_fault():
    healthy = Mutant(
        MUJOCO, Fault(what="", caught_by="", says="", simulation=OtherSign)
    )
    rigid = [
        "order-of-names",
        "start-*",
        "reset-*",
        "determinism",
        "restore",
        "two-at-once",
        "worlds-single",
    ]
    assert {one.status for one in run_checks(healthy, only=rigid)} == {Status.PASS}


def test_faults_are_generated_from_each_kind_and_half_of_the_classes_are_held_out():
    faults = generated().values()
    classes = {(one.quantity, one.kind) for one in faults}
    assert {kind for _, kind in classes} == set(KINDS)
    assert 0.45 < sum(is_held_out(*one) for one in classes) / len(classes) < 0.55
    assert len(faults) > 2000


def test_mutants_without_a_fault_pass():
    """The wrapper itself changes nothing."""
    fault = FAULTS["slow-restitution"]
    results = list(
        run_checks(
            Mutant(MUJOCO, fault), only=["free-fall*", "slide*", "reset-*", "restore"]
        )
    )
    assert {one.status for one in results} == {Status.PASS}


def test_not_finite_states_are_reported_once_and_first():
    results = list(
        run_checks(
            Mutant(MUJOCO, FAULTS["nan-mass"]),
            only=["finite", "free-fall*", "reset-*", "slide*"],
        )
    )
    own = [one.check for one in results if one.is_bad and not one.reported_by]
    assert own == ["finite"]
    assert {one.reported_by for one in results if one.is_bad} == {"", "finite"}
    assert "'brick' is not finite" in results[0].diagnosis


CONSEQUENCES = {
    "nodes-shuffled": "rope-start",
    "rolling-friction": "spin-on-point",
    "grasp-points": "grasp-creep",
    "random": "two-at-once",
}
"""Faults of which an earlier check sees a consequence, without their name."""

FOUND_BEFORE = {
    "friction-across": "slide",
    "attachments-drift": "cloth-reset",
    "attachment-depth": "cloth-held",
}
"""Faults of which an earlier check fails; it names them, or the simpler checks that run after it do."""


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_the_first_failure_of_a_mutant_names_its_fault(name):
    fault = FAULTS[name]
    result = first_failure(Mutant(MUJOCO, fault))
    earlier = CONSEQUENCES | FOUND_BEFORE
    assert result.check == earlier.get(name, fault.caught_by)
    assert (fault.says in result.diagnosis) == (name not in CONSEQUENCES)
