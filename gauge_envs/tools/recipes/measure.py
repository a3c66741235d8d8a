"""What contact settings give in all scenes, and what single numbers leave out."""

from collections.abc import Mapping
from typing import Any

from gauge_envs.tools.recipes.engines.base import ContactSettings
from gauge_envs.tools.recipes.probes import Probe

NAMES = (
    "friction",
    "friction_hopping",
    "restitution",
    "penetration_m",
    "creep_m_s",
    "time_constant_s",
)
"""Names of what is reported of all settings; `friction` is the friction of bodies that hold contact."""

SCATTER = 0.02
"""Range of restitutions, and relative range of frictions, that is worth a sentence."""

SEEN_HOP_M = 0.01
"""Hop of a fast plate that is worth a sentence [m]: MuJoCo's default hops by half of it."""

MAX_DRIFT_PER_S, ROUNDING_M_PER_S = 0.05, 1e-6
"""Change of the depth in a second, over the depth, of a plate that counts as settled; and one that is rounding."""


def measured(
    settings: ContactSettings, mass_kg: float, *, friction: float | None = None
) -> dict[str, Any]:
    """Simulate all scenes, and return their values by name, with those of `NAMES`.

    Args:
        settings: The settings.
        mass_kg: Mass of the bodies [kg].
        friction: Friction for which slopes are chosen; that of the settings if None.

    Raises:
        DivergedError: The engine failed, or a body left the scene.
        UnsupportedSceneError: The engine cannot simulate the contact.
    """
    slope_friction = settings.sliding_friction if friction is None else friction
    probe = Probe(settings=settings, mass_kg=mass_kg, friction=slope_friction)
    return {
        **probe.slide(),
        **probe.hop(),
        **probe.fast_hop(),
        **probe.drop(),
        **probe.rest(),
        **probe.creep(),
        **probe.turning(),
    }


def notes_on(values: Mapping[str, Any]) -> list[str]:
    """Return what one number for each quantity leaves out: hops, scatter between drops, a depth that still changes."""
    notes = []
    friction, low, high = (values[f"friction{end}"] for end in ("", "_low", "_high"))
    hop_low, hop_high = values["friction_hopping_low"], values["friction_hopping_high"]
    drop_low, drop_high = values["restitution_low"], values["restitution_high"]
    if high - low > SCATTER * abs(friction):
        notes.append(
            f"Friction depends on the direction: it is {low:.3g} to {high:.3g} for a plate with its edges along the "
            "slope and one turned by 30 degrees."
        )
    if friction - hop_low > SCATTER * abs(friction):
        notes.append(
            f"Plates that can tip hop by up to {1e3 * values['hop_m']:.2g} mm and have friction {hop_low:.3g} to "
            f"{hop_high:.3g}; higher bodies can lose more."
        )
    if values["fast_hop_m"] > SEEN_HOP_M:
        notes.append(
            f"Plates that slide at up to 4 m/s hop by {1e3 * values['fast_hop_m']:.2g} mm; a softer contact or a "
            "shorter step hops less."
        )
    if drop_high - drop_low > SCATTER:
        notes.append(
            f"Single drops rebound with {drop_low:.3f} to {drop_high:.3f}, depending on where in a time step they "
            "strike."
        )
    allowed_m_per_s = MAX_DRIFT_PER_S * abs(values["penetration_m"])
    if abs(values["drift_m_s"]) > max(allowed_m_per_s, ROUNDING_M_PER_S):
        notes.append(
            f"After 2 s the plate at rest still moves by {values['drift_m_s']:.1e} m/s, so its depth is not final."
        )
    return notes
