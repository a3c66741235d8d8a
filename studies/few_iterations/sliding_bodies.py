"""Bodies that slide on a plane of MuJoCo, with the options of its solver; `few_iterations.py` measures them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

G = 9.81
SETTLE_S = 0.3
"""Time in which a body comes to rest with a converged solver [s]."""

CONVERGED_ITERATIONS, CONVERGED_LS = 100, 50


@dataclass(frozen=True)
class Options:
    """Options of MuJoCo, with the values of MuJoCo Playground's Go1 and Spot as defaults."""

    timestep: float = 0.004
    iterations: int = 1
    ls_iterations: int = 5
    cone: str = "pyramidal"
    impratio: float = 1.0
    solver: str = "Newton"
    integrator: str = "Euler"
    warmstart: bool = True
    eulerdamp: bool = False
    solref: str = "0.02 1"
    solimp: str = "0.9 0.95 0.001 0.5 2"

    @property
    def converged(self) -> Options:
        """The same options with enough iterations."""
        return replace(
            self, iterations=CONVERGED_ITERATIONS, ls_iterations=CONVERGED_LS
        )


FREE = "<freejoint/>"


@dataclass(frozen=True)
class Body:
    """A body on the ground: geoms, mass [kg], height of the centre [m], sliding friction, and degrees of freedom."""

    geoms: str
    mass: float
    height: float
    friction: float
    joints: str = FREE


UPRIGHT = "".join(
    f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1")
)
FEET = "".join(
    f'<geom type="sphere" size="0.023" pos="{x} {y} -0.247" mass="0"/>'
    for x in (-0.19, 0.19)
    for y in (-0.13, 0.13)
)


def cube(mass: float = 0.1, friction: float = 0.6, joints: str = FREE) -> Body:
    """Return a cube of 5 cm, which has four contacts."""
    return Body(
        f'<geom type="box" size="0.025 0.025 0.025" mass="{mass}"/>',
        mass,
        0.025,
        friction,
        joints,
    )


def sphere(mass: float = 0.1, friction: float = 0.6, joints: str = UPRIGHT) -> Body:
    """Return a sphere, which has one contact."""
    return Body(
        f'<geom type="sphere" size="0.025" mass="{mass}"/>',
        mass,
        0.025,
        friction,
        joints,
    )


def feet(mass: float = 12.0, friction: float = 0.6, joints: str = FREE) -> Body:
    """Return a trunk on four rigid spherical feet of the size of Go1's."""
    trunk = f'<geom type="box" size="0.18 0.05 0.05" mass="{mass}" contype="0" conaffinity="0"/>'
    return Body(trunk + FEET, mass, 0.27, friction, joints)


@lru_cache
def model_of(body: Body, options: Options) -> mujoco.MjModel:
    """Return a body on a plane."""
    o = options
    warmstart, eulerdamp = (
        "enable" if flag else "disable" for flag in (o.warmstart, o.eulerdamp)
    )
    return mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <option timestep="{o.timestep}" iterations="{o.iterations}" ls_iterations="{o.ls_iterations}" cone="{o.cone}"
              impratio="{o.impratio}" solver="{o.solver}" integrator="{o.integrator}">
        <flag warmstart="{warmstart}" eulerdamp="{eulerdamp}"/>
      </option>
      <default>
        <geom friction="{body.friction} 0 0" solref="{o.solref}" solimp="{o.solimp}" condim="3"/>
      </default>
      <worldbody>
        <geom type="plane" size="50 50 1"/>
        <body pos="0 0 {body.height}">{body.joints}{body.geoms}</body>
      </worldbody>
    </mujoco>""")


@lru_cache
def rest(
    body: Body, options: Options, slope: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return positions and accelerations of a body at rest on level ground, with the normal load of a slope [rad]."""
    model = model_of(body, options.converged)
    model.opt.gravity[:] = 0.0, 0.0, -G * np.cos(slope)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=round(SETTLE_S / options.timestep))
    return data.qpos.copy(), data.qacc_warmstart.copy()


def at_rest(body: Body, options: Options) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return a model and its state at rest."""
    model = model_of(body, options)
    model.opt.gravity[:] = 0.0, 0.0, -G
    data = mujoco.MjData(model)
    data.qpos[:], data.qacc_warmstart[:] = rest(body, options)
    return model, data
