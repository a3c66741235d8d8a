"""Going back to a state: in flight, at rest, in stacks, on edges, under a wrench, and in copies."""

import pickle
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from gauge_envs.backends import Simulation
from gauge_envs.envs.driver_paths import DriverPaths
from gauge_envs.envs.recording import states_now
from gauge_envs.scene import Box, Cylinder, Hinge, Pose, Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.bench.parts import ball, body, box, contact, fixed_box, ground
from gauge_envs.tools.conformance.contract import BOUNCES, bounces, one_sign
from gauge_envs.tools.conformance.lab import STRIP_ON_ROD, Lab, push, strip_on_rod
from gauge_envs.tools.conformance.model import REBUILT, Check, Measurement
from gauge_envs.tools.conformance.touch import half_fixed

CONTINUATION = Check(
    "",
    measures="largest difference of any state or node within 0.1 s after state(), restore(), a second restore() "
    "and restore() in a copy, from a run that saves no state",
    law="same state, same trajectory",
    source="contract (Simulation.state)",
    tolerance=REBUILT,
    diagnosis="state() must hold copies of velocities, warm starts, contact caches, applied wrenches and all else that "
    "the next step reads, and be picklable. An engine that cannot do it returns its simulation in a ReplayedSimulation",
)
"""What the checks of this kind have in common."""


def continuation_differences(
    lab: Lab,
    scene: Scene,
    *,
    before: int,
    prepare: Callable[[Simulation], None] | None = None,
    disturb: Callable[[Simulation], None] | None = None,
) -> dict[str, float]:
    """Return the largest difference of any state from an undisturbed run within 0.1 s, for each use of a state.

    Args:
        lab: The lab.
        scene: The scene.
        before: Intervals before the state is saved.
        prepare: What is done after each reset, such as applying a wrench.
        disturb: What is done before each return to the state, and should have no effect after it.
    """
    after = 18
    names = [one.name for one in scene.bodies]
    paths = DriverPaths(scene, (before + after + 12) / 180.0)

    def run(simulation: Simulation, first: int, count: int) -> FloatArray:
        rows = []
        for sample in range(first, first + count):
            paths.advance(simulation, sample)
            nodes = [
                np.array(simulation.nodes(one.name)).ravel()
                for one in scene.deformables
            ]
            states = one_sign(states_now(simulation, names))
            rows.append(np.concatenate([states.ravel(), *nodes]))
        return np.array(rows)

    with closing(lab.build(scene)) as simulation, closing(lab.build(scene)) as other:
        for one in (simulation, other):
            one.reset(0)
            if prepare is not None:
                prepare(one)
            run(one, 0, before)
        expected = run(other, before, after)
        saved = simulation.state()
        packed = pickle.dumps(saved)
        runs = {"after state()": run(simulation, before, after)}
        run(simulation, before + after, 6)
        for text in ("after restore()", "after a second restore()"):
            if disturb is not None:
                disturb(simulation)
            simulation.restore(saved)
            runs[text] = run(simulation, before, after)
        if disturb is not None:
            disturb(other)
        other.restore(pickle.loads(packed))
        runs["in a copy from a pickle"] = run(other, before, after)
        return {
            text: float(np.abs(values - expected).max())
            for text, values in runs.items()
        }


def continuation_measurement(differences: dict[str, float]) -> Measurement:
    """Return the largest of the differences, with the uses of a state that are wrong."""
    wrong = [
        f"{text} {value:.3g}" for text, value in differences.items() if value != 0.0
    ]
    return Measurement(
        measured=float(np.max(list(differences.values()))),
        hint=f"difference from a run without state(): {', '.join(wrong)}"
        if wrong
        else "",
    )


def _continuation(
    id: str,
    *,
    build: Callable[[Lab], Scene],
    before: int = 18,
    prepare: Callable[[Simulation], None] | None = None,
    disturb: Callable[[Simulation], None] | None = None,
    **texts: Any,
) -> None:
    """Register the check that a scene continues bit for bit from a state, saved after some intervals."""

    @replace(CONTINUATION, id=id, **texts)
    def measure(lab: Lab) -> Measurement:
        differences = continuation_differences(
            lab, build(lab), before=before, prepare=prepare, disturb=disturb
        )
        return continuation_measurement(differences)


# --- scenes of the checks --------------------------------------------------------------------------------------------


