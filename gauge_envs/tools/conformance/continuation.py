"""Going back to a state: in flight, at rest, in stacks, on edges, under a wrench, and in copies."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import Simulation
from gauge_envs.envs.driver_paths import DriverPaths
from gauge_envs.errors import BackendError
from gauge_envs.runs.rollout import DeclinedError, states_now
from gauge_envs.scene import Box, Contact, Cylinder, Hinge, Pose, Scene
from gauge_envs.tools.conformance.contract import bounces
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.model import Measurement, Tolerance
from gauge_envs.tools.conformance.registry import check
from gauge_envs.tools.conformance.scene_parts import ball, body, box, fixed_box, ground, strip_on_rod

EXACT = Tolerance(absolute=0.0, rationale="the contract requires equality bit for bit")
CONTINUATION_DIAGNOSIS = (
    "state() must hold copies of velocities, warm starts, contact caches, applied wrenches and all else that the next "
    "step reads. An engine that cannot do it returns its simulation in a ReplayedSimulation"
)

COPY_DIAGNOSIS = "state() must be picklable and hold all that the next step reads, not references into one simulation"


Prepare = Callable[[Simulation], None]
"""What is done to a simulation after a reset, such as applying a wrench."""


def _nothing(_: Simulation) -> None:
    """Do nothing after a reset."""


def continuation_differences(
    lab: Lab, scene: Scene, *, before: int, after: int, prepare: Prepare = _nothing
) -> dict[str, float]:
    """Return the largest difference of any state from an undisturbed run, for each use of a state.

    Args:
        lab: The lab.
        scene: The scene.
        before: Intervals before the state is saved.
        after: Intervals after it that are compared.
        prepare: What is done after each reset.
    """
    names = [one.name for one in scene.bodies]
    paths = DriverPaths(scene, (before + after + 12) / 180.0)

    def run(simulation: Simulation, first: int, count: int) -> NDArray[np.float64]:
        rows = []
        for sample in range(first, first + count):
            paths.advance(simulation, sample)
            nodes = [np.array(simulation.nodes(one.name)).ravel() for one in scene.deformables]
            rows.append(np.concatenate([states_now(simulation, names).ravel(), *nodes]))
        return np.array(rows)

    simulation, other = lab.build(scene), lab.build(scene)
    try:
        for one in (simulation, other):
            one.reset(0)
            prepare(one)
            run(one, 0, before)
        expected = run(other, before, after)
        saved = simulation.state()
        packed = pickle.dumps(saved)
        runs = {"after state()": run(simulation, before, after)}
        run(simulation, before + after, 6)
        for text in ("after restore()", "after a second restore()"):
            simulation.restore(saved)
            runs[text] = run(simulation, before, after)
        other.restore(pickle.loads(packed))
        runs["in a copy from a pickle"] = run(other, before, after)
        return {text: float(np.abs(values - expected).max()) for text, values in runs.items()}
    finally:
        simulation.close()
        other.close()


def continuation_measurement(differences: dict[str, float]) -> Measurement:
    """Return the largest of the differences, with the uses of a state that are wrong."""
    wrong = [f"{text} {value:.3g}" for text, value in differences.items() if value != 0.0]
    return Measurement(
        measured=float(np.max(list(differences.values()))),
        expected=0.0,
        hint=f"difference from a run without state(): {', '.join(wrong)}" if wrong else "",
    )


def _continuation(
    id: str,
    *,
    title: str,
    scene: str,
    build: Callable[[Lab], Scene],
    before: int,
    prepare: Prepare = _nothing,
    diagnosis: str = CONTINUATION_DIAGNOSIS,
) -> None:
    """Register the check that a scene continues bit for bit after restore, in the same simulation and in a copy."""

    @check(
        id,
        title=title,
        scene=scene,
        measures="largest difference of any state or node within 0.1 s after state(), restore(), a second restore() "
        "and restore() in a copy, from a run that saves no state",
        law="same state, same trajectory",
        source="contract (Simulation.state)",
        unit="1",
        tolerance=EXACT,
        diagnosis=diagnosis,
    )
    def measure(lab: Lab) -> Measurement:
        return continuation_measurement(
            continuation_differences(lab, build(lab), before=before, after=18, prepare=prepare)
        )


BOUNCES = (
    "a brick dropped by 0.2 m on a fixed slab, and a ball on a plate that turns by 0.5 rad; "
    "or a ball dropped on a plane"
)

# --- scenes of the checks --------------------------------------------------------------------------------------------


def _stack(_: Lab) -> Scene:
    """Return boxes stacked on a plane, beside a cylinder and a ball at rest."""
    sizes = ((0.1, 0.08, 0.04), (0.08, 0.08, 0.03), (0.06, 0.05, 0.05))
    heights = (0.02, 0.055, 0.095)
    boxes = tuple(
        box(f"box-{index}", (0.004 * index, 0.0, height), size)
        for index, (size, height) in enumerate(zip(sizes, heights, strict=True))
    )
    cylinder = body("cylinder", Cylinder(radius_m=0.03, length_m=0.06), Pose(position_m=(0.3, 0.0, 0.03)))
    names = tuple(one.name for one in boxes)
    contacts = (
        Contact(first=names, second=names, friction=0.4, restitution=0.0),
        Contact(first=(*names, "ball", "cylinder"), second=("ground",), friction=0.4, restitution=0.0),
    )
    return Scene(
        bodies=(*boxes, cylinder, ball("ball", (-0.2, 0.0, 0.03)), ground()), contacts=contacts, duration_s=1.0
    )


def _edge(_: Lab) -> Scene:
    """Return a brick that tips over the edge of a table, and one that leans on a block."""
    overhanging = box("tipping", (0.27, 0.0, 0.52), (0.12, 0.06, 0.04))
    leaning = box("leaning", (-0.125, 0.2, 0.6), (0.02, 0.06, 0.18), euler_deg=(0.0, 25.0, 0.0))
    table = fixed_box("table", (0.0, 0.0, 0.25), (0.5, 0.6, 0.5))
    block = fixed_box("block", (-0.05, 0.2, 0.56), (0.04, 0.1, 0.12))
    contacts = (Contact(first=("tipping", "leaning"), second=("table", "block"), friction=0.5, restitution=0.0),)
    return Scene(bodies=(overhanging, leaning, table, block), contacts=contacts, duration_s=1.0)


def _swing(_: Lab) -> Scene:
    """Return a box that swings on a hinge."""
    hinge = Hinge(body="bob", anchor_m=(0.0, 0.0, 1.0), axis=(0.0, 1.0, 0.0))
    return Scene(bodies=(box("bob", (0.15, 0.0, 0.95), (0.1, 0.06, 0.03)),), joints=(hinge,), duration_s=1.0)


def _floating(_: Lab) -> Scene:
    """Return a floating box."""
    brick = body("brick", Box(size_m=(0.1, 0.06, 0.03)), Pose(position_m=(0.0, 0.0, 1.0)))
    return Scene(bodies=(brick,), duration_s=1.0, gravity_m_per_s2=0.0)


def _push(simulation: Simulation) -> None:
    """Apply a force and a torque to the floating box."""
    try:
        simulation.apply_wrench("brick", np.array([0.1, 0.02, 0.0, 1e-4, 2e-4, 0.0]))
    except BackendError as error:
        raise DeclinedError((str(error),)) from error


_continuation(
    "restore",
    title="restore continues bit for bit",
    scene=BOUNCES + "; the state is saved in flight",
    build=bounces,
    before=18,
)
_continuation(
    "restore-impact",
    title="restore continues after an impact",
    scene="the same scene; the state is saved after the first impact",
    build=bounces,
    before=45,
)
_continuation(
    "restore-rest",
    title="restore continues at rest",
    scene="three stacked boxes, a cylinder and a ball at rest on a plane; the state is saved after 0.4 s",
    build=_stack,
    before=72,
)
_continuation(
    "restore-edge",
    title="restore continues on edges",
    scene="a brick that tips over the edge of a table, and one that leans on a block; the state is saved after 0.1 s",
    build=_edge,
    before=18,
)
_continuation(
    "restore-hinge",
    title="restore continues on a hinge",
    scene="a box that swings on a hinge; the state is saved after 0.2 s",
    build=_swing,
    before=36,
)
_continuation(
    "restore-wrench",
    title="restore continues under a wrench",
    scene="a floating box under a constant force and torque; the state is saved after 0.1 s",
    build=_floating,
    before=18,
    prepare=_push,
    diagnosis="an applied wrench is part of state(): restore() must set it again",
)
_continuation(
    "cloth-restore",
    title="cloth: restore continues bit for bit",
    scene="a strip of cloth that hangs from a driven rod, which moves by 0.2 m and turns by 0.6 rad",
    build=lambda _: strip_on_rod(),
    before=18,
    diagnosis="state() must hold copies of the nodes' velocities and all else that the next step reads",
)

# --- copies ----------------------------------------------------------------------------------------------------------


def _copy_check(id: str, title: str, scene: str, build: Callable[[Lab], Scene]) -> None:
    """Register the check that a new simulation continues from a pickled state."""

    @check(
        id,
        title=title,
        scene=scene,
        measures="largest difference of any state or node 0.1 s after a state between a simulation and a copy restored "
        "from a pickle",
        law="same state, same trajectory",
        source="contract (Simulation.state)",
        unit="1",
        tolerance=EXACT,
        diagnosis=COPY_DIAGNOSIS,
    )
    def measure(lab: Lab) -> Measurement:
        differences = continuation_differences(lab, build(lab), before=18, after=18)
        return Measurement(measured=differences["in a copy from a pickle"], expected=0.0)


_copy_check(
    "copy",
    "a copy continues bit for bit",
    BOUNCES,
    bounces,
)
_copy_check(
    "cloth-copy",
    "cloth: a copy continues bit for bit",
    "a strip of cloth that hangs from a driven rod, which moves by 0.2 m and turns by 0.6 rad",
    lambda _: strip_on_rod(),
)
