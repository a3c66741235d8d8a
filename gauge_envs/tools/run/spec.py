"""Read the content of a sweep from a file or from keywords.

A sweep file::

    backends = ["mujoco", "rapier"]
    variants = ["SlopeSlider-2-*", "BouncingBall-rubber"]
    repeats = 4

    [settings]
    timestep_s = [0.0005555555555555556, 0.0002777777777777778]

    [settings.mujoco]
    iterations = [10, 50]

The episodes are the product of all lists. A list in the table of an engine replaces the common list of this setting.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    JsonValue,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveInt,
    ValidationError,
    model_validator,
)

from gauge_envs.errors import ParameterError, SweepFileError
from gauge_envs.experiments.variants import is_task_path
from gauge_envs.files import os_errors
from gauge_envs.text import toml_document
from gauge_envs.validation import first_fault

Names = Annotated[list[str], Field(min_length=1)]

JitterKey = Literal[
    "position_m", "angle_rad", "velocity_m_per_s", "angular_velocity_rad_per_s"
]
"""Standard deviations of initial poses and velocities; see `gauge_envs.Jitter`."""


class SweepSpec(BaseModel):
    """Content of a sweep. The episodes are the product of its lists.

    Attributes:
        backends: Names of engines.
        variants: Ids, patterns such as `SlopeSlider-2-*`, or task files.
        presets: Presets of every engine; None for the default preset of each engine and scene.
        parameters: Parameter sets, or tables of overrides such as `{"cube.friction" = 0.3}`.
        repeats: Episodes of each combination; the seeds begin with `seed`.
        seed: Seed of the first repeat.
        jitter: Standard deviations of the initial state. None means the default jitter for repeats, and no jitter for
            a single episode.
        settings: A list of values for each numerical setting, and a table of such lists under the name of an engine.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, strict=True
    )

    backends: Names = ["mujoco"]
    variants: Names
    presets: Names | None = None
    parameters: Annotated[list[Any], Field(min_length=1)] = ["calibrated"]
    repeats: PositiveInt = 1
    seed: NonNegativeInt = 0
    jitter: dict[JitterKey, NonNegativeFloat] | None = None
    settings: dict[str, JsonValue] = {}

    @model_validator(mode="after")
    def _check_settings(self) -> SweepSpec:
        for name, values in self.settings.items():
            if isinstance(values, dict) != (name in self.backends):
                raise ValueError(
                    f"settings.{name}: expected a table for an engine of backends, or a list for a setting"
                )
            lists = values if isinstance(values, dict) else {name: values}
            for key, choices in lists.items():
                if not isinstance(choices, list) or not choices:
                    raise ValueError(
                        f"settings: {key}: expected a list of one or more values, for example [0.001, 0.002]"
                    )
        return self

    def setting_lists(self, backend: str) -> dict[str, list[Any]]:
        """Return the values of each setting for an engine. The table of the engine replaces common values."""
        lists: dict[str, Any] = {"preset": self.presets} if self.presets else {}
        for name, values in self.settings.items():
            if name not in self.backends:
                lists[name] = values
        of_engine: Any = self.settings.get(backend, {})
        return lists | of_engine


def sweep_spec(values: dict[str, Any], file: Path | None = None) -> SweepSpec:
    """Return the sweep of keywords, the keys of a sweep file.

    Args:
        values: The keywords.
        file: File of the keywords, for the error.

    Raises:
        ParameterError: A value is wrong.
        SweepFileError: A value of a file is wrong.
    """
    try:
        return SweepSpec.model_validate(values)
    except ValidationError as error:
        key, reason = first_fault(error)
        if reason in ("unknown key", "missing key"):
            reason = f"{reason}; keys: {', '.join(SweepSpec.model_fields)}"
        if file is not None:
            raise SweepFileError(file, key, reason) from None
        raise ParameterError(": ".join(filter(None, (key, reason)))) from None


def load_sweep_file(path: Path) -> dict[str, Any]:
    """Read a sweep file and check it.

    Paths of task files are relative to the folder of the file.

    Returns:
        Keys and values for `sweep_spec`.

    Raises:
        SweepFileError: The file cannot be read, or a value is wrong.
    """
    with os_errors(
        lambda cause: SweepFileError(path, None, f"cannot be read: {cause}")
    ):
        content = path.read_bytes()
    try:
        values = toml_document(content)
    except ValueError as error:
        raise SweepFileError(path, None, f"not a TOML file: {error}") from error
    values["variants"] = [
        str(path.parent / name) if is_task_path(name) else name
        for name in sweep_spec(values, path).variants
    ]
    return values
