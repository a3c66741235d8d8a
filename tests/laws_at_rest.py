"""Laws of deformable bodies on one body whose clamp stands still, without the rest of their checks."""

from gauge_envs.backends import backend
from gauge_envs.tools.conformance import cloth, soft
from gauge_envs.tools.conformance.lab import Lab

LAWS = {
    "cloth-bending": (cloth._cantilever_lift, cloth.bending_stiffness),
    "cloth-stretch": (cloth._hanging_lift, cloth.stretch_stiffness),
    "cloth-shear": (cloth._shear_lift, cloth._shear_stiffness),
    "foam-tension": (soft._foam_lift, soft._young),
    "foam-poisson": (soft._foam_lift, soft._poisson),
    "rod-bending": (soft._rod_lift, soft._rod_stiffness),
}


def ratio_at_rest(engine, check, settings=None):
    """Ratio of measured to expected for the first body of a check, while its frame stands still."""
    lift, measure = LAWS[check]
    rollout = Lab(backend(engine), settings).rollout(lift.scene, lift.still_s)
    found = measure(lift.at_rest(rollout))
    return found.measured / found.expected
