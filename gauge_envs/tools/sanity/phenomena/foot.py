"""Foot of a robot on the measured boards: creep, slip, slide and landing.

The foot has the solids and the load that a configuration states, and the friction of a measured wooden cube on its
board. Without a configuration, the rows have the foot of a small quadruped.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.evaluation.metrics.law import fitted_acceleration
from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import GRAVITY_M_PER_S2, Contact, Motion, Plane, Pose, RigidBody, Scene
from gauge_envs.tools.sanity.foot import REFERENCE_FOOT, FootGeometry
from gauge_envs.tools.sanity.model import COVERAGE, Reality
from gauge_envs.tools.sanity.phenomena.facts import facts
from gauge_envs.tools.sanity.phenomena.friction import HOLD_S, SETTLED_S, SLIDE_S, creep_bound_mm_per_s
from gauge_envs.tools.sanity.phenomena.phenomenon import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.tools.sanity.scenario import Scenario

FOOT, GROUND = "foot", "ground"
"""Names of the two bodies."""

MATERIAL = "wood"

SOFTENED_BY_INVERSE_WEIGHT = ("mujoco", "mujoco_warp")
"""Backends that build MuJoCo's own model, whose contacts are softened by the inverse weight of a link."""

HOLD_DEG, SLIDE_DEG = 10.0, 30.0
"""Slopes of the measured boards [degrees]."""

PUSH = 1.2
"""Push along the ground, over mu times the normal force. On a slope, gravity pushes like this."""

DROP_M, LANDING_S = 0.05, 0.6
"""Height of the drop, as of a step, and simulated time with the fall of 0.1 s."""

DEPTH_MM = 9.0
"""Compression of a rubber ball of 20 mm radius and a modulus of 2 MPa that lands with 3 kg, by Hertz's law [mm]."""

HOP = 0.2
"""Ratio of speeds at which a foot that was dropped from 50 mm hops by 2 mm."""

STANCE_S = 0.2
"""Time that a foot of a trotting quadruped is on the ground [s]."""

STILL_S = 0.05
"""Time at the end in which a landed foot must be at rest [s]."""

AT_REST_M_PER_S = 0.01
"""Speed below which a landed foot is at rest [m/s]."""


def phenomena() -> Iterator[Phenomenon]:
    """Yield the rows with the reference foot."""
    yield from foot_phenomena(REFERENCE_FOOT)


def foot_phenomena(foot: FootGeometry) -> Iterator[Phenomenon]:
    """Yield the rows with a foot."""
    yield _creep(foot)
    yield _push(foot)
    yield _slide(foot)
    yield _depth(foot)
    yield _rebound(foot)
    yield _rest(foot)


# --- scenes ----------------------------------------------------------------------------------------------------------


def foot_scene(
    foot: FootGeometry, *, friction: float, slope_deg: float = 0.0, lift_m: float = 0.0, seconds: float = 1.0
) -> Scene:
    """Return four copies of a foot in one rigid body, on an even ground that slopes along x.

    Args:
        foot: The foot.
        friction: Coulomb coefficient of the soles.
        slope_deg: Slope of the ground [degrees].
        lift_m: Height of the soles above the ground at the start [m].
        seconds: Duration of the experiment [s].
    """
    turn = Rotation.from_euler("y", slope_deg, degrees=True)
    x, y, z = turn.apply([0.0, 0.0, lift_m]).tolist()
    return Scene(
        bodies=(
            RigidBody(
                name=FOOT,
                shape=foot.shape,
                motion=Motion.DYNAMIC,
                pose=Pose.from_rotation((x, y, z), turn),
                mass_kg=foot.mass_kg,
            ),
            RigidBody(
                name=GROUND,
                shape=Plane(),
                motion=Motion.FIXED,
                pose=Pose.from_rotation((0.0, 0.0, 0.0), turn),
                mass_kg=0.0,
            ),
        ),
        contacts=(Contact(first=(FOOT,), second=(GROUND,), friction=friction, restitution=0.0),),
        duration_s=seconds,
    )


def _replaced(
    _: Scene, *, foot: FootGeometry, friction: float, slope_deg: float, lift_m: float, seconds: float
) -> Scene:
    """Return the scene of a foot instead of a cube on a board."""
    return foot_scene(foot, friction=friction, slope_deg=slope_deg, lift_m=lift_m, seconds=seconds)


