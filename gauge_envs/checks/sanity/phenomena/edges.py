"""Sharp edges: a tetrahedron on the face that it completes, a pyramid that falls point first."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from gauge_envs.checks.sanity.model import Reality
from gauge_envs.checks.sanity.phenomena.facts import RECORDINGS, facts, placing_scatter_mm, recorded
from gauge_envs.checks.sanity.phenomena.kit import FloatArray, Phenomenon, PhenomenonValue, Trace
from gauge_envs.checks.sanity.scenario import Rollout, Scenario
from gauge_envs.scene import ConvexUnion

__all__ = [
    "phenomena",
]

SEAM_S = (0.04, 0.18)
"""Between settling and the moment when a third of the tetrahedron's face has left the block."""

FALL_S = 10 / 30
"""The published frames of the pyramid [s]."""


def phenomena() -> Iterator[Phenomenon]:
    """Slide down the seam, depth of the point."""
    yield _seam()
    yield _point()


def _seam() -> Phenomenon:
    stage = Scenario(name="seam", variant="SlopeContact-wood", seconds=SEAM_S[1])
    scene = stage.scene
    layout = facts("recordings/recordings")["layouts"]["seam"]["coordinates"][0]
    seam = np.array(layout["direction"])
    friction = next(c.friction for c in scene.contacts if "base" in c.second)
    law = scene.gravity_m_per_s2 * float(-seam[2] - friction * np.hypot(seam[0], seam[1]))
    real = recorded("slope_contact", "slide_acceleration_m_per_s2")

    def way_mm(run: Rollout) -> FloatArray:
        return np.asarray(1e3 * (run.position("teh") - run.position("teh")[0]) @ seam)

    def read(run: Rollout) -> PhenomenonValue:
        part = run.between(*SEAM_S)
        return PhenomenonValue(value=2e-3 * float(np.polyfit(run.times_s[part], way_mm(run)[part], 2)[0]))

    return Phenomenon(
        id="seam",
        title="sharp edges: tetrahedron slides down its seam",
        quantity="acceleration",
        stage=stage,
        unit="m/s^2",
        reality=Reality(
            value=law,
            scatter=real["sigma"],
            source=f"Coulomb with the calibrated mu = {friction:.3f}; scatter: of the recorded slide, "
            f"{real['value']:.1f} m/s^2 ({RECORDINGS})",
        ),
        read=read,
        trace=Trace(label="way down the seam [mm]", values=way_mm),
    )


def _point() -> Phenomenon:
    stage = Scenario(name="point", variant="NonsmoothContact-1-wood", seconds=FALL_S)

    def depth_mm(run: Rollout) -> FloatArray:
        return _depths_mm(run, "pyramid", "squarebase")

    scatter, origin = placing_scatter_mm()
    return Phenomenon(
        id="point",
        title="sharp edges: how deep a falling point sinks into the base",
        quantity="depth",
        stage=stage,
        unit="mm",
        reality=Reality(value=0.0, scatter=scatter, source=f"rigid bodies do not overlap; scatter: {origin}"),
        read=lambda run: PhenomenonValue(value=float(depth_mm(run).max())),
        trace=Trace(label="depth of the point [mm]", values=depth_mm, is_level=True),
    )


def _depths_mm(run: Rollout, body: str, fixed: str) -> FloatArray:
    """Depth of the deepest vertex of a body in a fixed one [mm], shape [sample_count]."""
    shape, solid = run.scene.body(body).shape, run.scene.body(fixed).shape
    assert isinstance(solid, ConvexUnion)
    states = run.states[body]
    turn = Rotation.from_quat(states[:, 3:7], scalar_first=True).as_matrix()
    vertices = np.einsum("tij,vj->tvi", turn, shape.corners_m) + states[:, None, :3]
    places = run.scene.body(fixed).pose.to_body(vertices.reshape(-1, 3))
    depth = np.zeros(len(places))
    for piece in solid.pieces_m:
        planes = ConvexHull(np.asarray(piece)).equations
        depth = np.maximum(depth, -(places @ planes[:, :3].T + planes[:, 3]).max(axis=1))
    return np.asarray(1e3 * depth.reshape(vertices.shape[:2]).max(axis=1))
