"""Which pairs of bodies collide."""

from __future__ import annotations

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import GRAVITY_M_PER_S2 as G
from gauge_envs.scene import Scene
from gauge_envs.tools.conformance.lab import Lab, recorded
from gauge_envs.tools.conformance.measurements import acceleration_m_per_s2
from gauge_envs.tools.conformance.model import Measurement, Tolerance
from gauge_envs.tools.conformance.scene_parts import ball, contact, ground


@recorded("three balls of radius 30 mm over a plane; only one of them has a contact with it")
def _pairs(lab: Lab) -> Rollout:
    """Record three balls over a plane: one has a contact with the plane, the other two have none."""
    places = {"listed": (-0.1, 0.0, 0.03), "unlisted": (0.1, 0.0, 0.03), "upper": (-0.1, 0.0, 0.2)}
    balls = [ball(name, place) for name, place in places.items()]
    contacts = (contact("listed", "ground", friction=0.5),)
    return lab.rollout(Scene(bodies=(*balls, ground()), contacts=contacts, duration_s=0.5))


@_pairs.check(
    "contact-unlisted",
    title="bodies without a listed contact pass through each other",
    measures="smaller acceleration of two balls that fall through bodies with which they have no contact, quadratic "
    "fit over 0.5 s",
    law="a = g",
    source="contract (scene.Contact)",
    unit="m/s^2",
    tolerance=Tolerance(relative=0.01, rationale="it is a free fall; any contact force is visible"),
    diagnosis="the collision filter of the engine lets bodies collide that have no contact in the scene; where "
    "free-fall fails too, it is the fall itself",
)
def _contact_unlisted(rollout: Rollout) -> Measurement:
    # A fit, since after 0.5 s a semi-implicit step of 1/180 s has fallen by 1.1 % more than the law.
    falls = {
        name: -acceleration_m_per_s2(rollout.times_s, rollout.position(name)[:, 2]) for name in ("unlisted", "upper")
    }
    slow = min(falls, key=lambda name: falls[name])
    what = {"unlisted": "the plane", "upper": "the plane or the other ball"}[slow]
    hint = f"ball {slow!r} is held by {what}" if falls[slow] < 0.9 * G else ""
    return Measurement(measured=falls[slow], expected=G, hint=hint)


@_pairs.check(
    "contact-listed",
    title="bodies with a listed contact hold each other",
    measures="height of a ball's lowest point above the plane, 0.5 s after it was placed there",
    law="height = 0",
    source="contract (scene.Contact)",
    unit="mm",
    tolerance=Tolerance(absolute=0.5, rationale="the real trials' scatter is about 1 mm"),
    diagnosis="the pair does not collide, or the contact is so soft that a body of 0.1 kg sinks in",
)
def _contact_listed(rollout: Rollout) -> Measurement:
    height_mm = 1e3 * float(rollout.position("listed")[-1, 2] - 0.03)
    hint = ""
    if height_mm > 0.0:
        hint = "it floats on a margin or contact offset of the engine, or its radius is too large"
    elif height_mm < -100.0:
        hint = "the ball falls through the plane"
    return Measurement(measured=height_mm, hint=hint)
