"""Closed forms: rigid motions until an event (a flight to a contact, a slide, a ride on a cloth), and a bar of foam."""

import math
from dataclasses import dataclass

import numpy as np

from gauge_envs.errors import ShapeError
from gauge_envs.observables.functions import face_areas_mm2
from gauge_envs.references.bands import Band
from gauge_envs.references.published import (
    AnyUncontactedLaw,
    ChainLaw,
    FlightLaw,
    PulledLaw,
    SwingLaw,
    UniaxialLaw,
    published_baselines,
    uniaxial_band,
)
from gauge_envs.scene import Box, Cloth, Plane, RigidBody, Scene, SoftBody
from gauge_envs.scene.contact_faces import TOUCHING_M
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.scene.timing import FRAME_RATE_HZ


@dataclass(frozen=True)
class Straight:
    """Motion from rest along a line with constant acceleration.

    Attributes:
        start_m: Position at frame 0 [m], shape [3].
        direction: Unit vector of the motion, shape [3].
        acceleration_m_per_s2: Acceleration [m/s^2].
        distance_m: Distance at which the motion ends [m]; infinity if nothing ends it.
    """

    start_m: FloatArray
    direction: FloatArray
    acceleration_m_per_s2: float
    distance_m: float

    @property
    def end_s(self) -> float:
        """Time at which the motion ends [s]."""
        return math.sqrt(2.0 * self.distance_m / self.acceleration_m_per_s2)

    def positions_mm(self, frame_count: int) -> FloatArray:
        """Return the positions at 30 Hz [mm], shape [frame_count, 3], NaN from the end of the motion on."""
        times_s = np.arange(frame_count) / FRAME_RATE_HZ
        travel_m = 0.5 * self.acceleration_m_per_s2 * np.square(times_s)
        positions = 1e3 * (self.start_m + travel_m[:, None] * self.direction)
        positions[times_s >= self.end_s] = np.nan
        return positions


def law_motion(
    law: AnyUncontactedLaw, scene: Scene, *, variant: str, frame_count: int
) -> tuple[FloatArray, FloatArray | None]:
    """Return the motion that a law gives a body, and what is uncertain of it beside the measurement.

    Returns:
        Positions [mm], shape [frame_count, 3], NaN where the law has ended; and their standard uncertainty [mm], same
        shape, or None for a law that states none.
    """
    if isinstance(law, SwingLaw):
        from gauge_envs.scoring.pendulum_laws import swing_motion

        return swing_motion(law, scene, frame_count)
    if isinstance(law, ChainLaw):
        from gauge_envs.scoring.pendulum_laws import chain_motion

        return chain_motion(
            law, scene, frame_count, published_baselines(variant)["mte"]
        )
    if isinstance(law, PulledLaw):
        return pulled(law, scene, frame_count)
    motion = (
        free_flight(scene, law.body)
        if isinstance(law, FlightLaw)
        else slide(scene, law.body, law.support)
    )
    return motion.positions_mm(frame_count), None


def free_flight(scene: Scene, body: str) -> Straight:
    """Return the free fall of a body from rest until it first touches another one.

    It falls without rotation, because nothing acts on it but gravity.

    Args:
        scene: The scene.
        body: Name of the body.
    """
    falling = scene.body(body)
    down = np.array([0.0, 0.0, -1.0])
    others = [other for other in scene.bodies if other.name != body]
    distance = min(distance_to_contact_m(falling, other, down) for other in others)
    if distance <= TOUCHING_M:
        raise ShapeError(
            f"{body} touches another body at the start: free flight has no frame. Use another law."
        )
    return Straight(
        np.array(falling.pose.position_m), down, scene.gravity_m_per_s2, distance
    )


