"""95 % intervals of distances."""

from gauge_envs.references.band import Band


def distance_interval(distance: float, uncertainty: float) -> tuple[float, float]:
    """Return the 95 % interval d +- 1.96 u of a distance, at least 0."""
    return max(distance - 1.96 * uncertainty, 0.0), distance + 1.96 * uncertainty


def mean_uncertainty(band: Band) -> float:
    """Return the standard uncertainty of a distance from the mean of real trials."""
    return band.standard_uncertainty
