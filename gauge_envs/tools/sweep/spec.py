"""What a sweep covers: the model of a sweep file, and the same from keywords.

A sweep file::

    backends = ["mujoco", "rapier"]
    variants = ["SlopeSlider-2-*", "BouncingBall-rubber"]
    repeats = 4

    [settings]
    timestep_s = [0.0005555555555555556, 0.0002777777777777778]

    [settings.mujoco]
    iterations = [10, 50]

The episodes are the product of all lists. A list in a table of one engine replaces the common list of that setting.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import product
from math import prod
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from gauge_envs.errors import ParameterError, SweepFileError, first_fault
from gauge_envs.experiments.variants import (
    Variant,
    is_task_path,
    matching_variants,
)
from gauge_envs.files import os_errors, toml_document
from gauge_envs.scene.jitter import Jitter

MAX_SEED = 2**62
"""Largest first seed: the seeds of all repeats fit into 64 bits."""

Names = Annotated[list[Annotated[str, Field(min_length=1)]], Field(min_length=1)]


JitterKey = Literal[
    "position_m", "angle_rad", "velocity_m_per_s", "angular_velocity_rad_per_s"
]
"""Standard deviations of start poses and velocities; see `gauge_envs.Jitter`."""


class SweepSpec(BaseModel):
    """What a sweep covers. Its episodes are the product of its lists.

    Attributes:
        backends: Names of engines.
        variants: Ids, patterns such as `SlopeSlider-2-*`, or task files.
        presets: Presets of every engine; None for the preset that each engine chooses for a scene.
        parameters: Parameter sets, or tables of overrides such as `{"cube.friction" = 0.3}`.
        repeats: Episodes of each combination, with seeds from `seed` on.
        seed: Seed of the first repeat.
        jitter: Standard deviations of the start; None is the default jitter for repeats, and the calibrated start for
            a single episode.
        settings: A list of values for each numerical setting; or, under the name of an engine, such a table for it.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, strict=True
    )

    backends: Names = ["mujoco"]
    variants: Names
    presets: Names | None = None
    parameters: Annotated[list[Any], Field(min_length=1)] = ["calibrated"]
    repeats: Annotated[int, Field(ge=1)] = 1
    seed: Annotated[int, Field(ge=0, le=MAX_SEED)] = 0
    jitter: dict[JitterKey, Annotated[float, Field(ge=0.0)]] | None = None
    settings: dict[str, Any] = {}

    @model_validator(mode="after")
    def _check_settings(self) -> SweepSpec:
        for name, values in self.settings.items():
            is_engine = name in self.backends
            if isinstance(values, dict) and not is_engine:
                raise ValueError(
                    f"settings.{name}: a table of an engine that backends does not list"
                )
            if is_engine and not isinstance(values, dict):
                raise ValueError(f"settings.{name}: a table of settings is expected")
            lists = values if is_engine else {"": values}
            for key, listed in lists.items():
                _check_list(f"settings.{name}.{key}".rstrip("."), listed)
        return self

    @property
    def start_jitter(self) -> Jitter | None:
        """The jitter that was given, or None."""
        return None if self.jitter is None else Jitter(**self.jitter)

    def subjects(self) -> list[Variant]:
        """Return the variants, each once."""
        matches = [match for one in self.variants for match in matching_variants(one)]
        return list(dict.fromkeys(matches))

    def setting_lists(self, backend: str) -> dict[str, list[Any]]:
        """Return the values of each setting for an engine: the common ones, replaced by those of its own table."""
        presets = {} if self.presets is None else {"preset": self.presets}
        common = {
            key: values
            for key, values in self.settings.items()
            if not isinstance(values, dict)
        }
        of_engine: dict[str, list[Any]] = self.settings.get(backend, {})
        return presets | common | of_engine

    def setting_choices(self, backend: str) -> list[dict[str, Any]]:
        """Return every combination of settings for an engine."""
        lists = self.setting_lists(backend)
        return [dict(zip(lists, one, strict=True)) for one in product(*lists.values())]

    def episode_count(self) -> int:
        """Return the number of combinations, without looking for equal ones."""
        choices = sum(
            prod(map(len, self.setting_lists(name).values()))
            for name in dict.fromkeys(self.backends)
        )
        return choices * len(self.subjects()) * len(self.parameters) * self.repeats


def _check_list(key: str, values: Any) -> None:
    """Raise an error if the values of a setting are no list of finite numbers, texts or booleans."""
    if not isinstance(values, list) or not values:
        raise ValueError(
            f"{key}: a list of one or more values is expected, as [0.001, 0.002]"
        )
    try:
        json.dumps(values, allow_nan=False)
    except (TypeError, ValueError):
        raise ValueError(
            f"{key}: finite numbers, texts or booleans are expected, not {values}"
        ) from None


def sweep_spec(values: Mapping[str, Any]) -> SweepSpec:
    """Return the sweep of keywords, which are the keys of a sweep file.

    Raises:
        ParameterError: A value is wrong.
    """
    try:
        return SweepSpec.model_validate(dict(values))
    except ValidationError as error:
        raise ParameterError(": ".join(filter(None, _fault(error)))) from None


def load_sweep_file(path: str | PathLike[str]) -> dict[str, Any]:
    """Read a sweep file and check it.

    Paths of task files are relative to the folder of the file.

    Returns:
        Its keys and values, for `sweep_spec`.

    Raises:
        SweepFileError: The file cannot be read, or a value is wrong.
    """
    path = Path(path)
    with os_errors(
        lambda cause: SweepFileError(path, None, f"cannot be read: {cause}")
    ):
        content = path.read_bytes()
    try:
        values = toml_document(content)
        spec = SweepSpec.model_validate(values)
    except ValidationError as error:
        raise SweepFileError(path, *_fault(error)) from None
    except ValueError as error:
        raise SweepFileError(path, None, f"not a TOML file: {error}") from error
    variants = [
        str(path.parent / name) if is_task_path(name) else name
        for name in spec.variants
    ]
    return values | {"variants": variants}


def _fault(error: ValidationError) -> tuple[str, str]:
    """Return the key and the reason of the first fault, with the known keys for an unknown one."""
    key, reason = first_fault(error)
    if reason in ("unknown key", "missing key"):
        reason = f"{reason}; keys: {', '.join(SweepSpec.model_fields)}"
    return key, reason