def slide(scene: Scene, body: str, support: str) -> Straight:
    """Return the Coulomb slide of a body from rest, down the face of a fixed one, until it tips over the face's edge.

    The contact force acts where its line passes through the centroid. Friction shifts that point down the slope by mu
    times the height of the centroid above the face. The body tips when the point leaves the face.

    Args:
        scene: The scene; both bodies are convex, and the origin of the sliding one is its centroid.
        body: Name of the sliding body.
        support: Name of the body on which it slides.
    """
    from scipy.spatial import ConvexHull

    sliding, fixed = scene.body(body), scene.body(support)
    facets = np.unique(ConvexHull(_corners_m(fixed)).equations.round(9), axis=0)
    gaps = (_corners_m(sliding) @ facets[:, :3].T + facets[:, 3]).min(axis=0)
    face = int(np.argmax(gaps))
    if abs(gaps[face]) > TOUCHING_M:
        raise ShapeError(
            f"{body} is {1e3 * gaps[face]:.3f} mm away from {support}: it does not slide on it"
        )
    normal = facets[face, :3]
    downhill = np.array([0.0, 0.0, -1.0]) + normal[2] * normal
    sine = length_of(downhill)
    friction = _friction_of_pair(scene, body, support)
    acceleration = scene.gravity_m_per_s2 * (sine - friction * float(normal[2]))
    if sine == 0.0 or acceleration <= 0.0:
        raise ShapeError(
            f"friction {friction:.4g} holds {body} on {support}: it does not slide"
        )
    direction = downhill / sine
    start = np.array(sliding.pose.position_m)
    height = float(start @ normal + facets[face, 3])
    pressure = start - height * normal + friction * height * direction
    # Distance to each plane that bounds the support, along the slope.
    rates = facets[:, :3] @ direction
    ahead = rates > 1e-6
    to_edge = -(facets[ahead, :3] @ pressure + facets[ahead, 3]) / rates[ahead]
    if to_edge.min() <= 0.0:
        raise ShapeError(
            f"the force on {body} does not pass through {support}: it tips at once"
        )
    others = [other for other in scene.bodies if other.name not in (body, support)]
    free = [distance_to_contact_m(sliding, other, direction) for other in others]
    return Straight(start, direction, acceleration, float(min(*to_edge, *free)))


def pulled(
    law: PulledLaw, scene: Scene, frame_count: int
) -> tuple[FloatArray, FloatArray]:
    """Return the motion of a body on a cloth that is pulled off a table, and its uncertainty.

    The body moves as the puller does. Left out is how the cloth deforms. Between puller and table it hangs as a
    catenary at the tension of its friction on the table, which draws the body on; the stretch at that tension, and the
    slip until friction has brought the body to the speed of the pull, hold it back.

    Args:
        law: The law.
        scene: The scene; the puller moves along a straight line, level with the table.
        frame_count: Number of frames.

    Returns:
        Positions [mm], shape [frame_count, 3]; and their standard uncertainty [mm] along the pull, same shape.
    """
    body = scene.body(law.body)
    puller = scene.body(law.carrier)
    table = scene.body(law.table)
    cloth = next(one for one in scene.deformables if one.name == law.cloth)
    (driver,) = (one for one in scene.drivers if one.body == law.carrier)
    if not isinstance(cloth, Cloth) or not isinstance(table.shape, Box):
        raise ShapeError(
            f"{law.cloth} is no cloth, or {law.table} no box: the law needs a cloth on a box"
        )
    gravity = scene.gravity_m_per_s2
    length_m, width_m = cloth.size_m
    body_friction = _friction_of_pair(scene, law.body, law.cloth)
    table_friction = _friction_of_pair(scene, law.table, law.cloth)

    # The puller's path.
    times_s = np.arange(frame_count) / FRAME_RATE_HZ
    puller_start_m = np.array(puller.pose.position_m)
    body_start_m = np.array(body.pose.position_m)
    moved_m = driver.path(puller.pose, times_s)[:, :3] - puller_start_m
    along = moved_m[-1] / np.linalg.norm(moved_m[-1])
    middle_twist = driver.state(puller.pose, 0.5 * times_s[-1])[1]
    speed_m_per_s = length_of(middle_twist[:3])

    # Tension per width of the cloth at the table's edge: friction of what still lies on the table, T = mu g m / width.
    edge_m = float((table.pose.to_world(table.shape.corners_m) @ along).max())
    span_m = np.maximum((puller_start_m + moved_m) @ along - edge_m, 1e-9)
    lying_kg = cloth.mass_kg * np.clip(1.0 - span_m / length_m, 0.0, 1.0)
    tension_n_per_m = table_friction * gravity * (lying_kg + body.mass_kg) / width_m

    # Catenary: with c = T / (weight per area), an arc over a span s has the length 2 c sinh(s / (2 c)).
    catenary_m = tension_n_per_m * length_m * width_m / (cloth.mass_kg * gravity)
    sag_m = 2.0 * catenary_m * np.sinh(0.5 * span_m / catenary_m) - span_m

    # Hooke: the cloth between puller and body stretches by T / K of its length.
    apart_m = float((puller_start_m - body_start_m) @ along)
    stretch_m = tension_n_per_m / cloth.stretch_stiffness_n_per_m * apart_m

    # Coulomb: friction brings the body to the speed v of the cloth within the slip v^2 / (2 mu g).
    slip_m = np.minimum(
        speed_m_per_s * times_s, 0.5 * speed_m_per_s**2 / (body_friction * gravity)
    )

    drive_m = 1e-3 * law.speed_sigma_mm_per_s * times_s
    uncertainty_m = np.sqrt(sag_m**2 + stretch_m**2 + slip_m**2 + drive_m**2)
    positions_mm = 1e3 * (body_start_m + moved_m)
    return positions_mm, 1e3 * np.abs(uncertainty_m[:, None] * along)


