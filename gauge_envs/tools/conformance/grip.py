"""Friction below and above its limit: bodies that are pushed, pressed and laden, and objects between two pads."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gauge_envs.fixtures.grasp import OBJECT, from_pads_m, grasp_scene, grasp_wrenches
from gauge_envs.fixtures.parts import box, contact, ground
from gauge_envs.fixtures.recording import Recording
from gauge_envs.scene import GRAVITY_M_PER_S2 as G, Scene
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scoring.estimators import acceleration_m_per_s2
from gauge_envs.tools.conformance.lab import (
    Lab,
    Measurement,
    largest,
    largest_mm,
    ratio,
)
from gauge_envs.tools.conformance.model import Checks, Level, Tolerance

check = Checks(Level.CONTACT)


CUBE_M, CUBE_KG, MU, GLUED = (0.08, 0.08, 0.08), 0.2, 0.5, 1.0
DIRECTION = np.array((0.8, 0.6, 0.0))


class _Push(NamedTuple):
    """A push of a cube on a plane.

    Attributes:
        share: Force along the plane over the limit of friction.
        press: Force down over the weight of the cube.
        weights: Number of cubes of the same mass on it.
    """

    share: float
    press: float = 0.0
    weights: int = 0

    def __str__(self) -> str:
        load = " under a force of 4 times its weight" if self.press else ""
        load += f" under {self.weights} weights" if self.weights else ""
        return f"cube at {self.share:g} of the limit{load}"

    @property
    def normal_n(self) -> float:
        """Normal force on the plane [N]."""
        return CUBE_KG * G * (1.0 + self.press + self.weights)


PRESS = 4.0
PUSHES = [
    [_Push(share) for share in (0.5, 0.9, 0.95, 0.99, 1.01, 1.05)],
    [_Push(share, press=PRESS) for share in (0.95, 0.99, 1.01)],
    [_Push(share, weights=3) for share in (0.95, 1.01)],
]
"""Pushes of each scene; scenes are small, since engines may solve large ones otherwise."""


def _pushed(lab: Lab) -> dict[_Push, FloatArray]:
    """Return displacements of pushed cubes for one second [m], shape [sample_count, 3]."""
    moved: dict[_Push, FloatArray] = {}
    for pushes in PUSHES:
        rollout = _pushed_together(lab, pushes)
        moved |= {push: rollout.displacement(str(push)) for push in pushes}
    return moved


def _pushed_together(lab: Lab, pushes: Sequence[_Push]) -> Recording:
    bodies, piled, wrenches = [ground()], set(), {}
    for at, push in enumerate(pushes):
        names = [str(push), *(f"weight {i} on {push}" for i in range(push.weights))]
        for layer, name in enumerate(names):
            place = (0.0, 0.4 * at, CUBE_M[2] * (layer + 0.5))
            bodies.append(box(name, place, CUBE_M, mass_kg=CUBE_KG))
        piled.update(names[1:] and names)
        force = push.share * MU * push.normal_n * DIRECTION
        force[2] = -push.press * CUBE_KG * G
        wrenches[names[0]] = [*force, 0.0, 0.0, 0.0]
    contacts = [contact(tuple(wrenches), "ground", friction=MU)]
    if piled:
        contacts.append(contact(tuple(piled), tuple(piled), friction=GLUED))
    scene = Scene(bodies=tuple(bodies), contacts=tuple(contacts), duration_s=1.0)
    return lab.rollout(scene, wrenches=wrenches)


@check(
    "push-holds",
    title="friction holds a body that is pushed below the limit",
    law="r = const if F < mu N",
    unit="mm",
    tolerance=Tolerance(
        "real cubes that hold scatter by 0.6 mm; creep must be small beside it",
        absolute=0.1,
    ),
    cause="it creeps since friction is regularized, or its force lags behind the load or the normal force",
    optional=True,
)
def push_holds(lab: Lab) -> Measurement:
    """Cubes on a plane with friction 0.5, pushed with 0.5 to 0.99 of the limit.

    Some stand alone, some bear a force of four times their weight, some three equal cubes.

    Largest displacement along the plane within 1 s.

    Source: Coulomb.
    """
    moved = {
        push: largest_mm(moved_m[:, :2])
        for push, moved_m in lab.once(_pushed).items()
        if push.share < 1.0
    }
    worst = largest({str(push): mm for push, mm in moved.items()}, "mm in 1 s")
    return replace(worst, cause=_cause(moved))


def _cause(moved_mm: dict[_Push, float]) -> str:
    """Return the cause from which cubes slide and which creep; empty for that of the check."""
    # A cube without the pressing force in its limit slides by metres.
    slides = [push for push, mm in moved_mm.items() if mm > 20.0]
    if not slides:
        return ""
    if all(push.press for push in slides):
        return "friction does not follow a force that presses on the body"
    if all(push.weights for push in slides):
        return "friction does not follow the weight of the bodies on it"
    return "its friction is less than that of the pair"


@check(
    "push-slides",
    title="a body that is pushed above the limit starts to slide",
    law="a = (F - mu N) / m",
    tolerance=Tolerance(
        "half the smallest excess of 1 %, so that a body that does not start fails",
        absolute=0.005,
    ),
    cause="a friction of rest above that of sliding, or sleep",
    optional=True,
)
def push_slides(lab: Lab) -> Measurement:
    """The cubes of push-holds, pushed with 1.01 and 1.05 of the limit.

    Friction from the acceleration along the push, quadratic fit over 1 s, over that of the pair; the worst.

    Source: Coulomb; contract (Contact.friction is that of rest and of sliding).
    """
    frictions = {}
    for push, moved_m in lab.once(_pushed).items():
        if push.share < 1.0:
            continue
        times_s = np.linspace(0.0, 1.0, len(moved_m))
        rate = acceleration_m_per_s2(times_s, moved_m @ DIRECTION)
        mass_kg = CUBE_KG * (1 + push.weights)
        frictions[push] = push.share - mass_kg * rate / (MU * push.normal_n)
    measurement = ratio(
        {str(push): frictions[push] for push in frictions}, "the friction"
    )
    stuck = [push for push in frictions if frictions[push] > push.share - 1e-3]
    if not stuck:
        return measurement
    return replace(measurement, hint=f"the {stuck[0]} does not start")


# --- between pads ----------------------------------------------------------------------------------------------------

HELD = {
    # Mass [kg], friction, weight over the limit of both pads, and force up over the weight.
    "0.1 kg, friction 0.4, 0.9 of the limit": (0.1, 0.4, 0.9, 0.0),
    "0.3 kg, friction 0.8, 0.9 of the limit": (0.3, 0.8, 0.9, 0.0),
    "1 kg, friction 0.6, half of the limit": (1.0, 0.6, 0.5, 0.0),
    "1 kg, friction 0.6, 0.9 of the limit, loaded by half its weight as in a lift": (
        1.0,
        0.6,
        0.6,
        -0.5,
    ),
}
HELD_S, SETTLED_S = 0.5, 0.2


@check(
    "grasp",
    title="two pads under a force hold an object",
    law="v = 0 against the pads if W < 2 mu N",
    unit="mm/s",
    tolerance=Tolerance(
        "real cubes that hold scatter by 0.6 mm; a creep of a sixth of it in a second is small beside it",
        absolute=0.1,
    ),
    cause="friction of a grasp is regularized, or its force lags behind the load",
    optional=True,
)
def grasp(lab: Lab) -> Measurement:
    """Objects of 0.1 to 1 kg between two pads on hinged jaws that known torques press; friction 0.4 to 0.8.

    Mean speed of the object against the middle of its pads from 0.2 to 0.5 s, in any direction; the worst of four. The
    contacts of two list the pads first.

    Source: Coulomb. Two driven plates with an overlap would leave the normal force open, so the pads have a force.
    """
    creeps = {}
    for at, (name, (mass_kg, friction, share, lift)) in enumerate(HELD.items()):
        weight_n = mass_kg * G
        held = replace(OBJECT, mass_kg=mass_kg)
        scene = grasp_scene(HELD_S, grasped=held, friction=friction)
        if at % 2:
            # The pads come first.
            (touch,) = scene.contacts
            pads_first = replace(touch, first=touch.second, second=touch.first)
            scene = replace(scene, contacts=(pads_first,))
        wrenches = dict(grasp_wrenches(weight_n / (2.0 * friction * share)))
        wrenches["object"] = np.array([0.0, 0.0, lift * weight_n, 0.0, 0.0, 0.0])
        moved = from_pads_m(lab.rollout(scene, wrenches=wrenches))
        first = round(SETTLED_S / HELD_S * (len(moved) - 1))
        creeps[name] = 1e3 * length_of(moved[-1] - moved[first]) / (HELD_S - SETTLED_S)
    falls = max(creeps.values()) > 0.1e3 * G * HELD_S
    cause = "the pads do not hold it at all" if falls else ""
    return replace(largest(creeps, "mm/s"), cause=cause)
