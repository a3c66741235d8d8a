"""Imitations of MuJoCo Playground's and mjlab's classes, with the parts that a sanity check reads."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import mujoco

DOG = """<mujoco model="dog"><option iterations="1" ls_iterations="5" ccd_iterations="20" timestep="{step}"/>
  <worldbody><geom name="floor" type="plane" size="0 0 .01" contype="1" conaffinity="0" priority="1" friction=".6"/>
    <body name="trunk" pos="0 0 .11"><freejoint/><inertial pos="0 0 0" mass="5" diaginertia=".1 .1 .1"/>
      <geom name="a" size=".02" contype="0" pos=".2 .1 -.1"/><geom name="b" size=".02" contype="0" pos=".2 -.1 -.1"/>
      <geom name="c" size=".02" contype="0" pos="-.2 .1 -.1"/><geom name="d" size=".02" contype="0" pos="-.2 -.1 -.1"/>
    </body></worldbody></mujoco>"""
"""A trunk with four feet on a floor that has priority."""

ROBOT = '<mujoco><worldbody><body pos="0 0 .2"><freejoint/><geom name="foot" size=".1"/></body></worldbody></mujoco>'


def playground_env(model=None, *, substeps=5, **config):
    """Return an environment of Playground with a model, that of `DOG` if None, and a configuration."""
    kind = type("Walk", (), {"__module__": "mujoco_playground.env"})
    env = kind()
    env.mj_model = (
        mujoco.MjModel.from_xml_string(DOG.format(step=0.004))
        if model is None
        else model
    )
    env._config, env.n_substeps = config, substeps
    return env


@dataclass
class MujocoCfg:
    """Options by mjlab's names, which it writes into a compiled model."""

    timestep: float = 0.002
    options: dict[str, Any] = field(default_factory=dict)

    def __init__(self, **options):
        self.options = options

    def apply(self, model):
        types = {
            "integrator": "mjtIntegrator",
            "cone": "mjtCone",
            "solver": "mjtSolver",
        }
        starts = {"integrator": "mjINT", "cone": "mjCONE", "solver": "mjSOL"}
        bits = {
            "disableflags": mujoco.mjtDisableBit,
            "enableflags": mujoco.mjtEnableBit,
        }
        for name, value in self.options.items():
            if name in types:
                known = getattr(mujoco, types[name]).__members__
                (value,) = (
                    one
                    for key, one in known.items()
                    if key.lower() == f"{starts[name]}_{value}".lower()
                )
            if name in bits:
                start = "mjDSBL_" if name == "disableflags" else "mjENBL_"
                value = sum(
                    int(getattr(bits[name], start + flag.upper())) for flag in value
                )
            setattr(model.opt, name, value)


@dataclass
class SimulationCfg:
    """Limits of one world, and options."""

    njmax: int | None = None
    nconmax: int | None = None
    mujoco: MujocoCfg = field(default_factory=MujocoCfg)


@dataclass
class CollisionCfg:
    """Constants of the robot's geoms."""

    constants: dict[str, Any] = field(default_factory=dict)

    def __init__(self, **constants):
        self.constants = constants


@dataclass
class Part:
    """Any other class, with its attributes."""

    def __init__(self, **attributes):
        vars(self).update(attributes)


def mjlab_task(sim=None, collision=None, *, observed=0, acted=0):
    """Return a task configuration of mjlab with lags of its observations and its actuators."""
    kind = type("Task", (Part,), {"__module__": "mjlab.tasks.cfg"})
    robot = Part(
        articulation=Part(actuators=[Part(delay_max_lag=acted)] if acted else [])
    )
    terms = {"gyro": Part(delay_max_lag=observed), "joints": Part()} if observed else {}
    return kind(
        decimation=4,
        scene=Part(entities={"robot": robot}, collision=collision or CollisionCfg()),
        sim=sim or SimulationCfg(),
        observations={"actor": Part(terms=terms)},
    )


class Scene:
    """A ground plane and a ball, compiled by MuJoCo."""

    def __init__(self, cfg, device):
        assert device == "cpu"
        self._constants = cfg.collision.constants

    def compile(self):
        spec = mujoco.MjSpec()
        spec.worldbody.add_geom(
            name="terrain", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0.0, 0.0, 0.01)
        )
        robot = mujoco.MjSpec.from_string(ROBOT)
        (foot,) = robot.geoms
        foot.priority = 1
        for name, value in self._constants.items():
            if isinstance(value, tuple):
                getattr(foot, name)[: len(value)] = value
            else:
                setattr(foot, name, value)
        spec.attach(robot, prefix="robot/", frame=spec.worldbody.add_frame())
        return spec.compile()


def install_mjlab(monkeypatch):
    """Let `mjlab.scene` be importable, as in mjlab's own Python."""
    module = ModuleType("mjlab.scene")
    module.Scene = Scene
    monkeypatch.setitem(sys.modules, "mjlab", ModuleType("mjlab"))
    monkeypatch.setitem(sys.modules, "mjlab.scene", module)