def _friction_of_pair(scene: Scene, first: str, second: str) -> float:
    """Return the friction of the contact between two bodies."""
    return next(
        contact.friction
        for contact in scene.contacts
        if {first, second} in [set(pair) for pair in scene.colliding_pairs(contact)]
    )


def distance_to_contact_m(
    moving: RigidBody, other: RigidBody, direction: FloatArray
) -> float:
    """Return how far a body can move along a direction before it touches another one [m]; infinity if it never does.

    The bodies are unions of convex pieces. For each pair of pieces a linear program finds the shortest distance after
    which they share a point.

    Args:
        moving: The body that moves.
        other: The body that does not, a plane among others.
        direction: Unit vector, shape [3].
    """
    if isinstance(other.shape, Plane):
        normal = other.pose.rotation.apply([0.0, 0.0, 1.0])
        rate = -float(normal @ direction)
        lowest = float(
            ((_corners_m(moving) - np.array(other.pose.position_m)) @ normal).min()
        )
        return lowest / rate if rate > 0.0 else math.inf
    return min(
        _piece_distance_m(piece, obstacle, direction)
        for piece in _pieces_m(moving)
        for obstacle in _pieces_m(other)
    )


def _piece_distance_m(
    piece: FloatArray, obstacle: FloatArray, direction: FloatArray
) -> float:
    """Return the least d >= 0 for which a point of one hull, moved by d, is a point of the other; infinity without."""
    from scipy.optimize import linprog

    count, other_count = len(piece), len(obstacle)
    points = np.concatenate([piece.T, -obstacle.T, direction[:, None]], axis=1)
    sums = np.zeros((2, count + other_count + 1))
    sums[0, :count] = sums[1, count:-1] = 1.0
    cost = np.zeros(count + other_count + 1)
    cost[-1] = 1.0
    found = linprog(
        cost, A_eq=np.concatenate([points, sums]), b_eq=[0.0, 0.0, 0.0, 1.0, 1.0]
    )
    return float(found.x[-1]) if found.success else math.inf


def _pieces_m(body: RigidBody) -> list[FloatArray]:
    """Return the corners of each convex piece in the world [m]."""
    pieces = getattr(body.shape, "pieces_m", None)
    corners = (
        [np.asarray(piece) for piece in pieces] if pieces else [body.shape.corners_m]
    )
    return [body.pose.to_world(piece) for piece in corners]


def _corners_m(body: RigidBody) -> FloatArray:
    return body.pose.to_world(body.shape.corners_m)


# --- a bar of foam --------------------------------------------------------------------------------------------------

CLAMP_DECAY = 2.106
"""Decay of what a clamp does, per half width: real part of the first root of sin(2 z) = -2 z (Papkovich and Fadle)."""


