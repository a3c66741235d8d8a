"""Differences between the versions of MuJoCo that the backend runs with: 3.11 to 4.

Every setting and every kind of body that an older version lacks is declared here, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from gauge_envs.errors import ParameterError
from gauge_envs.names import first_names
from gauge_envs.scene import Scene

if TYPE_CHECKING:
    import mujoco

DEFORMABLES_SINCE = "4.0"
"""First version whose deformable bodies have the constants that this backend sets."""


@dataclass(frozen=True, kw_only=True)
class LaterSetting:
    """A setting, or one value of it, that some supported versions of MuJoCo lack.

    Attributes:
        setting: Name of the setting.
        value: The value; None when the whole setting is absent.
        since: First version that has it.
    """

    setting: str
    value: str | None = None
    since: str

    @property
    def is_installed(self) -> bool:
        """Whether the installed version has it."""
        return _release(_installed()) >= _release(self.since)


LATER_SETTINGS = (
    LaterSetting(setting="integrator", value="discrete", since="3.13"),
    LaterSetting(setting="speculative", since="4.0"),
)

UNSTEADY_BOXES = frozenset({"3.11.0"})
"""Releases whose box contacts jump: a tower of twenty boxes sways or falls, even without this package."""

FAULTY_SPARSE = frozenset({"4.0.0"})
"""Releases whose Newton solver leaves forces in some sparse models (google-deepmind/mujoco#3767)."""


def sparse_advice(model: mujoco.MjModel) -> str:
    """Return the advice for a model that the installed release may solve wrongly; empty for other models."""
    import mujoco

    is_newton = model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON
    if mujoco.__version__ in FAULTY_SPARSE and is_newton and mujoco.mj_isSparse(model):
        return (
            f"MuJoCo {mujoco.__version__} solves some sparse models wrongly: set "
            '<option jacobian="dense"/>'
        )
    return ""


def _installed() -> str:
    """Return the installed version; reports that only name the engine do not import it."""
    import mujoco

    return mujoco.__version__


def _release(version: str) -> list[int]:
    """Return the major and the minor number of a version."""
    return [int(part) for part in version.split(".")[:2]]


def without_absent(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that the installed version has; the others have no effect."""
    absent = {
        later.setting
        for later in LATER_SETTINGS
        if later.value is None and not later.is_installed
    }
    return {name: value for name, value in settings.items() if name not in absent}


def check_installed(chosen: Mapping[str, Any], changes: Mapping[str, Any]) -> None:
    """Raise an error for a setting or a value that the installed version lacks.

    Args:
        chosen: All settings, of the preset and the user.
        changes: Settings that the user gives.
    """
    for later in LATER_SETTINGS:
        if later.is_installed:
            continue
        if later.value is None and later.setting in changes:
            what, fix = "does not have it", "leave it out"
        elif later.value is not None and chosen[later.setting] == later.value:
            what, fix = f"has no value {later.value!r}", "choose another value"
        else:
            continue
        raise ParameterError(
            f"MuJoCo setting {later.setting!r}: the installed MuJoCo {_installed()} {what}, since it came with "
            f"MuJoCo {later.since}: {fix}, or install a later version"
        )


def without_deformables(scene: Scene) -> Iterator[str]:
    """Yield the reason why the installed version cannot simulate the deformable bodies of a scene."""
    if scene.deformables and _release(_installed()) < _release(DEFORMABLES_SINCE):
        names = first_names([repr(body.name) for body in scene.deformables], 3)
        yield (
            f"deformable bodies ({names}) need MuJoCo {DEFORMABLES_SINCE}, whose constants for them differ from "
            f"those of the installed MuJoCo {_installed()}: install mujoco>={DEFORMABLES_SINCE}"
        )
