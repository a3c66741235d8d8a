"""Sharp edges: a tetrahedron that slides down a seam, and a pyramid that falls on its tip."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull

from gauge_envs.runs.rollout import Rollout
from gauge_envs.scene import ConvexUnion
from gauge_envs.tools.sanity.model import Reality
from gauge_envs.tools.sanity.phenomena.facts import RECORDINGS, facts, recorded, rigid_tolerance
from gauge_envs.tools.sanity.phenomena.phenomenon import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.tools.sanity.scenario import Scenario

SEAM_S = (0.04, 0.18)
"""Time between settling and the moment when a third of the tetrahedron's face has left the block [s]."""

FALL_S = 10 / 30
"""Time of the published frames of the pyramid [s]."""


def phenomena() -> Iterator[Phenomenon]:
    """Yield the slide down the seam and the depth of the tip."""
    yield _seam()
    yield _point()


def _seam() -> Phenomenon:
    scenario = Scenario(name="seam", variant="SlopeContact-wood", seconds=SEAM_S[1])
    layout = facts("recordings/recordings")["layouts"]["seam"]["coordinates"][0]
    seam = np.array(layout["direction"])
    friction = next(c.friction for c in scenario.scene.contacts if "base" in c.second)
    real = recorded("slope_contact", "slide_acceleration_m_per_s2")

    def slid_mm(rollout: Rollout) -> FloatArray:
        return np.asarray(1e3 * rollout.displacement("teh") @ seam)

    def read(rollout: Rollout) -> PhenomenonValue:
        part = rollout.between(*SEAM_S)
        return PhenomenonValue(value=2e-3 * float(np.polyfit(rollout.times_s[part], slid_mm(rollout)[part], 2)[0]))

    return Phenomenon(
        id="seam",
        title="sharp edges: tetrahedron slides down its seam",
        quantity="acceleration",
        scenario=scenario,
        unit="m/s^2",
        reality=Reality.measured(
            real["value"],
            scatter=real["sigma"],
            trial_count=1,
            source=f"one recorded slide ({RECORDINGS}); the tetrahedron has the calibrated mu = {friction:.3f}",
        ),
        needs_friction=True,
        read=read,
        trace=Trace(label="displacement down the seam [mm]", values=slid_mm),
    )


def _point() -> Phenomenon:
    scenario = Scenario(name="point", variant="NonsmoothContact-1-wood", seconds=FALL_S)

    def depth_mm(rollout: Rollout) -> FloatArray:
        return _depths_mm(rollout, "pyramid", "squarebase")

    return Phenomenon(
        id="point",
        title="sharp edges: penetration of a falling tip into the base",
        quantity="depth",
        scenario=scenario,
        unit="mm",
        reality=Reality.law(
            0.0, source="rigid bodies do not overlap", **rigid_tolerance(1.0, "the height of 75 mm of the pyramid")
        ),
        read=lambda rollout: PhenomenonValue(value=float(depth_mm(rollout).max())),
        trace=Trace(label="depth of the tip [mm]", values=depth_mm, is_level=True),
    )


def _depths_mm(rollout: Rollout, body: str, fixed: str) -> FloatArray:
    """Return the depth of a body's deepest vertex in a fixed body [mm], shape [sample_count]."""
    shape, solid = rollout.scene.body(body).shape, rollout.scene.body(fixed).shape
    assert isinstance(solid, ConvexUnion)
    rotations = rollout.rotation(body).as_matrix()
    vertices = np.einsum("tij,vj->tvi", rotations, shape.corners_m) + rollout.position(body)[:, None]
    places = rollout.scene.body(fixed).pose.to_body(vertices.reshape(-1, 3))
    depth = np.zeros(len(places))
    for piece in solid.pieces_m:
        planes = ConvexHull(np.asarray(piece)).equations
        depth = np.maximum(depth, -(places @ planes[:, :3].T + planes[:, 3]).max(axis=1))
    return np.asarray(1e3 * depth.reshape(vertices.shape[:2]).max(axis=1))
