"""Read configurations and models of Isaac Lab, ManiSkill, Newton and Genesis."""

from __future__ import annotations

from typing import Any

from gauge_envs.tools.sanity.probe.values import flat, found, is_number, is_of, plain

NEWTON_PREFIXES = ("shape_", "body_", "joint_", "rigid_", "gravity", "up_axis")


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


def newton_model(target: Any) -> Any:
    """Return the model of Newton that a target is or, as a solver, holds; None for any other target."""
    return next((value for value in (target, found(target, "model")) if is_of(value, "newton", "Model")), None)


def capture_newton(target: Any) -> dict[str, Any]:
    """Return constants of a model of Newton, and the numbers that its solver states."""
    model = newton_model(target)
    entries = {name: value for name, value in vars(model).items() if name.startswith(NEWTON_PREFIXES)}
    numbers = {name: value for name, value in entries.items() if is_number(value)}
    solver = None
    if target is not model:
        solver = scalars(target)
    data = {"model": {name: plain(flat(value)) for name, value in numbers.items()}, "solver": solver}
    return {"kind": "newton-model", "engine": "newton", "source": "newton.Model", "data": data}


def capture_genesis(target: Any) -> dict[str, Any]:
    """Return the options of a scene of Genesis, and the materials of its entities."""
    names = [name for name in dir(target) if name.endswith("_options") and not name.startswith("_")]
    options = {name: plain(found(target, name)) for name in names if found(target, name) is not None}
    parts = ("material", "morph")
    entities = [{part: scalars(found(entity, part)) for part in parts} for entity in found(target, "entities") or []]
    data = {"options": options, "entities": entities}
    return {"kind": "genesis-scene", "engine": "genesis", "source": "genesis.Scene", "data": data}


def scalars(value: Any) -> dict[str, Any]:
    """Return the class of an object, and its numbers and texts."""
    named = {name.lstrip("_"): entry for name, entry in getattr(value, "__dict__", {}).items()}
    simple = {name: plain(entry) for name, entry in named.items() if isinstance(entry, (bool, int, float, str))}
    return {"class": type(value).__name__, **simple}
