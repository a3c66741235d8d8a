"""Training settings and known motions that several tests of the sanity check use."""

import numpy as np

from gauge_envs.fixtures.recording import Recording

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
    """Return a rollout with given markers and displacements of bodies [m], shape [sample_count, 3]; other bodies rest.

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
