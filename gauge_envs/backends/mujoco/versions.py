"""Differences between the versions of MuJoCo that the backend runs with: 3.11 to 4.

Every setting and every kind of body that an older version lacks is declared here, and nowhere else.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import mujoco

from gauge_envs.errors import ParameterError
from gauge_envs.names import first_names
from gauge_envs.scene import Scene

DEFORMABLES_SINCE = 4
"""First major version whose deformable bodies have the constants that this backend sets."""


@dataclass(frozen=True, kw_only=True)
class Feature:
    """A setting, or one value of it, that some supported versions of MuJoCo lack.

    Attributes:
        setting: Name of the setting.
        value: The value; None when the whole setting is absent.
        enumeration: Name of MuJoCo's enumeration that holds its constant.
        constant: Name of the constant, which shows whether the installed version has the feature.
        since: First version that has it.
    """

    setting: str
    value: str | None = None
    enumeration: str
    constant: str
    since: str

    @property
    def is_installed(self) -> bool:
        """Whether the installed version has it."""
        return hasattr(getattr(mujoco, self.enumeration), self.constant)


FEATURES = (
    Feature(
        setting="integrator",
        value="discrete",
        enumeration="mjtIntegrator",
        constant="mjINT_DISCRETE",
        since="3.13",
    ),
    Feature(
        setting="speculative",
        enumeration="mjtEnableBit",
        constant="mjENBL_SPECULATIVE",
        since="4.0",
    ),
)


UNSTEADY_BOXES = frozenset({"3.11.0"})
"""Releases whose box contacts jump: a tower of twenty boxes sways or falls, even without this package."""

FAULTY_SPARSE = frozenset({"4.0.0"})
"""Releases whose Newton solver leaves forces in some sparse models (google-deepmind/mujoco#3767)."""


def sparse_advice(model: mujoco.MjModel) -> str:
    """Return the advice for a model that the installed release may solve wrongly; empty for other models."""
    is_newton = model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
    if mujoco.__version__ in FAULTY_SPARSE and is_newton and mujoco.mj_isSparse(model):
        return (
            f"MuJoCo {mujoco.__version__} solves some sparse models wrongly: set "
            '<option jacobian="dense"/>'
        )
    return ""


def constants_of(enumeration: str, names: Mapping[str, str]) -> dict[str, Any]:
    """Return the constants of an enumeration that the installed version has, by the name of a setting's value.

    Args:
        enumeration: Name of MuJoCo's enumeration.
        names: Name of the constant, by the name that this package gives it.
    """
    members = getattr(mujoco, enumeration)
    return {
        name: getattr(members, constant)
        for name, constant in names.items()
        if hasattr(members, constant)
    }


def without_absent(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that the installed version has; the others have no effect."""
    absent = {
        feature.setting
        for feature in FEATURES
        if feature.value is None and not feature.is_installed
    }
    return {name: value for name, value in settings.items() if name not in absent}


def check_installed(chosen: Mapping[str, Any], changes: Mapping[str, Any]) -> None:
    """Raise an error for a setting or a value that the installed version lacks.

    Args:
        chosen: All settings, of the preset and the user.
        changes: Settings that the user gives.
    """
    for feature in FEATURES:
        if feature.is_installed:
            continue
        if feature.value is None and feature.setting in changes:
            what, fix = "does not have it", "leave it out"
        elif feature.value is not None and chosen[feature.setting] == feature.value:
            what, fix = f"has no value {feature.value!r}", "choose another value"
        else:
            continue
        raise ParameterError(
            f"MuJoCo setting {feature.setting!r}: the installed MuJoCo {mujoco.__version__} {what}, since it came with "
            f"MuJoCo {feature.since}: {fix}, or install a later version"
        )


def without_deformables(scene: Scene) -> Iterator[str]:
    """Yield the reason why the installed version cannot simulate the deformable bodies of a scene."""
    if scene.deformables and int(mujoco.__version__.split(".")[0]) < DEFORMABLES_SINCE:
        names = first_names([repr(body.name) for body in scene.deformables], 3)
        yield (
            f"deformable bodies ({names}) need MuJoCo {DEFORMABLES_SINCE}, whose constants for them differ from "
            f"those of the installed MuJoCo {mujoco.__version__}: install mujoco>={DEFORMABLES_SINCE}"
        )
