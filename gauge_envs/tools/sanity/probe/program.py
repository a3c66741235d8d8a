"""Write the physics settings that a policy is trained with to a file that `gauge sanity` reads elsewhere.

Run this file in the training environment. It needs Python 3.8 or later, and nothing of gauge-envs.

    python gauge_probe.py HalfCheetah-v5
    python gauge_probe.py robot/scene.xml --out robot.gaugeprobe.json
    python gauge_probe.py logs/rsl_rl/anymal/params/env.yaml
    python gauge_probe.py my_package.robots:make_model
    python gauge_probe.py "mujoco_playground:registry.load('CheetahRun')"
    python gauge_probe.py "mjlab.tasks.registry:load_env_cfg('Mjlab-Velocity-Flat-Unitree-Go1')"
    python gauge_probe.py "dm_control.suite:load('walker', 'walk')"
    python gauge_probe.py "mani_skill.envs.tasks:PickCubeEnv"

`MODULE:EXPRESSION` is Python, evaluated in that module; what can be called without arguments is called. A program that
has the environment, model or configuration already writes it itself:

    import gauge_probe

    gauge_probe.save(env, "robot.gaugeprobe.json")
"""

import argparse
import importlib
import json
import os
import platform
import re
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from gauge_envs.tools.sanity.probe.mujoco_capture import capture_mujoco, mujoco_model
from gauge_envs.tools.sanity.probe.values import ProbeError, found, is_of, plain

FORMAT, VERSION = "gauge-probe", 2

SUFFIX = ".gaugeprobe.json"

MOST_BYTES = 16 * 10**6

PACKAGES = (
    *("numpy", "mujoco", "mujoco-mjx", "mujoco-warp", "warp-lang", "jax", "torch", "gymnasium", "dm_control"),
    *("playground", "mjlab", "isaaclab", "isaacsim", "mani_skill", "sapien", "newton", "genesis-world"),
)
"""Packages whose versions are written if they are installed."""


def isaaclab_cfg(target: Any) -> Any:
    """Return the configuration of an environment of Isaac Lab; None for any other target."""
    for value in (target, found(target, "cfg"), found(target, "unwrapped.cfg")):
        if found(value, "sim.physx") is not None or found(value, "sim.physics_material") is not None:
            return value
    return None


def capture_isaaclab(target: Any) -> dict[str, Any]:
    """Return the configuration as Isaac Lab writes it to `env.yaml`; IsaacGym's has other keys."""
    cfg = isaaclab_cfg(target)
    if found(cfg, "sim.physx.num_position_iterations") is not None:
        return {"kind": "isaacgym-cfg", "engine": "physx", "source": "IsaacGym", "data": {"cfg": plain(cfg)}}
    entries = cfg.to_dict() if callable(getattr(cfg, "to_dict", None)) else cfg
    source = f"Isaac Lab, {type(cfg).__name__}"
    return {"kind": "isaaclab-cfg", "engine": "physx", "source": source, "data": {"cfg": plain(entries)}}


def maniskill_config(target: Any) -> Any:
    """Return the SimConfig of an environment of ManiSkill or of its class; None for any other target."""
    for value in (target, found(target, "sim_config"), found(target, "unwrapped.sim_config")):
        if is_of(value, "mani_skill", "SimConfig"):
            return value
    default = found(target, "_default_sim_config") if isinstance(target, type) else None
    default = default.__get__(object()) if isinstance(default, property) else default
    return default if is_of(default, "mani_skill", "SimConfig") else None


def capture_maniskill(target: Any) -> dict[str, Any]:
    """Return the fields of ManiSkill's SimConfig."""
    data = {"sim_config": plain(maniskill_config(target))}
    return {"kind": "maniskill-sim-config", "engine": "physx", "source": "ManiSkill, SimConfig", "data": data}


CAPTURES: Any = (
    (lambda target: mujoco_model(target) is not None, capture_mujoco),
    (lambda target: isaaclab_cfg(target) is not None, capture_isaaclab),
    (lambda target: maniskill_config(target) is not None, capture_maniskill),
)
"""What can be captured: whether a target is of a kind, and the function that returns its entries of the file."""


def document(target: Any, name: str = "") -> dict[str, Any]:
    """Return the content of the file for an environment, a model or a configuration."""
    head = {"format": FORMAT, "version": VERSION, "name": name or type(target).__qualname__, "versions": versions()}
    if isinstance(target, str):
        data = {"env_yaml": target}
        return {**head, "kind": "isaaclab-cfg", "engine": "physx", "source": "Isaac Lab, env.yaml", "data": data}
    capture = next((capture for matches, capture in CAPTURES if matches(target)), None)
    if capture is None:
        kind = f"{type(target).__module__}.{type(target).__qualname__}"
        raise ProbeError(f"{kind} holds no model or configuration that is known: give the model itself")
    return {**head, **capture(target)}


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that are installed here."""
    installed = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            installed[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return installed


def save(target: Any, file: str, name: str = "") -> None:
    """Write an environment, a model or a configuration to a file for `gauge sanity`."""
    content = json.dumps(document(target, name), allow_nan=False, separators=(",", ": ")).encode()
    if len(content) > MOST_BYTES:
        raise ProbeError(f"the file would have {len(content)} bytes, the limit is {MOST_BYTES}")
    part = Path(f"{file}.{os.getpid()}.tmp")
    part.write_bytes(content)
    part.replace(file)


def resolve(text: str) -> Any:
    """Return the object that a text names: a file, a Gymnasium id, or `MODULE:EXPRESSION`."""
    suffix = Path(text).suffix.lower()
    if suffix in (".yaml", ".yml"):
        return Path(text).read_text(encoding="utf-8")
    if suffix in (".xml", ".mjcf", ".urdf", ".mjb"):
        import mujoco

        return (mujoco.MjModel.from_binary_path if suffix == ".mjb" else mujoco.MjModel.from_xml_path)(text)
    module, colon, expression = text.partition(":")
    if colon and not re.search(r"-v\d+$", text):
        value = eval(expression, dict(vars(importlib.import_module(module))))
        is_plain_class = isinstance(value, type) and maniskill_config(value) is None
        return value() if is_plain_class or type(value).__name__ in ("function", "method", "partial") else value
    import gymnasium

    return gymnasium.make(text)


def main() -> None:
    """Write the file for the target of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", help="file, Gymnasium id, or MODULE:EXPRESSION")
    parser.add_argument("--out", help=f"file to write, NAME{SUFFIX} by default")
    options = parser.parse_args()
    sys.path.insert(0, str(Path.cwd()))
    name = Path(options.target).name if Path(options.target).is_file() else options.target
    file = options.out or re.sub(r"[^\w.-]+", "_", name).strip("_") + SUFFIX
    try:
        save(resolve(options.target), file, name)
    except ProbeError as error:
        sys.exit(f"error: {options.target}: {error}")
    print(file)


if __name__ == "__main__":
    main()