def _stack(_: Lab) -> Scene:
    """Return boxes stacked on a plane, beside a cylinder and a ball at rest."""
    sizes = ((0.1, 0.08, 0.04), (0.08, 0.08, 0.03), (0.06, 0.05, 0.05))
    heights = (0.02, 0.055, 0.095)
    boxes = tuple(
        box(f"box-{index}", (0.004 * index, 0.0, height), size)
        for index, (size, height) in enumerate(zip(sizes, heights, strict=True))
    )
    cylinder = body(
        "cylinder",
        Cylinder(radius_m=0.03, length_m=0.06),
        Pose(position_m=(0.3, 0.0, 0.03)),
    )
    names = tuple(one.name for one in boxes)
    contacts = (
        contact(names, names, friction=0.4),
        contact((*names, "ball", "cylinder"), "ground", friction=0.4),
    )
    return Scene(
        bodies=(*boxes, cylinder, ball("ball", (-0.2, 0.0, 0.03)), ground()),
        contacts=contacts,
        duration_s=1.0,
    )


def _edge(_: Lab) -> Scene:
    """Return a brick that tips over the edge of a table, one that leans on a block, and one that swings on a hinge."""
    overhanging = box("tipping", (0.27, 0.0, 0.52), (0.12, 0.06, 0.04))
    leaning = box(
        "leaning", (-0.125, 0.2, 0.6), (0.02, 0.06, 0.18), euler_deg=(0.0, 25.0, 0.0)
    )
    table = fixed_box("table", (0.0, 0.0, 0.25), (0.5, 0.6, 0.5))
    block = fixed_box("block", (-0.05, 0.2, 0.56), (0.04, 0.1, 0.12))
    swinging = box("swinging", (0.15, 0.0, 1.95), (0.1, 0.06, 0.03))
    hinge = Hinge(body="swinging", anchor_m=(0.0, 0.0, 2.0), axis=(0.0, 1.0, 0.0))
    contacts = (contact(("tipping", "leaning"), ("table", "block"), friction=0.5),)
    return Scene(
        bodies=(overhanging, leaning, table, block, swinging),
        contacts=contacts,
        joints=(hinge,),
        duration_s=1.0,
    )


def _half_fixed(_: Lab, *, kind: str) -> Scene:
    """Return a body of a kind that is held at one side."""
    return half_fixed(kind)


def _floating(_: Lab) -> Scene:
    """Return a floating box."""
    brick = body(
        "brick", Box(size_m=(0.1, 0.06, 0.03)), Pose(position_m=(0.0, 0.0, 1.0))
    )
    return Scene(bodies=(brick,), duration_s=1.0, gravity_m_per_s2=0.0)


def _pushed(simulation: Simulation, factor: float = 1.0) -> None:
    """Apply a force and a torque to the floating box."""
    push(simulation, "brick", factor * np.array([0.1, 0.02, 0.0, 1e-4, 2e-4, 0.0]))


_continuation(
    "restore",
    title="restore continues bit for bit",
    scene=BOUNCES + "; the state is saved in flight",
    build=bounces,
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
    scene="three stacked boxes, a cylinder and a ball at rest on a plane; the state is saved after 0.1 s",
    build=_stack,
    before=18,
)
_continuation(
    "restore-edge",
    title="restore continues on edges and on a hinge",
    scene="a brick that tips over the edge of a table, one that leans on a block, and one that swings on a hinge; the "
    "state is saved after 0.1 s",
    build=_edge,
)
_continuation(
    "restore-wrench",
    title="restore continues under a wrench",
    scene="a floating box under a constant force and torque; the state is saved after 0.1 s, and restored under others",
    build=_floating,
    prepare=_pushed,
    disturb=lambda simulation: _pushed(simulation, -2.0),
    diagnosis="an applied wrench is part of state(): restore() must set it again",
)
_continuation(
    "cloth-restore",
    title="cloth: restore continues bit for bit",
    scene=STRIP_ON_ROD,
    build=lambda _: strip_on_rod(),
    diagnosis="state() must hold copies of the nodes' velocities and all else that the next step reads",
)

for _kind in ("foam", "rope"):
    _continuation(
        f"{_kind}-restore",
        title=f"{_kind}: restore continues bit for bit",
        scene=f"a body of {_kind} that is held at one side and released",
        build=partial(_half_fixed, kind=_kind),
        diagnosis="state() must hold copies of the nodes' velocities and all else that the next step reads",
    )
