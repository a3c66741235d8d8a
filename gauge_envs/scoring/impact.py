"""The first impact of a recorded body between two free flights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gauge_envs.errors import ShapeError
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.references.bands import Band
from gauge_envs.scene import ContactMode
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scoring.estimators import first_bounce
from gauge_envs.scoring.laws import free_flight

MAX_MISFIT = 0.04
"""Largest root-mean-square misfit of a law of motion, over the root mean square of the displacement.

The mean of real slides, which start at different times, has a misfit of up to 0.032 to uniform acceleration.
"""

IMPACT_WINDOW_S = 1.0 / 60.0
"""Longest duration of an impact [s]; that of the ball takes 5 ms."""

IMPACT_SHARE = 0.1
"""Smallest change of velocity in an impact, over the largest; a second impact has e times the change of the first."""


@dataclass(frozen=True, eq=False)
class Impact:
    """The first impact of a trajectory, between two free flights.

    Attributes:
        time_s: Time of the impact [s].
        normal: Unit vector along which the velocity jumps, shape [C].
        speed_in: Speed against the normal just before it [mm/s].
        speed_out: Speed along the normal just after it [mm/s].
    """

    time_s: float
    normal: FloatArray
    speed_in: float
    speed_out: float

    @property
    def restitution(self) -> float:
        """Ratio of the speeds along the normal after and before the impact."""
        return self.speed_out / self.speed_in


def simulated_impact(
    experiment: Experiment, band: Band, times_s: FloatArray, values: FloatArray
) -> Impact | None:
    """Return the first impact of the recorded body of a simulation; None if it does not rebound.

    Args:
        experiment: The experiment, with one recorded body.
        band: Band that states the coordinates.
        times_s: Times from 0 on [s], shape [S].
        values: Band coordinates at these times [mm], shape [S, C].
    """
    scene, body = experiment.scene, experiment.recorded[0]
    contacts = [one for one in scene.contacts if body in (*one.first, *one.second)]
    if not contacts or any(one.mode is not ContactMode.IMPACT for one in contacts):
        return None
    return find_impact(
        times_s,
        values,
        gravity_m_per_s2=band.projection @ [0.0, 0.0, -scene.gravity_m_per_s2],
        contact_mm=_contact_mm(experiment, band),
    )


def _contact_mm(experiment: Experiment, band: Band) -> FloatArray | None:
    """Return the place at which the recorded body lands if it falls from rest, shape [C]; None if it does not."""
    scene, body = experiment.scene, experiment.recorded[0]
    if not scene.body(body).starts_at_rest:
        return None
    try:
        fall = free_flight(scene, body)
    except ShapeError:
        return None
    landed_m = fall.start_m + fall.distance_m * fall.direction
    return band.project(1e3 * landed_m[None])[0]


def find_impact(
    times_s: FloatArray,
    values: FloatArray,
    *,
    gravity_m_per_s2: FloatArray,
    contact_mm: FloatArray | None = None,
) -> Impact | None:
    """Return the first impact of a body between two free flights.

    The sharpest change of velocity gives the normal; `estimators.first_bounce` along it gives the speeds.

    Args:
        times_s: Times [s], strictly increasing, shape [S].
        values: Coordinates at these times [mm], shape [S, C].
        gravity_m_per_s2: Acceleration of a free body in the same coordinates, shape [C].
        contact_mm: Place of a body that touches the support, shape [C]; the body is let go at rest at the first sample.
            None of a motion for which neither is known.

    Returns:
        The impact. None if the velocity never reverses within `IMPACT_WINDOW_S`, or within two samples if they are
        further apart. None also if the coordinate along the normal is not a parabola before and after the impact.
    """
    steps = np.diff(times_s)
    window = max(2, round(IMPACT_WINDOW_S / float(np.median(steps))))
    velocity = np.diff(values, axis=0) / steps[:, None]
    if len(velocity) <= 2 * window:
        return None
    jumps = velocity[window:] - velocity[:-window]
    # The change of velocity in free flight is not part of an impact. A second impact may change it much less.
    sizes = np.linalg.norm(jumps - np.median(jumps, axis=0), axis=1)
    hits = np.flatnonzero(sizes >= IMPACT_SHARE * sizes.max())
    first = hits[0] + int(np.argmax(sizes[hits[0] : hits[0] + window]))
    if sizes[first] == 0.0:
        return None
    normal = jumps[first] / np.linalg.norm(jumps[first])
    if velocity[first] @ normal >= 0.0 or velocity[first + window] @ normal <= 0.0:
        return None
    heights_m = 1e-3 * values @ normal
    gravity = -float(gravity_m_per_s2 @ normal)
    if gravity <= 0.0:
        return None
    contact_m = None if contact_mm is None else 1e-3 * float(contact_mm @ normal)
    released_m = None if contact_mm is None else float(heights_m[0])
    bounce = first_bounce(
        times_s,
        heights_m,
        gravity_m_per_s2=gravity,
        contact_m=contact_m,
        released_m=released_m,
    )
    if bounce is None or bounce.speed_out_m_per_s == 0.0 or bounce.misfit > MAX_MISFIT:
        return None
    return Impact(
        bounce.time_s,
        normal,
        1e3 * bounce.speed_in_m_per_s,
        1e3 * bounce.speed_out_m_per_s,
    )
