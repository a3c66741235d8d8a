"""Sheets of the measured fabrics, for the tests of several engines."""

from __future__ import annotations

from dataclasses import replace

from foam import ORIGIN

from gauge_envs import load_experiment

CELL_M = 0.025


def fabric(name, size_m, pose=ORIGIN):
    """Return a sheet of a measured fabric."""
    cloth = load_experiment(f"TextileFlinging-{name}").scene.deformables[0]
    return replace(cloth, size_m=size_m, pose=pose)
