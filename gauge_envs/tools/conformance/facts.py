"""Say what the record of a failed check shows for certain: starts, driven motion, hinges and gravity.

Each is compared with the scene where no contact or force has a part, so that it needs no hypothesis.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scoring.estimators import acceleration_m_per_s2
from gauge_envs.tools.bench.recording import Recording
from gauge_envs.tools.conformance.torques import wrong_torques

FAR_MM, FAR_DEG = 0.5, 0.5
"""Distances and angles from which on they are facts."""
LEAST_DRIVE = 5e-5
"""Distance [m] or angle [rad] from where it is driven from which on the motion of a driven body shows its cause."""
LEAST_TURN_RAD = 0.05
"""Rotation from which on a hinge shows its anchor."""


def facts(rollout: Recording) -> str:
    """Return what is otherwise than the scene states, the first of a kind; empty where nothing is."""
    found = [next(kind(rollout), "") for kind in (_starts, _driven, _hinges, _gravity)]
    # Where the parts are otherwise, torques are.
    told = list(filter(None, found)) or list(islice(wrong_torques(rollout), 1))
    return "; ".join(told)


def _starts(rollout: Recording) -> Iterator[str]:
    for body in rollout.scene.bodies:
        off_mm = 1e3 * (rollout.position(body.name)[0] - body.pose.position_m)
        turned = rollout.rotation(body.name)[0] * body.pose.rotation.inv()
        turned_deg = np.degrees(turned.magnitude())
        if np.linalg.norm(off_mm) > FAR_MM:
            yield f"the position of the {body.name} at the start is off by {_vector(off_mm)} mm"
        if turned_deg > FAR_DEG:
            yield f"the orientation of the {body.name} at the start is off by {turned_deg:.3g} degrees"
    scene = rollout.scene
    # What hangs on a hinge that is off starts as the hinge lets it.
    joined = {one.body for one in scene.joints}
    for body in scene.dynamic_bodies:
        if body.name in joined:
            continue
        start = rollout.states[body.name][0]
        for what, found, stated, unit in (
            ("velocity", start[7:10], body.linear_velocity_m_per_s, "m/s"),
            ("angular velocity", start[10:], body.angular_velocity_rad_per_s, "rad/s"),
        ):
            asked = np.array(stated)
            if np.linalg.norm(found - asked) > 1e-3 + 5e-3 * np.linalg.norm(asked):
                yield (
                    f"the {what} of the {body.name} at the start is {_vector(found)} {unit} instead of "
                    f"{_vector(asked)}"
                )


def _driven(rollout: Recording) -> Iterator[str]:
    for driver in rollout.scene.drivers:
        name = driver.body
        asked = driver.path(rollout.scene.body(name).pose, rollout.times_s)
        off_mm = 1e3 * np.linalg.norm(rollout.position(name) - asked[:, :3], axis=1)
        turns = Rotation.from_quat(asked[:, 3:7], scalar_first=True)
        off_deg = np.degrees((rollout.rotation(name) * turns.inv()).magnitude())
        for off, least, what in (
            (off_mm, FAR_MM, "position {:.3g} mm"),
            (off_deg, FAR_DEG, "orientation {:.3g} degrees"),
        ):
            # What grows may be a velocity or an acceleration that is ignored.
            if off[1:].min() > max(least, 0.7 * off.max()):
                text = what.format(off.max())
                yield f"the driven {name} has a {text} from where it is driven at all times"
        law = np.hstack([_course(asked[:, :3], turns), asked[:, 7:13]])
        found = _course(rollout.position(name), rollout.rotation(name))
        if cause := _wrong_drive(found, law, rollout.interval_s):
            yield f"the driven {name} {cause}"


def _course(places_m: FloatArray, rotations: Rotation) -> FloatArray:
    """Return places [m] and rotations from the start [rad], shape [T, 6]."""
    return np.hstack([places_m, (rotations * rotations[0].inv()).as_rotvec()])


def _wrong_drive(found: FloatArray, law: FloatArray, interval_s: float) -> str:
    """Return what alone explains how a driven body moves; empty where it moves as driven, or nothing known does.

    Args:
        found: Course of the body, shape [T, 6].
        law: Course that is driven, and its rates, shape [T, 12].
        interval_s: Time between samples [s].
    """
    asked, steps = law[:, :6], interval_s * law[:-1, 6:]
    off = found - asked
    apart = np.abs(off).max(axis=1)
    size = float(apart.max())
    gains = np.diff(asked, axis=0) - steps
    if size < max(LEAST_DRIVE, 0.5 * np.abs(gains).max()):
        return ""
    for lag in range(1, len(asked) - 1):
        late = asked[np.maximum(np.arange(len(asked)) - lag, 0)]
        if np.abs(found - late).max() < 0.1 * size:
            without = ", or drive() moves it without velocity" if lag == 1 else ""
            return f"comes {lag * interval_s:.3g} s late{without}"
    # An interval starts where the body is driven, and ends by the velocity and the acceleration that drive() gives.
    for what, parts in (
        ("displacement", asked[1:] - asked[0]),
        ("velocity that drive() gives", steps),
        ("acceleration that drive() gives", gains),
    ):
        share = float((off[1:] * parts).sum() / max(np.square(parts).sum(), 1e-12))
        if np.abs(off[1:] - share * parts).max() < 0.1 * size:
            return f"moves as if the {what} were {1.0 + share:.3g} times what it is"
        if np.abs(off[2:] + np.diff(parts, axis=0)).max() < 0.1 * size:
            return f"moves as if the {what} were that of the interval before"
    wrong = interval_s * np.flatnonzero(apart > 0.1 * size)
    # Each interval starts anew, so that what is further off than one interval moves is a place.
    if size < 2.0 * np.abs(steps).max() or apart[-1] > 0.1 * size:
        return ""
    return f"is elsewhere from {wrong[0]:.3g} to {wrong[-1]:.3g} s alone, by up to {1e3 * size:.3g} mm"


def _hinges(rollout: Recording) -> Iterator[str]:
    scene = rollout.scene
    for name, hinge in scene.hinges.items():
        axis = np.array(hinge.axis)
        anchor_m = np.array(hinge.anchor_m)
        places_m, turns = rollout.position(name), rollout.rotation(name)
        angles = (turns * turns[0].inv()).as_rotvec()
        largest = int(np.linalg.norm(angles, axis=1).argmax())
        angle = length_of(angles[largest])
        if angle < LEAST_TURN_RAD:
            continue
        off_deg = _between_deg(angles[largest], axis)
        if off_deg > FAR_DEG:
            yield f"the {name} turns about an axis {off_deg:.3g} degrees from the axis of its hinge"
        local_m = scene.body(name).pose.to_body(np.array(hinge.anchor_m))
        off_m, left_m = _pivot(places_m, turns, local_m, anchor_m)
        across_mm = 1e3 * (off_m - (off_m @ axis) * axis)
        size_mm = length_of(across_mm)
        if size_mm > FAR_MM and 1e3 * left_m < 0.1 * size_mm:
            yield (
                f"the {name} turns about a point {size_mm:.3g} mm from the anchor of its hinge, off by "
                f"{_vector(across_mm)} mm"
            )
            continue
        left_mm = 1e3 * (places_m + turns.apply(local_m) - anchor_m)
        away_mm = np.linalg.norm(left_mm, axis=1)
        if away_mm.max() > FAR_MM:
            steps_mm = np.linalg.norm(np.diff(left_mm, axis=0), axis=1)
            at_once = steps_mm.max() > 0.5 * away_mm.max()
            how = (
                "at once: the anchor moves" if at_once else "slowly: the joint is soft"
            )
            yield f"the {name} leaves the anchor of its hinge by {away_mm.max():.3g} mm, {how}"


def _between_deg(first: FloatArray, second: FloatArray) -> float:
    """Return the angle between two lines [degrees]."""
    lengths = np.linalg.norm(first) * np.linalg.norm(second)
    return float(np.degrees(np.arccos(min(float(abs(first @ second) / lengths), 1.0))))


def _pivot(
    places_m: FloatArray, rotations: Rotation, local_m: FloatArray, anchor_m: FloatArray
) -> tuple[FloatArray, float]:
    """Return how far the point about which a body turns is from an anchor [m], shape [3], and what it moves [m].

    Args:
        places_m: Places of the body, shape [T, 3].
        rotations: Its rotations, T of them.
        local_m: The anchor in the body, shape [3].
        anchor_m: The anchor, shape [3].
    """
    turns = rotations.as_matrix()
    moved = places_m + turns @ local_m - anchor_m
    # turn @ (local + change) + position = anchor + off, for all samples.
    columns = np.hstack([turns.reshape(-1, 3), np.tile(-np.eye(3), (len(turns), 1))])
    solution = np.linalg.lstsq(columns, -moved.ravel(), rcond=1e-6)[0]
    left_m = np.abs(columns @ solution + moved.ravel()).max()
    return solution[3:], float(left_m)


def _gravity(rollout: Recording) -> Iterator[str]:
    scene = rollout.scene
    bound = scene.contacts or scene.joints or scene.attachments
    if bound or not scene.gravity_m_per_s2:
        return
    shares = [
        -acceleration_m_per_s2(rollout.times_s, rollout.position(one.name)[:, 2])
        / scene.gravity_m_per_s2
        for one in scene.dynamic_bodies
    ]
    if shares and np.ptp(shares) < 0.01 and abs(shares[0] - 1.0) > 0.005:
        yield f"all bodies fall with {shares[0]:.4g} times the gravity of the scene"


def _vector(values: FloatArray) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in values) + ")"
