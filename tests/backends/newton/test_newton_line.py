"""Segments of ropes and rods in Newton."""

import numpy as np
import pytest
from foam import held

from gauge_envs.scene import Motion, Pose, Rod

newton = pytest.importorskip("newton")

from gauge_envs.backends.newton.line import add_line  # noqa: E402
from gauge_envs.backends.newton.settings import SettingsLines  # noqa: E402


def test_segments_have_the_mass_and_inertia_of_their_pieces():
    free_m, depth_m, radius_m, mass_kg = 0.15, 0.03, 0.005, 0.0149
    rod = Rod(
        name="rod",
        pose=Pose(position_m=(0.0, 0.0, 0.5 * (depth_m - free_m))),
        length_m=free_m + depth_m,
        radius_m=radius_m,
        mass_kg=mass_kg,
        young_modulus_pa=9285115.0,
        poisson_ratio=0.49,
    )
    grip = held("high", Motion.FIXED, depth_m, body="top")
    settings = SettingsLines(preset="bench", timestep_s=1 / 3600)
    builder = newton.ModelBuilder()
    part = add_line(
        builder, rod, attachments=[grip], bodies={"top": -1}, settings=settings
    )
    masses = np.array(builder.body_mass)
    assert masses == pytest.approx(mass_kg * free_m / (free_m + depth_m) / 8)
    inertia = np.array(builder.body_inertia[0]).reshape(3, 3)
    across = (3 * radius_m**2 + (free_m / 8) ** 2) / 12
    assert np.diag(inertia) == pytest.approx(
        masses[0] * np.array([across, across, 0.5 * radius_m**2])
    )
    # The tip in the grip is a node, too.
    nodes_m = [*np.linspace(-free_m, 0.0, 9), depth_m]
    assert part.rest_m[:, 2] == pytest.approx(nodes_m)
    assert part.pins == ()
