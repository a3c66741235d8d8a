"""Closed form of an elastic bar between two grips: the areas of its marked faces, with what the form leaves out."""

from __future__ import annotations

import numpy as np

from gauge_envs.errors import ShapeError
from gauge_envs.observables.functions import face_areas_mm2
from gauge_envs.references.bands import Band
from gauge_envs.references.published import UniaxialLaw, uniaxial_band
from gauge_envs.scene import Scene, SoftBody
from gauge_envs.scene.timing import FRAME_RATE_HZ

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
        raise ShapeError(f"{law.body} is no soft body with markers: the law needs the faces of a bar")
    held = {one.region.side: one.region.depth_m for one in scene.attachments if one.deformable == law.body}
    width, _, height = bar.shape.size_m
    free = height - held["low"] - held["high"]
    start, times_s = scene.body(law.carrier).pose, np.arange(frame_count) / FRAME_RATE_HZ
    states = [driver.state(start, time_s) for time_s in times_s]
    strain = np.array([pose.position_m[2] - start.position_m[2] for pose, _ in states]) / free
    rate = np.array([velocity[2] for _, velocity in states]) / free
    own = bar.pose.to_body(np.array(scene.markers.positions_m))
    fixed = np.array([0.0, 0.0, held["low"] - 0.5 * height])
    lateral = 1.0 - bar.poisson_ratio * strain
    stretches = np.column_stack([lateral, lateral, 1.0 + strain])[:, None]
    faces = np.array(scene.markers.faces)
    areas = face_areas_mm2(fixed + (own - fixed) * stretches, faces)
    rest = face_areas_mm2(own[None], faces)
    middle = own[faces, 2].mean(axis=1)
    clamp = np.minimum(middle - fixed[2], fixed[2] + free - middle)
    suppressed = bar.poisson_ratio * np.exp(-CLAMP_DECAY * clamp / (0.5 * width))
    stiffer = bar.poisson_ratio**2 * width / free
    speed = np.sqrt(bar.young_modulus_pa * width**2 * height / bar.mass_kg)
    parts = [
        law.left_out_share * (areas - rest),
        rest * np.outer(strain, suppressed),
        rest * stiffer * strain[:, None],
        rest * 0.5 * bar.poisson_ratio * (1.0 + bar.poisson_ratio) * strain[:, None] ** 2,
        rest * (rate * free / speed)[:, None],
    ]
    uncertainty = np.sqrt(np.sum(np.square(parts), axis=0))
    sides = np.linalg.norm(own[faces] - own[np.roll(faces, 1, axis=1)], axis=2)
    measurement = 0.5 * law.sigma_mm * 1e3 * float(np.sqrt(np.square(sides).sum(axis=1).mean()))
    return uniaxial_band(
        law, variant=variant, areas_mm2=areas, uncertainty_mm2=uncertainty, measurement_mm2=measurement
    )