def _scenario(
    kind: str, foot: FootGeometry, *, seconds: float, slope_deg: float, lift_m: float = 0.0, steep: bool = True
) -> Scenario:
    softening = {} if foot.softening is None else {"inverse_weight_scale": foot.softening}
    return Scenario(
        name=f"foot-{kind}-{foot.digest}",
        variant=f"SlopeSlider-{2 if steep else 1}-{MATERIAL}",
        seconds=seconds,
        change=partial(_replaced, foot=foot, friction=_friction(), slope_deg=slope_deg, lift_m=lift_m, seconds=seconds),
        engine_settings=dict.fromkeys(SOFTENED_BY_INVERSE_WEIGHT, softening),
    )


def _friction() -> float:
    """Return the friction that real slides of the wooden cube show."""
    return float(facts("slope_slider_30deg_summary")[MATERIAL]["friction"]["mean"])


def _source(law: str, foot: FootGeometry) -> str:
    return (
        f"{law}; extrapolated: mu = {_friction():.3f} is that of the measured cube of {MATERIAL}; the foot is "
        f"{foot.description}; {foot.assumption}"
    )


# --- readings --------------------------------------------------------------------------------------------------------


def _along_mm(rollout: Rollout) -> FloatArray:
    """Return displacements of the foot in the frame of the ground [mm], shape [sample_count, 3]; x is downhill."""
    ground = rollout.scene.body(GROUND).pose.rotation
    return np.asarray(1e3 * ground.apply(rollout.displacement(FOOT), inverse=True))


def _downhill_mm(rollout: Rollout) -> FloatArray:
    return _along_mm(rollout)[:, 0]


def _lowest_mm(rollout: Rollout, foot: FootGeometry) -> FloatArray:
    """Return the height of the lowest sole above level ground [mm], shape [sample_count]."""
    turns = rollout.rotation(FOOT).as_matrix()
    heights = np.einsum("ti,pi->tp", turns[:, 2], foot.soles_m)
    return np.asarray(1e3 * (heights.min(axis=1) + rollout.position(FOOT)[:, 2]))


def _acceleration(rollout: Rollout) -> PhenomenonValue:
    return PhenomenonValue(value=1e-3 * fitted_acceleration(rollout.times_s, _downhill_mm(rollout)))


# --- on a slope ------------------------------------------------------------------------------------------------------


