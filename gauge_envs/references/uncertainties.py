"""Standard uncertainties of published constants."""

FRICTION_SHARES = {"wood": 0.06249, "plastic": 0.1448, "metal": 0.04674}
"""Relative standard uncertainty of a published friction, by material."""

DEFAULT_FRICTION_SHARE = 0.0950
"""Root mean square of the three, for materials without trials."""

FRICTION_SOURCE = (
    "distance of the published friction from that of single real slides: 20 wood, 20 plastic and 19 metal trials of "
    "SlopeSlider-2 (scoring/facts/slope_slider_30deg_summary.toml); other: root mean square of the three"
)

RESTITUTION_SHARE = 0.2778
"""Relative standard uncertainty of a published restitution."""

RESTITUTION_SOURCE = (
    "distance of the published restitution from the rebound ratio of single real drops: 22 trials of BouncingBall "
    "(scoring/facts/bouncing_ball_summary.toml); no other restitution was compared with trials"
)


def friction_std(value: float, material: str | None) -> float:
    """Return the standard uncertainty of a published friction.

    Args:
        value: Published value.
        material: Material of the variant.
    """
    return value * FRICTION_SHARES.get(material or "", DEFAULT_FRICTION_SHARE)
