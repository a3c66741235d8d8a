"""Planted faults: each is caught by a check whose diagnosis names it, and every check can fail."""

import pytest
from mutations import FAULTS, Mutant, first_failure, is_of_the_fault

from gauge_envs.backends import backend
from gauge_envs.tools.conformance import Status, checks, run_checks

MUJOCO = backend("mujoco")

ALSO = """
angular-velocity         quaternion-order      another order inside
angular-velocity         spin-frame            body frame
carry-line               drive-acceleration    drive() gives is ignored
carry-line               teleport              must have a velocity
carry-slip               friction-low          is not the pair's
carry-turn               teleport              must have a velocity
cloth-copy               state-behind          must be picklable
cloth-energy             gains-energy          makes energy
cloth-reset              no-reset              positions and velocities of nodes
cloth-rests              no-contacts           falls through
cloth-restore            restore-velocity      velocities
collision-rebound        restitution-none      is not the pair's
collision-slow           slow-restitution      threshold speed
copy                     state-behind          must be picklable
drop-energy              gains-energy          the engine makes energy
foam-pinned-face         nodes-lag             one interval (1/180 s) late
foam-start               nodes-millimetres     nodes are world positions
free-fall-turn           starts-turning        convention
hold                     friction-none         creeps
inertia-box              quaternion-inside     w, x, y, z was read as x, y, z, w
inertia-sphere           sphere-larger         its radius were 31.5 mm
joint-chain              hinged-inertia        the inertia of the bars
joint-slip               joint-dry-high        friction at rest
joint-stick              joint-dry-viscous     viscous at low speed
oblique-grip-spin        impact-frictionless   the impact has no friction
oblique-slip-friction    impact-frictionless   the impact has no friction
oblique-slip-rebound     restitution-none      slip adds to the rebound
pendulum-energy          hinge-damping         damped
pile-bounds              blast                 makes energy
pile-energy              gains-energy          makes energy
pile-sinks               no-contacts           tunnel
pushed-ball              teleport              without velocity
rebound-0.5              restitution-none      restitution enters
rebound-0.75             restitution-high      restitution
rebound-0.95             restitution-high      restitution
rebound-fast             speed-limited         a limit of speed
reset-course             reset-velocity        does not restore velocities
rest-box                 margin                half sizes
rest-convex              margin                a margin, or its size
rest-cylinder            cylinder-length       its length is half
rest-driven              margin                a margin, or its size
rest-lying-cylinder      cylinder-radius       its radius is half
rest-sphere              margin                a margin, or its size
restore-benchmark-rigid  restore-warm-start    after restore()
restore-benchmark-soft   restore-velocity      after restore()
restore-edge             restore-velocity      after restore()
restore-hinge            restore-velocity      after restore()
restore-rest             restore-warm-start    after restore()
rod-start                lines-turned          z for a rod
roll-cylinder            rolling-friction      rolling friction were
rope-energy              gains-energy          makes energy
rope-length              rope-length           another length
slide-plane              plane-level           that the plane's normal
slide-plane              friction-holds        friction holds the brick
slide-straight           gravity-tilted        turns
solid-spin-centre        centre-elsewhere      centre of mass
spin-momentum            hinge-damping         angular damping
spin-orientation         spin-sign             sign or frame
start-rest               steps-at-build        must not step
start-velocity-reset     reset-start-velocity  at rest after the reset
swing-box                box-inertia           ratio about each body axis
swing-union              centre-elsewhere      centre of mass does not follow
swing-cylinder           cylinder-length       ratio about each body axis
tether-length            no-joints             missing
"""
"""Further checks that see a fault: check, fault, and words of the diagnosis."""
CASES = (
    *((fault.caught_by, name, fault.says) for name, fault in FAULTS.items()),
    *(row.split(maxsplit=2) for row in ALSO.strip().splitlines()),
)
SLOW = ("restore-benchmark-rigid", "restore-benchmark-soft", "foam-tension")


@pytest.mark.parametrize(
    ("check", "name", "says"),
    [
        pytest.param(
            *case,
            marks=[pytest.mark.slow] if case[0] in SLOW else [],
            id=f"{case[0]}-{case[1]}",
        )
        for case in CASES
    ],
)
def test_a_check_names_the_fault_of_a_mutant(check, name, says):
    mutant = Mutant(MUJOCO, FAULTS[name])
    (result,) = run_checks(mutant, only=[check])
    assert result.status is Status.FAIL
    assert is_of_the_fault(mutant, result)
    assert says in result.diagnosis


def test_every_check_can_fail():
    assert {check for check, _, _ in CASES} == {check.id for check in checks()}


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
    "motor-tired": "joint-dry-servo",
    "grasp-points": "grasp-creep",
}
"""Faults of which an earlier check sees a consequence, without their name."""


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS)
def test_the_first_failure_of_a_mutant_names_its_fault(name):
    fault = FAULTS[name]
    result = first_failure(Mutant(MUJOCO, fault))
    assert result.check == CONSEQUENCES.get(name, fault.caught_by)
    assert (fault.says in result.diagnosis) == (name not in CONSEQUENCES)
