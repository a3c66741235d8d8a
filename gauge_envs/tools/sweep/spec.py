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

import math
from collections.abc import Iterator, Mapping
from itertools import product
from math import prod
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
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

MAX_EPISODES = 1_000_000
"""Largest number of episodes of a sweep."""

LARGEST_SEED = 2**62
"""Largest first seed: the seeds of all repeats fit into 64 bits."""

Text = Annotated[str, Field(min_length=1)]


class _Model(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, strict=True
    )


class JitterSpec(_Model):
    """Standard deviations of start poses and velocities; see `gauge_envs.Jitter`."""

    position_m: Annotated[float, Field(ge=0.0)] = Jitter.position_m
    angle_rad: Annotated[float, Field(ge=0.0)] = Jitter.angle_rad
    velocity_m_per_s: Annotated[float, Field(ge=0.0)] = 0.0
    angular_velocity_rad_per_s: Annotated[float, Field(ge=0.0)] = 0.0


class SweepSpec(_Model):
    """What a sweep covers. Its episodes are the product of its lists.

    Attributes:
        backends: Names of engines.
        variants: Ids, patterns such as `SlopeSlider-2-*`, or task files.
        presets: Presets of every engine; empty for the preset that each engine chooses for a scene.
        parameters: Parameter sets, or tables of overrides such as `{"cube.friction" = 0.3}`.
        repeats: Episodes of each combination, with seeds from `seed` on.
        seed: Seed of the first repeat.
        jitter: Standard deviations of the start; None is the default jitter for repeats, and the calibrated start for
            a single episode.
        settings: A list of values for each numerical setting; or, under the name of an engine, such a table for it.
    """

    backends: Annotated[list[Text], Field(min_length=1)] = ["mujoco"]
    variants: Annotated[list[Text], Field(min_length=1)]
    presets: Annotated[list[Text], Field(min_length=1)] | None = None
    parameters: Annotated[list[Any], Field(min_length=1)] = ["calibrated"]
    repeats: Annotated[int, Field(ge=1)] = 1
    seed: Annotated[int, Field(ge=0, le=LARGEST_SEED)] = 0
    jitter: JitterSpec | None = None
    settings: dict[str, Any] = {}

    @field_validator("parameters")
    @classmethod
    def _are_sets_or_overrides(cls, value: list[Any]) -> list[Any]:
        for one in value:
            if not (isinstance(one, str | dict) and one):
                raise ValueError(
                    f"{one!r}: the name of a parameter set is expected, or a table as {{ 'cube.friction' = 0.3 }}"
                )
        return value

    @model_validator(mode="after")
    def _settings_are_lists(self) -> SweepSpec:
        for name, values in self.settings.items():
            if not isinstance(values, dict):
                if name in self.backends:
                    raise ValueError(
                        f"settings.{name}: the name of an engine; a table of settings is expected"
                    )
                _check_values(name, values)
            elif name not in self.backends:
                raise ValueError(
                    f"settings.{name}: a table of an engine that backends does not list"
                )
            else:
                for key, one in values.items():
                    _check_values(f"{name}.{key}", one)
        return self

    @property
    def start_jitter(self) -> Jitter | None:
        """The jitter that was given, or None."""
        return None if self.jitter is None else Jitter(**self.jitter.model_dump())

    def subjects(self) -> list[Variant]:
        """Return the variants, each once."""
        return list(
            dict.fromkeys(
                variant
                for pattern in self.variants
                for variant in matching_variants(pattern)
            )
        )

    def setting_lists(self, backend: str) -> dict[str, list[Any]]:
        """Return the values of each setting for an engine: the common ones, replaced by those of its own table."""
        common: dict[str, list[Any]] = (
            {} if self.presets is None else {"preset": list(self.presets)}
        )
        common |= {
            key: values
            for key, values in self.settings.items()
            if isinstance(values, list)
        }
        of_engine = self.settings.get(backend)
        return common | (of_engine if isinstance(of_engine, dict) else {})

    def setting_choices(self, backend: str) -> Iterator[dict[str, Any]]:
        """Yield every combination of settings for an engine."""
        lists = self.setting_lists(backend)
        for values in product(*lists.values()):
            yield dict(zip(lists, values, strict=True))

    def episode_count(self) -> int:
        """Return the number of combinations, without looking for equal ones."""
        choices = sum(
            prod(map(len, self.setting_lists(name).values()))
            for name in dict.fromkeys(self.backends)
        )
        return choices * len(self.subjects()) * len(self.parameters) * self.repeats


def sweep_spec(values: Mapping[str, Any]) -> SweepSpec:
    """Return the sweep of keywords, which are the keys of a sweep file."""
    try:
        return SweepSpec.model_validate(dict(values))
    except ValidationError as error:
        raise ParameterError(": ".join(filter(None, _fault(error)))) from None


def load_sweep_file(path: str | PathLike[str]) -> dict[str, Any]:
    """Read a sweep file and check it.

    Paths of task files are relative to the folder of the file.

    Returns:
        Its keys and values, for `sweep_spec`.
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
    located = [
        str(path.parent / name) if is_task_path(name) else name
        for name in spec.variants
    ]
    return values | {"variants": located}


def _check_values(key: str, values: Any) -> None:
    """Check that the values of a setting are a list of numbers, texts, booleans or lists of them."""
    if not isinstance(values, list) or not values:
        raise ValueError(
            f"settings.{key}: a list of one or more values is expected, as [0.001, 0.002]"
        )
    for value in values:
        for part in value if isinstance(value, list) else [value]:
            if not isinstance(part, bool | int | float | str) or (
                isinstance(part, float) and not math.isfinite(part)
            ):
                raise ValueError(
                    f"settings.{key}: {part!r} is no finite number, text or boolean"
                )


def _fault(error: ValidationError) -> tuple[str, str]:
    """Return the key and the reason of the first fault, with the known keys for an unknown one."""
    key, reason = first_fault(error)
    if reason in ("unknown key", "missing key"):
        known = (
            JitterSpec.model_fields
            if key.startswith("jitter.")
            else SweepSpec.model_fields
        )
        reason = f"{reason}; keys: {', '.join(known)}"
    return key, reason
