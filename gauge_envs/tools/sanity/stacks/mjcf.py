"""MuJoCo models: a model file, or a compiled model in this process.

Changes are elements of MJCF: `<option cone="elliptic"/>`, `<default><geom solref="0.02 1"/></default>`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mujoco

from gauge_envs.backends.mujoco.model import (
    DISABLE_FLAGS,
    ENABLE_FLAGS,
    SAME_NAME_OPTIONS,
)
from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.model import Settings, TrainingConfiguration
from gauge_envs.tools.sanity.robot.mended_model import drop_pictures
from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.stacks.dialect import (
    NUMBER,
    WHOLE,
    Dialect,
    Kind,
    Place,
    Setting,
    number_text,
)
from gauge_envs.tools.sanity.stacks.documents import file_content
from gauge_envs.tools.sanity.stacks.reader import GeomPair, Reader, has_suffix

OVERRIDE = Setting("o_friction", "flag", "override", pattern='{key}="disable"')
"""Setting that MJCF leaves out by switching the flag off."""

SWITCH = Kind(text=lambda is_on: "enable" if is_on else "disable")

MODEL_SETTINGS = (
    Setting("timestep_s", "option", "timestep"),
    *(Setting(name, "option", name) for name in ("integrator", "cone", "solver")),
    *(
        Setting(name, "option", name, WHOLE if name.endswith("iterations") else NUMBER)
        for name in SAME_NAME_OPTIONS
    ),
    *(Setting(name, "flag", name, SWITCH) for name in (*DISABLE_FLAGS, *ENABLE_FLAGS)),
    Setting("contact_solref", "geom", "solref"),
    Setting("contact_solimp", "geom", "solimp"),
    Setting("contact_margin_m", "geom", "margin"),
    Setting("contact_gap_m", "geom", "gap"),
    Setting("condim", "geom", "condim"),
)
"""Attributes of `<option>`, of its `<flag>`, and of `<geom>`; the MuJoCo backend reads them of compiled models."""


def _attribute(value: Any) -> str:
    """Return a value of an attribute."""
    return (
        " ".join(map(number_text, value))
        if isinstance(value, list | tuple)
        else number_text(value)
    )


@dataclass(frozen=True, kw_only=True)
class Mjcf(Dialect):
    """Elements of a model."""

    settings: tuple[Setting, ...] = MODEL_SETTINGS
    pattern: str = '{key}="{value}"'
    places: Mapping[str, Place] = field(
        default_factory=lambda: dict.fromkeys(
            ("config", "option", "flag", "geom"), Place(form="{}")
        )
    )
    text: Callable[[Any], str] = _attribute
    gravity: str = '<option gravity="{}"/>'
    gravity_joint: str = " "
    absent: str = "no {key}"

    def setting(self, name: str, value: Any) -> Setting:
        """Return where a setting with a value stands; None is to be left out."""
        return (
            OVERRIDE
            if value is None and name == OVERRIDE.name
            else super().setting(name, value)
        )

    def paste_text(self, changes: Settings) -> str:
        """Return elements: `<option>` with its flags, and `<geom>` as the default of all."""
        grouped, alone = self._grouped(changes)
        option, flags, geom = (
            " ".join(grouped.get(place, ())) for place in ("option", "flag", "geom")
        )
        parts = []
        if "config" in grouped:
            parts.append(f"config_overrides={{{', '.join(grouped['config'])}}}")
        if option or flags:
            head = f"<option {option}".rstrip()
            parts.append(f"{head}><flag {flags}/></option>" if flags else f"{head}/>")
        if geom:
            parts.append(f"<default><geom {geom}/></default>")
        return self.joint.join([*parts, *alone])


def _spec_of(path: Path, content: bytes) -> mujoco.MjSpec:
    """Return the model of a file; MuJoCo reads a file of another name than .xml and .urdf from its text alone."""
    if path.suffix != ".mjcf":
        return mujoco.MjSpec.from_file(str(path))
    spec = mujoco.MjSpec.from_string(content.decode("utf-8"))
    spec.modelfiledir = str(path.parent)
    return spec


def read_model_file(path: Path, pair: GeomPair | None = None) -> TrainingConfiguration:
    """Return the configuration of a model file that MuJoCo reads."""
    content = file_content(path)
    try:
        spec = _spec_of(path, content)
        drop_pictures(spec)
        model = spec.compile()
    except ValueError as error:
        hint = (
            "; state files of package:// relative to this one"
            if "package:/" in str(error)
            else ""
        )
        raise TargetError(
            f"{path}: MuJoCo cannot load it: {' '.join(str(error).split())}{hint}"
        ) from None
    return mujoco_configuration(
        model,
        name=path.name,
        source=f"model file {path}",
        pair=pair,
        spec=spec,
        file=path,
    )


def model_name(model: mujoco.MjModel) -> str:
    """Return the name that a model states, or `unnamed model`."""
    return model.names.split(b"\0", 1)[0].decode() or "unnamed model"


DIALECTS = (Mjcf(name="mjcf"),)

READERS = (
    Reader(
        "a mujoco.MjModel",
        lambda target: isinstance(target, mujoco.MjModel),
        lambda target, pair: mujoco_configuration(
            target, name=model_name(target), source="mujoco.MjModel", pair=pair
        ),
    ),
    Reader(
        "a model file (.xml, .mjcf, .urdf)",
        has_suffix(".xml", ".mjcf", ".urdf"),
        lambda target, pair: read_model_file(Path(target), pair),
    ),
)
