"""What a run consists of, from options and a sweep file. A run of one combination and a sweep are the same.

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
from gauge_envs.experiments.variants import Variant, is_task_path
from gauge_envs.reading import reading
from gauge_envs.runs.request import RunRequest
from gauge_envs.scene.jitter import Jitter
from gauge_envs.text import toml_document
from gauge_envs.validation import first_fault

NameList = Annotated[list[str], Field(min_length=1)]

JitterKey = Literal[
    "position_m", "angle_rad", "velocity_m_per_s", "angular_velocity_rad_per_s"
]
"""Standard deviations of initial poses and velocities; see `gauge_envs.Jitter`."""


class RunSpec(BaseModel):
    """Content of a run or a sweep. The episodes are the product of its lists.

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
        marker_proxy: As for `gauge_envs.GaugeEnv`; likewise the following.
        drivers: `bundled` or `imported`.
        reference: `bundled` or `imported`.
        asset: File with the scene in place of the task file.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, strict=True
    )

    backends: NameList = ["mujoco"]
    variants: NameList
    presets: NameList | None = None
    parameters: Annotated[list[Any], Field(min_length=1)] = ["published"]
    repeats: PositiveInt = 1
    seed: NonNegativeInt = 0
    jitter: dict[JitterKey, NonNegativeFloat] | None = None
    settings: dict[str, JsonValue] = {}
    marker_proxy: str = "material"
    drivers: str = "bundled"
    reference: str = "bundled"
    asset: str | None = None

    @model_validator(mode="after")
    def _check_settings(self) -> RunSpec:
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

    def request(self, variant: Variant, parameters: Any) -> RunRequest:
        """Return the request of an experiment with a choice of parameters, without an engine and its settings."""
        jitter = None
        # A single episode without noise starts from the initial state of the experiment.
        if self.jitter is not None and (self.repeats > 1 or any(self.jitter.values())):
            jitter = Jitter(**self.jitter)
        return RunRequest(
            variant,
            parameters=parameters,
            marker_proxy=self.marker_proxy,
            drivers=self.drivers,
            reference=self.reference,
            asset=self.asset,
            seed=self.seed,
            repeats=self.repeats,
            jitter=jitter,
        )

    def setting_lists(self, backend: str) -> dict[str, list[Any]]:
        """Return the values of each setting for an engine. The table of the engine replaces common values."""
        lists: dict[str, Any] = {"preset": self.presets} if self.presets else {}
        for name, values in self.settings.items():
            if name not in self.backends:
                lists[name] = values
        of_engine: Any = self.settings.get(backend, {})
        return lists | of_engine


def run_spec(values: dict[str, Any], file: Path | None = None) -> RunSpec:
    """Return the sweep of keywords, the keys of a sweep file.

    Args:
        values: The keywords.
        file: File of the keywords, for the error.

    Raises:
        ParameterError: A value is wrong.
        SweepFileError: A value of a file is wrong.
    """
    try:
        return RunSpec.model_validate(values)
    except ValidationError as error:
        key, reason = first_fault(error)
        if error.errors()[0]["type"] in ("extra_forbidden", "missing"):
            reason = f"{reason}; keys: {', '.join(RunSpec.model_fields)}"
        if file is not None:
            raise SweepFileError(file, key, reason) from None
        raise ParameterError(": ".join(filter(None, (key, reason)))) from None


def load_sweep_file(path: Path) -> dict[str, Any]:
    """Read a sweep file and check it.

    Paths of task files and of the asset are relative to the folder of the file.

    Returns:
        Keys and values for `run_spec`.

    Raises:
        SweepFileError: The file cannot be read, or a value is wrong.
    """
    with reading(path, SweepFileError) as content:
        values = toml_document(content)
        spec = run_spec(values, path)
    values["variants"] = list(spec.variants)
    for index, name in enumerate(spec.variants):
        if is_task_path(name):
            values["variants"][index] = str(path.parent / name)
    if spec.asset is not None:
        values["asset"] = str(path.parent / spec.asset)
    return values
