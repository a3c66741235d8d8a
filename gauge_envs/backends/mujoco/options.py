"""MuJoCo's options and flags under the names of the settings, written to a model and read from it."""

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco


def constants_of(enumeration: Any, prefix: str, names: Sequence[str]) -> dict[str, int]:
    """Return the constants of an enumeration that the installed MuJoCo has, by name.

    Args:
        enumeration: MuJoCo's enumeration.
        prefix: Start of the names of its constants; the name in upper case follows.
        names: Names in MJCF.
    """
    constants = {name: f"{prefix}{name.upper()}" for name in names}
    return {
        name: int(getattr(enumeration, constant))
        for name, constant in constants.items()
        if hasattr(enumeration, constant)
    }


NAMED_OPTIONS = {
    "integrator": constants_of(
        mujoco.mjtIntegrator,
        "mjINT_",
        ("Euler", "RK4", "implicit", "implicitfast", "discrete"),
    ),
    "cone": constants_of(mujoco.mjtCone, "mjCONE_", ("pyramidal", "elliptic")),
    "solver": constants_of(mujoco.mjtSolver, "mjSOL_", ("PGS", "CG", "Newton")),
}
"""MuJoCo's constants of each option that has a name."""
DISABLE_FLAGS = constants_of(
    mujoco.mjtDisableBit,
    "mjDSBL_",
    ("warmstart", "refsafe", "eulerdamp", "nativeccd", "multiccd", "island"),
)
"""MuJoCo's disable bit of each setting that is on by default."""
ENABLE_FLAGS = constants_of(
    mujoco.mjtEnableBit, "mjENBL_", ("diagexact", "sleep", "speculative")
)
"""MuJoCo's enable bit of each setting that is off by default."""
OVERRIDE = int(mujoco.mjtEnableBit.mjENBL_OVERRIDE)
"""Enable bit that gives all contacts the same constants."""
SAME_NAME_OPTIONS = (
    "impratio",
    "iterations",
    "tolerance",
    "ls_iterations",
    "ls_tolerance",
    "noslip_iterations",
    "noslip_tolerance",
    "ccd_iterations",
    "ccd_tolerance",
    "sleep_tolerance",
)
"""Settings that have the name of their MuJoCo option."""


def set_option(option: Any, name: str, value: Any) -> None:
    """Set an option or a flag of a model by the name of a setting; settings of contacts and scenes change nothing.

    Args:
        option: Options of a compiled model, or of its spec.
        name: Name of the setting.
        value: Its new value; None for `o_friction` restores the constants of each contact.
    """
    if name == "timestep_s":
        option.timestep = value
    elif name in NAMED_OPTIONS:
        setattr(option, name, NAMED_OPTIONS[name][value])
    elif name in SAME_NAME_OPTIONS:
        setattr(option, name, value)
    elif name in DISABLE_FLAGS:
        _set_bit(option, "disableflags", DISABLE_FLAGS[name], is_set=not value)
    elif name in ENABLE_FLAGS:
        _set_bit(option, "enableflags", ENABLE_FLAGS[name], is_set=value)
    elif name == "o_friction" and value is None:
        _set_bit(option, "enableflags", OVERRIDE, is_set=False)


def _set_bit(option: Any, field: str, bit: int, *, is_set: bool) -> None:
    flags = getattr(option, field) & ~bit
    if is_set:
        flags |= bit
    setattr(option, field, flags)


def option_settings(model: mujoco.MjModel) -> dict[str, Any]:
    """Return the settings that reproduce a model's options."""
    option = model.opt
    values: dict[str, Any] = {"timestep_s": float(option.timestep)}
    for name, constants in NAMED_OPTIONS.items():
        values[name] = _name(constants, getattr(option, name))
    for name in SAME_NAME_OPTIONS:
        values[name] = getattr(option, name)
    for name, bit in DISABLE_FLAGS.items():
        values[name] = not option.disableflags & bit
    for name, bit in ENABLE_FLAGS.items():
        values[name] = bool(option.enableflags & bit)
    return values


def overrides_contacts(model: mujoco.MjModel) -> bool:
    """Return whether a model's flag `override` gives all contacts the same constants."""
    return bool(model.opt.enableflags & OVERRIDE)


def _name(constants: Mapping[str, int], value: int) -> str:
    """Return MuJoCo's name of a constant, or its number if this package does not name it."""
    names = {constant: name for name, constant in constants.items()}
    return names.get(value, str(value))