def bar_band(law: UniaxialLaw, scene: Scene, *, variant: str, frame_count: int) -> Band:
    """Return the band of the faces of a bar along z that a grip stretches or compresses.

    A strain e between the grips has the lateral strain -nu e. The uncertainty has five parts: the share by which the
    real strain differs; the lateral strain that a clamp suppresses, which decays with the distance from it; the greater
    stiffness of clamped ends; the difference between linear and logarithmic strain, which the constitutive law decides;
    and the time in which sound crosses the bar.

    Args:
        law: The law.
        scene: The scene; the bar is attached to two bodies, of which the carrier moves along the bar.
        variant: Name of the variant.
        frame_count: Number of frames.
    """
    bar = next(one for one in scene.deformables if one.name == law.body)
    (driver,) = (one for one in scene.drivers if one.body == law.carrier)
    if not isinstance(bar, SoftBody) or scene.markers is None:
        raise ShapeError(
            f"{law.body} is no soft body with markers: the law needs the faces of a bar"
        )
    clamped_m = {
        one.region.side: one.region.depth_m
        for one in scene.attachments
        if one.deformable == law.body
    }
    width_m, _, height_m = bar.shape.size_m
    free_m = height_m - clamped_m["low"] - clamped_m["high"]

    # Strain between the clamps, shape [frame_count], and its rate [1/s].
    carrier_pose = scene.body(law.carrier).pose
    times_s = np.arange(frame_count) / FRAME_RATE_HZ
    states = driver.path(carrier_pose, times_s)
    strain = (states[:, 2] - carrier_pose.position_m[2]) / free_m
    strain_rate = states[:, 9] / free_m

    # Uniaxial stress (Hooke): each point goes from the lower clamp by (1 - nu e, 1 - nu e, 1 + e).
    points_m = bar.pose.to_body(np.array(scene.markers.positions_m))
    faces = np.array(scene.markers.faces)
    clamp_m = np.array([0.0, 0.0, clamped_m["low"] - 0.5 * height_m])
    lateral = 1.0 - bar.poisson_ratio * strain
    stretches = np.column_stack([lateral, lateral, 1.0 + strain])[:, None]
    areas_mm2 = face_areas_mm2(clamp_m + (points_m - clamp_m) * stretches, faces)
    rest_mm2 = face_areas_mm2(points_m[None], faces)

    # Lateral strain that the nearer clamp suppresses (Saint-Venant), at the middle of each face.
    middle_m = points_m[faces, 2].mean(axis=1)
    from_clamp_m = np.minimum(middle_m - clamp_m[2], clamp_m[2] + free_m - middle_m)
    suppressed = bar.poisson_ratio * np.exp(
        -CLAMP_DECAY * from_clamp_m / (0.5 * width_m)
    )

    # A clamped end of about half a width does not narrow: its stiffness is larger by about nu^2.
    stiffer = bar.poisson_ratio**2 * width_m / free_m

    # Strain that has not yet arrived: sound crosses the bar with c = sqrt(E / density).
    sound_m_per_s = np.sqrt(bar.young_modulus_pa * width_m**2 * height_m / bar.mass_kg)
    late_strain = strain_rate * free_m / sound_m_per_s

    unknown_strain_mm2 = law.left_out_share * (areas_mm2 - rest_mm2)
    suppressed_mm2 = rest_mm2 * np.outer(strain, suppressed)
    stiffer_mm2 = rest_mm2 * stiffer * strain[:, None]
    logarithmic_mm2 = (
        rest_mm2
        * 0.5
        * bar.poisson_ratio
        * (1.0 + bar.poisson_ratio)
        * strain[:, None] ** 2
    )
    late_mm2 = rest_mm2 * late_strain[:, None]
    parts_mm2 = [
        unknown_strain_mm2,
        suppressed_mm2,
        stiffer_mm2,
        logarithmic_mm2,
        late_mm2,
    ]
    uncertainty_mm2 = np.sqrt(np.sum(np.square(parts_mm2), axis=0))

    # An area of sides s has the error 0.5 sigma sqrt(sum of s^2) of its measured corners.
    sides_m = np.linalg.norm(
        points_m[faces] - points_m[np.roll(faces, 1, axis=1)], axis=2
    )
    typical_m = float(np.sqrt(np.square(sides_m).sum(axis=1).mean()))
    measurement_mm2 = 0.5 * law.sigma_mm * 1e3 * typical_m
    return uniaxial_band(
        law,
        variant=variant,
        areas_mm2=areas_mm2,
        uncertainty_mm2=uncertainty_mm2,
        measurement_mm2=measurement_mm2,
    )
