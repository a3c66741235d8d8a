"""Training settings and known motions that several tests of the sanity check use."""

import json

import numpy as np

from gauge_envs.tools.bench.recording import Recording

CHEETAH = {
    "timestep_s": 0.01,
    "integrator": "Euler",
    "cone": "pyramidal",
    "impratio": 1.0,
    "contact_solref": (0.02, 1.0),
    "contact_solimp": (0.0, 0.8, 0.01, 0.5, 2.0),
}
"""Numerical settings of Gymnasium's HalfCheetah, feet on ground."""


def moved(scenario, times_s, markers_m=None, **displacements_m):
    """Return a rollout with given markers and displacements of bodies [m], shape [sample_count, 3]; others rest.

    A hyphen in the name of a body is an underscore in the keyword.
    """
    states = {}
    for body in scenario.scene.bodies:
        displacement = displacements_m.get(
            body.name.replace("-", "_"), np.zeros((len(times_s), 3))
        )
        states[body.name] = np.zeros((len(times_s), 13))
        states[body.name][:, :3] = np.asarray(body.pose.position_m) + displacement
        states[body.name][:, 3:7] = body.pose.quaternion
        states[body.name][:, 7:10] = np.gradient(displacement, times_s, axis=0)
    markers = np.zeros((len(times_s), 0, 3)) if markers_m is None else markers_m
    return Recording(
        scene=scenario.scene, times_s=times_s, states=states, markers_m=markers
    )


def read_text(*read):
    """Return what was read of targets as a text to approve."""
    lines = []
    for one in read:
        values = {
            "target": [one.name, one.backend, one.language],
            "frame_skip": one.frame_skip,
            "gravity_m_per_s2": one.gravity_m_per_s2,
            "settings": one.settings,
            "origins": one.origins,
            "contacts": [group.geoms for group in one.contact_groups],
            "notes": one.notes,
        }
        lines.append(json.dumps(values, indent=1))
    return "\n".join(lines)
