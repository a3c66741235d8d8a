"""Measure contact settings on an engine: friction, restitution, depth at rest and creep."""

from collections.abc import Mapping
from dataclasses import dataclass

from gauge_envs.tools.bench.recording import DivergedError
from gauge_envs.tools.recipes.engines.base import ContactSettings
from gauge_envs.tools.recipes.probes import Probe, Rest, Spread

SCATTER = 0.02
"""Range of restitutions, and relative one of frictions, that is worth a sentence."""

MOST_DRIFT_PER_S = 0.05
"""Largest change of the depth within a second, over the depth, of a plate that counts as settled."""

SEEN_HOP_M = 0.01
"""Hop of a fast plate that is worth a sentence [m]: MuJoCo's default hops by half of it."""

LEAST_DRIFT_M_PER_S = 1e-6
"""Change of the depth that is rounding [m/s]."""


REACHED = (
    "friction",
    "friction_hopping",
    "restitution",
    "penetration_m",
    "creep_m_s",
    "time_constant_s",
)
"""Names of the measured values; `friction` is that of bodies that hold contact."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """What settings give.

    Attributes:
        slide: Friction of plates that cannot turn, as that of bodies that hold contact.
        hopping: Friction of plates that can tip, hop and spin.
        hop_m: How far these leave the slope [m].
        fast_hop_m: How far plates leave level ground that slide at up to 4 m/s [m].
        rebound: Restitution of drops.
        rest: Plate at rest.
        creep_m_s: Creep on a slope that friction holds [m/s].
        turning: Torsional and rolling friction [m] by name, where the settings have them.
    """

    slide: Spread
    hopping: Spread
    hop_m: float
    fast_hop_m: float
    rebound: Spread
    rest: Rest
    creep_m_s: float
    turning: Mapping[str, float]

    @property
    def values(self) -> dict[str, float | None]:
        """Values by their names in `REACHED`; None for a time constant that is not resolved."""
        frictions, rest = (self.slide.mean, self.hopping.mean), self.rest
        values = (
            *frictions,
            self.rebound.mean,
            rest.penetration_m,
            self.creep_m_s,
            rest.time_constant_s,
        )
        return {**dict(zip(REACHED, values, strict=True)), **self.turning}


def probe_of(settings: ContactSettings, mass_kg: float) -> Probe:
    """Return the scenes on the engine of the settings."""
    return Probe(
        backend=settings.backend(), mass_kg=mass_kg, timestep_s=settings.timestep_s
    )


def measured(
    settings: ContactSettings, mass_kg: float, *, friction: float | None = None
) -> Measured:
    """Simulate all scenes.

    Args:
        settings: The settings.
        mass_kg: Mass of the bodies [kg].
        friction: Friction for which slopes are chosen; that of the settings if None.

    Raises:
        DivergedError: The engine failed, or a body left the scene.
    """
    probe, build = probe_of(settings, mass_kg), settings.build(mass_kg)
    slope = settings.sliding_friction if friction is None else friction
    hopping, hop_m = probe.hop(build, slope)
    return Measured(
        slide=probe.slide(build, slope),
        hopping=hopping,
        hop_m=hop_m,
        fast_hop_m=probe.fast_hop_m(build),
        rebound=probe.drop(build),
        rest=probe.rest(build),
        creep_m_s=probe.creep(build, slope),
        turning={
            name: probe.turning(build, name)
            for name, value in build.turning.items()
            if value
        },
    )


def divergence_text(error: DivergedError) -> str:
    """Return why nothing was measured, and what to change."""
    return f"the simulation diverges: {error}. Choose a shorter time step or a softer contact."


def scatter_texts(found: Measured) -> list[str]:
    """Return what one number for each quantity leaves out: hops, scatter between drops, a depth that still changes."""
    texts = []
    slide, hopping, rebound, rest = (
        found.slide,
        found.hopping,
        found.rebound,
        found.rest,
    )
    if slide.high - slide.low > SCATTER * abs(slide.mean):
        texts.append(
            f"Friction depends on the direction: it is {slide.low:.3g} to {slide.high:.3g} for a plate with its edges "
            "along the slope and one that is turned by 30 degrees; the friction is their mean."
        )
    if slide.mean - hopping.low > SCATTER * abs(slide.mean):
        texts.append(
            f"Plates that can tip hop by up to {1e3 * found.hop_m:.2g} mm while they slide, and have friction "
            f"{hopping.low:.3g} to {hopping.high:.3g} (mean {hopping.mean:.3g}); higher bodies can lose more."
        )
    if found.fast_hop_m > SEEN_HOP_M:
        texts.append(
            f"Plates that slide at up to 4 m/s hop by {1e3 * found.fast_hop_m:.2g} mm: these contacts take much of the "
            "speed in one step, and friction lifts what slides; a softer contact or a shorter step hops less."
        )
    if rebound.high - rebound.low > SCATTER:
        texts.append(
            f"Single drops rebound with {rebound.low:.3f} to {rebound.high:.3f}, depending on where in a time step "
            "they strike; the restitution is their mean."
        )
    if abs(rest.drift_m_s) > max(
        MOST_DRIFT_PER_S * abs(rest.penetration_m), LEAST_DRIFT_M_PER_S
    ):
        texts.append(
            f"After 2 s the plate at rest still moves by {rest.drift_m_s:.1e} m/s, so its depth is not final."
        )
    return texts
