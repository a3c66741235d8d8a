"""Laws of deformable bodies for one body with a fixed clamp."""

from gauge_envs.backends import backend
from gauge_envs.tools.conformance import cloth, foam, rope
from gauge_envs.tools.conformance.deformable import equilibrium
from gauge_envs.tools.conformance.lab import Lab

SHEARED_FABRIC = cloth.fabric(0.25, 27.5, 5e-5)
LAWS = {
    "cloth-bending": (
        cloth.cantilever_strip(cloth.BENT_FABRIC),
        cloth.strip_stiffness,
        0.35,
    ),
    "cloth-stretch": (
        cloth.hanging_strip(cloth.LIGHT_FABRIC),
        cloth.stretch_stiffness,
        0.2,
    ),
    "cloth-shear": (cloth.upright_sheet(SHEARED_FABRIC), cloth.shear_stiffness, 0.15),
    "foam-tension": (foam.hanging_bar(foam.BAR, 0.0), foam.young, 0.25),
    "foam-poisson": (foam.hanging_bar(foam.BAR, 0.0), foam.poisson, 0.25),
    "rod-bending": (rope.clamped_rod(rope.BENT_RODS[0]), rope.rod_stiffness, 0.3),
}
"""Scene, law, and settling time [s]."""


def ratio_at_rest(engine, check, settings=None):
    """Return the ratio of measured to expected for the first body of a check with a fixed frame."""
    scene, law, settled_s = LAWS[check]
    rollout = Lab(backend(engine), settings).rollout(scene)
    (body,) = scene.deformables
    measured = law(equilibrium(rollout, body.name, settled_s))
    return measured.measured / measured.expected