def _creep(foot: FootGeometry) -> Phenomenon:
    scenario = _scenario("hold", foot, seconds=HOLD_S, slope_deg=HOLD_DEG, steep=False)
    bound = creep_bound_mm_per_s(scenario.variant)

    def read(rollout: Rollout) -> PhenomenonValue:
        late = rollout.between(SETTLED_S, HOLD_S)
        return PhenomenonValue(value=float(np.polyfit(rollout.times_s[late], _downhill_mm(rollout)[late], 1)[0]))

    def reality(times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.zeros_like(times_s), bound * times_s

    return Phenomenon(
        id="foot-creep",
        title=f"foot of the robot: creep on {HOLD_DEG:.0f} degrees",
        quantity="creep",
        scenario=scenario,
        unit="mm/s",
        reality=Reality.law(
            0.0,
            tolerance=bound,
            source=_source("Coulomb, tan 10 deg < mu", foot),
            rationale=f"the published trials of the {MATERIAL} cube allow no faster creep (paper, Table 5)",
        ),
        needs_friction=True,
        needs_foot=True,
        read=read,
        trace=Trace(label="displacement downhill [mm]", values=_downhill_mm, reality=reality),
    )


def _push(foot: FootGeometry) -> Phenomenon:
    slope = float(np.degrees(np.arctan(PUSH * _friction())))
    return _sliding(
        foot,
        name="foot-push",
        title=f"foot of the robot: acceleration when pushed with {PUSH:g} times its friction",
        law=f"g (sin a - mu cos a) with tan a = {PUSH:g} mu, where gravity pushes with {PUSH:g} mu N",
        slope_deg=slope,
    )


def _slide(foot: FootGeometry) -> Phenomenon:
    return _sliding(
        foot,
        name="foot-slide",
        title=f"foot of the robot: acceleration on {SLIDE_DEG:.0f} degrees",
        law=f"g (sin {SLIDE_DEG:.0f} deg - mu cos {SLIDE_DEG:.0f} deg)",
        slope_deg=SLIDE_DEG,
    )


def _sliding(foot: FootGeometry, *, name: str, title: str, law: str, slope_deg: float) -> Phenomenon:
    trials = facts("slope_slider_30deg_summary")[MATERIAL]["acceleration_m_s2"]
    slope = np.radians(slope_deg)
    value = GRAVITY_M_PER_S2 * float(np.sin(slope) - _friction() * np.cos(slope))
    real = Reality.measured(
        trials["mean"],
        scatter=trials["std"],
        trial_count=facts("slope_slider_30deg_summary")[MATERIAL]["trial_count"],
        source="",
    )

    def reality(times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        return 500.0 * value * times_s**2, 500.0 * real.tolerance * times_s**2

    return Phenomenon(
        id=name,
        title=title,
        quantity="acceleration",
        scenario=_scenario(name.removeprefix("foot-"), foot, seconds=SLIDE_S, slope_deg=slope_deg),
        unit="m/s^2",
        reality=Reality.law(
            value,
            tolerance=real.tolerance,
            source=_source(law, foot),
            rationale=f"covers {COVERAGE:.0%} of further real slides of the {MATERIAL} cube on 30 degrees",
        ),
        needs_friction=True,
        needs_foot=True,
        read=_acceleration,
        trace=Trace(label="displacement downhill [mm]", values=_downhill_mm, reality=reality),
    )


# --- landing ---------------------------------------------------------------------------------------------------------


def _landing(foot: FootGeometry) -> Scenario:
    return _scenario("landing", foot, seconds=LANDING_S, slope_deg=0.0, lift_m=DROP_M)


def _fall_s() -> float:
    return float(np.sqrt(2.0 * DROP_M / GRAVITY_M_PER_S2))


def _depth(foot: FootGeometry) -> Phenomenon:
    def read(rollout: Rollout) -> PhenomenonValue:
        return PhenomenonValue(value=-float(_lowest_mm(rollout, foot).min()))

    return Phenomenon(
        id="foot-landing-depth",
        title=f"foot of the robot: depth in the ground after a drop of {1e3 * DROP_M:.0f} mm",
        quantity="depth",
        scenario=_landing(foot),
        unit="mm",
        reality=Reality.law(
            0.0,
            tolerance=DEPTH_MM,
            source=_source("rigid bodies do not overlap", foot),
            rationale="a rubber ball of 20 mm radius (2 MPa) that lands with 3 kg is compressed as much (Hertz)",
        ),
        needs_foot=True,
        read=read,
        trace=Trace(label="height of the lowest sole [mm]", values=lambda rollout: _lowest_mm(rollout, foot)),
    )


def _rebound(foot: FootGeometry) -> Phenomenon:
    def read(rollout: Rollout) -> PhenomenonValue:
        heights = _lowest_mm(rollout, foot)
        landed = int(np.argmin(heights))
        hop = max(float(heights[landed:].max()), 0.0)
        return PhenomenonValue(value=float(np.sqrt(hop / (1e3 * DROP_M))))

    return Phenomenon(
        id="foot-rebound",
        title="foot of the robot: speed after a landing over that before",
        quantity="rebound",
        scenario=_landing(foot),
        unit="1",
        reality=Reality.law(
            0.0,
            tolerance=HOP,
            source=_source("a foot that steps stays on the ground", foot),
            rationale=f"a hop of {1e3 * HOP**2 * DROP_M:.0f} mm, which the eye sees",
        ),
        is_impact=True,
        needs_foot=True,
        read=read,
        trace=Trace(label="height of the lowest sole [mm]", values=lambda rollout: _lowest_mm(rollout, foot)),
    )


def _rest(foot: FootGeometry) -> Phenomenon:
    def read(rollout: Rollout) -> PhenomenonValue:
        moving = np.flatnonzero(np.abs(rollout.velocity(FOOT)[:, 2]) > AT_REST_M_PER_S)
        last = float(rollout.times_s[moving[-1]]) if len(moving) else 0.0
        failure = "it still moves at the end" if last > rollout.times_s[-1] - STILL_S else ""
        return PhenomenonValue(value=max(last - _fall_s(), 0.0), failure=failure)

    return Phenomenon(
        id="foot-rest",
        title="foot of the robot: time from a landing to rest",
        quantity="time",
        scenario=_landing(foot),
        unit="s",
        reality=Reality.law(
            0.0,
            tolerance=STANCE_S,
            source=_source("a foot that steps stays on the ground", foot),
            rationale="the stance of a trot; a foot that lands longer never rests before the next step",
        ),
        needs_foot=True,
        read=read,
        trace=Trace(label="height of the lowest sole [mm]", values=lambda rollout: _lowest_mm(rollout, foot)),
    )


def with_foot(phenomenon: Phenomenon, foot: FootGeometry | None) -> Phenomenon:
    """Return a row with the foot of a target; rows on other objects are unchanged."""
    if foot is None or not phenomenon.needs_foot:
        return phenomenon
    return next(one for one in foot_phenomena(foot) if one.id == phenomenon.id)
