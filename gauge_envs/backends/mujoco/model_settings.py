"""Read settings of this backend from a compiled MuJoCo model: its options, and the constants of one contact."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.mujoco.contact_pairs import COLUMNS
from gauge_envs.backends.mujoco.model import CONES, DISABLE_FLAGS, ENABLE_FLAGS, INTEGRATORS, SAME_NAME_OPTIONS, SOLVERS
from gauge_envs.backends.mujoco.settings import PRESETS


def option_settings(model: mujoco.MjModel) -> dict[str, Any]:
    """Return the settings that reproduce a model's options."""
    option = model.opt
    values: dict[str, Any] = {
        "timestep_s": float(option.timestep),
        "integrator": _name(INTEGRATORS, option.integrator),
        "cone": _name(CONES, option.cone),
        "solver": _name(SOLVERS, option.solver),
    }
    values |= {name: getattr(option, name) for name in SAME_NAME_OPTIONS}
    values |= {name: not option.disableflags & bit for name, bit in DISABLE_FLAGS.items()}
    return values | {name: bool(option.enableflags & bit) for name, bit in ENABLE_FLAGS.items()}


def overrides_contacts(model: mujoco.MjModel) -> bool:
    """Return whether a model's flag `override` gives all contacts the same constants."""
    return bool(model.opt.enableflags & mujoco.mjtEnableBit.mjENBL_OVERRIDE)


def effective_constants(model: mujoco.MjModel, constants: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return contact constants with zeros for those that `contact_settings` does not use.

    These are constants without effect in the model. Sliding friction is another one, unless the model overrides it,
    since experiments have the friction of real objects.

    Args:
        model: The model.
        constants: Constants in the columns `COLUMNS`, shape [..., 17].
    """
    effective = constants.copy()
    dimension = effective[..., 0]
    friction = effective[..., COLUMNS["friction"]]
    if not overrides_contacts(model):
        friction[..., :2] = 0.0
    friction[..., 2][dimension < 4] = 0.0
    friction[..., 3:][dimension < 6] = 0.0
    if model.opt.cone != mujoco.mjtCone.mjCONE_ELLIPTIC:
        effective[..., COLUMNS["solreffriction"]] = 0.0
    return effective


def contact_settings(model: mujoco.MjModel, constants: NDArray[np.float64]) -> dict[str, Any]:
    """Return the settings that give every contact a pair's constants, without those at their defaults.

    Args:
        model: The model.
        constants: Constants of the pair in the columns `COLUMNS`, shape [17].
    """
    values = {name: constants[columns].tolist() for name, columns in COLUMNS.items()}
    dimension = int(constants[0])
    settings: dict[str, Any] = {"contact_solref": values["solref"], "contact_solimp": values["solimp"]}
    if any(values["solreffriction"]) and model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC:
        settings["contact_solreffriction"] = values["solreffriction"]
    for name in ("margin", "gap"):
        if any(values[name]):
            settings[f"contact_{name}_m"] = values[name][0]
    if dimension != 3:
        settings["condim"] = dimension
    if overrides_contacts(model):
        return settings | {"o_friction": values["friction"]}
    if dimension >= 4:
        settings["torsional_friction_m"] = values["friction"][2]
    if dimension == 6:
        settings["rolling_friction_m"] = values["friction"][3]
    return settings


def default_contact_settings() -> dict[str, Any]:
    """Return the settings that give every contact MuJoCo's defaults."""
    default = PRESETS["out_of_box"].model_dump(mode="json")
    return {name: default[name] for name in ("contact_solref", "contact_solimp")}


def _name(known: Mapping[str, Any], value: int) -> str:
    return next(name for name, constant in known.items() if constant == value)
