"""Metrics of a motion: distance to the real mean, events of a swing, agreement with physical laws."""

from gauge_envs.evaluation.metrics.events import (
    SwingTimes,
    dropped_rests,
    energy_loss,
    longest_stationary_duration,
    momentum_transfer_efficiency,
    oscillation_period,
    spectral_peak_period,
    swing_times,
)
from gauge_envs.evaluation.metrics.law import (
    coefficient_of_determination,
    dynamic_error,
    fitted_acceleration,
    quadratic_form_improvement,
)
from gauge_envs.evaluation.metrics.trajectory import (
    MAX_RELEASE_OFFSET_S,
    band_coverage,
    dtw_path,
    mean_abs_z,
    release_offset,
    signed_error,
    trajectory_dtw,
    trajectory_rmse,
    z_scores,
)

__all__ = [
    "MAX_RELEASE_OFFSET_S",
    "SwingTimes",
    "band_coverage",
    "coefficient_of_determination",
    "dropped_rests",
    "dtw_path",
    "dynamic_error",
    "energy_loss",
    "fitted_acceleration",
    "longest_stationary_duration",
    "mean_abs_z",
    "momentum_transfer_efficiency",
    "oscillation_period",
    "quadratic_form_improvement",
    "release_offset",
    "signed_error",
    "spectral_peak_period",
    "swing_times",
    "trajectory_dtw",
    "trajectory_rmse",
    "z_scores",
]
