"""Friction of each material that brings a Coulomb slide nearest to the recorded slides of SlopeSlider-2.

    python studies/slides/friction.py

The closed form of the slide starts at the published place, as every simulation does. Friction and release time have the
least squared distance from the mean motion over all frames, which is the distance of the score. The standard
uncertainty is the jackknife over the trials: the fit is repeated without each trial.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from gauge_envs import load_experiment
from gauge_envs.references.band import load_band
from gauge_envs.scene.timing import FRAME_RATE_HZ

SLOPE_RAD = math.radians(30.0)
DOWNHILL = np.array([math.cos(SLOPE_RAD), 0.0, -math.sin(SLOPE_RAD)])
FIRST_GUESS = (0.3, 0.01)
"""Friction, and release time [s]."""

Array = NDArray[np.float64]


def slide_mm(
    friction: float,
    release_s: float,
    *,
    start_mm: float,
    frame_count: int,
    gravity_m_per_s2: float,
) -> Array:
    """Return the place of a Coulomb slide at each frame, downhill [mm], shape [frame_count]."""
    driving = math.sin(SLOPE_RAD) - friction * math.cos(SLOPE_RAD)
    acceleration_mm_per_s2 = 1e3 * gravity_m_per_s2 * driving
    sliding_s = np.maximum(np.arange(frame_count) / FRAME_RATE_HZ - release_s, 0.0)
    return start_mm + 0.5 * acceleration_mm_per_s2 * sliding_s**2


def fitted_friction(
    motion_mm: Array, start_mm: float, gravity_m_per_s2: float
) -> tuple[float, float]:
    """Return the friction nearest to a motion, shape [frame_count], and the root mean square distance [mm]."""

    def deviations_mm(values: Array) -> Array:
        friction, release_s = values
        slide = slide_mm(
            friction,
            release_s,
            start_mm=start_mm,
            frame_count=len(motion_mm),
            gravity_m_per_s2=gravity_m_per_s2,
        )
        return slide - motion_mm

    result = least_squares(deviations_mm, FIRST_GUESS)
    distance_mm = math.sqrt(np.mean(np.square(result.fun)))
    return float(result.x[0]), distance_mm


def jackknife_uncertainty(
    trials_mm: Array, start_mm: float, gravity_m_per_s2: float
) -> float:
    """Return the standard uncertainty of the fit to the mean of trials, shape [trial_count, frame_count]."""
    fits = []
    for trial in range(len(trials_mm)):
        mean_mm = np.delete(trials_mm, trial, axis=0).mean(axis=0)
        friction, _ = fitted_friction(mean_mm, start_mm, gravity_m_per_s2)
        fits.append(friction)
    return math.sqrt(len(fits) - 1) * float(np.std(fits))


def main() -> None:
    """Print the fits of all materials."""
    print(
        "material, friction, u, distance mm, start of the trials mm, u mm, friction from that start"
    )
    for material in ("wood", "plastic", "metal"):
        experiment = load_experiment(f"SlopeSlider-2-{material}")
        band = load_band(experiment.name)
        assert band is not None and band.trials is not None
        gravity = experiment.scene.gravity_m_per_s2
        position_m = np.array(experiment.scene.body("cube").pose.position_m)
        start_mm = float(1e3 * position_m @ DOWNHILL)
        mean_mm, trials_mm = band.mean[:, 0], band.trials[:, :, 0]
        friction, distance_mm = fitted_friction(mean_mm, start_mm, gravity)
        uncertainty = jackknife_uncertainty(trials_mm, start_mm, gravity)
        offsets_mm = trials_mm[:, 0] - start_mm
        offset_u_mm = offsets_mm.std(ddof=1) / math.sqrt(len(offsets_mm))
        from_trials, _ = fitted_friction(mean_mm, float(mean_mm[0]), gravity)
        print(
            f"{material}, {friction:.4f}, {uncertainty:.4f}, {distance_mm:.2f}, "
            f"{offsets_mm.mean():.1f}, {offset_u_mm:.1f}, {from_trials:.4f}"
        )


if __name__ == "__main__":
    main()
