"""Options of `gauge run` and `gauge sweep`: a field is an option of the command line with its type and help line."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from gauge_envs.cli import arguments
from gauge_envs.cli.arguments import NUMERICS, SCENE, SELECTION, option
from gauge_envs.errors import ParameterError

if TYPE_CHECKING:
    from gauge_envs.runs.workers import Limits
    from gauge_envs.scene.jitter import Jitter
    from gauge_envs.tools.run.spec import RunSpec


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of both commands; None stands for an option that is not given."""

    parameters: arguments.Parameters = None
    asset: arguments.Asset = None
    use: arguments.Use = None
    marker_proxy: Annotated[
        Literal["material", "node"] | None,
        option(
            SCENE,
            "A marker on a deformable body: material, or node for its nearest node (paper).",
            show_default="material",
        ),
    ] = None
    jitter: Annotated[
        list[str] | None,
        option(
            SCENE,
            "Standard deviations of the start, as 1mm,0.5deg, where one that is not given is 0; real, as manual "
            "set-ups scatter; or off.",
            metavar="mm,deg",
            show_default="off; real with repeats",
        ),
    ] = None
    backend: Annotated[
        list[str] | None, arguments.backend("Engines.", show_default="mujoco")
    ] = None
    settings: arguments.Settings = None
    seed: Annotated[
        int | None,
        option(
            NUMERICS,
            "Seed of the first start.",
            "--seed",
            "-s",
            min=0,
            show_default="0",
        ),
    ] = None
    repeats: Annotated[
        int | None,
        option(
            NUMERICS,
            "Episodes, each with the next seed and its own initial-state noise.",
            min=1,
            show_default="1",
        ),
    ] = None
    timeout: Annotated[
        float | None,
        arguments.timeout(
            "Longest time of an episode, which then has a process of its own.",
            "3600 in such a process, else none",
        ),
    ] = None
    memory: arguments.Memory = None
    isolate: arguments.Isolate = False
    jobs: Annotated[
        int | None,
        option(
            NUMERICS,
            "Experiments at once, each in a process.",
            "--jobs",
            "-j",
            min=1,
            show_default="all processors; 1 for a short run",
        ),
    ] = None

    def spec(self, variants: Sequence[str]) -> RunSpec:
        """Return a run of experiments.

        Args:
            variants: Ids, patterns or task files.
        """
        from gauge_envs.tools.run.spec import run_spec

        settings = arguments.parsed_settings(self.settings) or {}
        values = self._given()
        values["variants"] = list(variants)
        values["settings"] = {name: [value] for name, value in settings.items()}
        return run_spec(values)

    def _given(self) -> dict[str, Any]:
        """Return the values of the given options, without settings, by the keys of `RunSpec`."""
        jitter = parsed_jitter(self.jitter)
        values: dict[str, Any] = {
            "backends": self.backend,
            "parameters": parameter_sets(self.parameters),
            "marker_proxy": self.marker_proxy,
            "asset": self.asset and str(self.asset),
            "seed": self.seed,
            "repeats": self.repeats,
            "jitter": jitter and jitter.to_dict(),
        }
        if self.use:
            values |= arguments.parsed_use(self.use, "drivers", "reference")
        return {key: value for key, value in values.items() if value is not None}

    def limits(self) -> Limits:
        """Return the limits of worker processes."""
        from gauge_envs.runs.workers import TIME_LIMIT_S, Limits

        return Limits(
            self.timeout or TIME_LIMIT_S, self.memory, is_per_request=self.isolate
        )


@dataclass(frozen=True, kw_only=True)
class SweepOptions(RunOptions):
    """Options of `gauge sweep`; a given option replaces the key of the sweep file."""

    preset: Annotated[
        list[str] | None,
        option(
            NUMERICS,
            "Presets of every engine.",
            metavar="NAME",
            show_default="chosen by each engine",
        ),
    ] = None
    settings: Annotated[
        list[str] | None,
        option(
            NUMERICS,
            "Values of a setting: timestep_s=1/1800,1/3600 or mujoco.iterations=10,50.",
            "--set",
            metavar=arguments.ASSIGNED,
            show_default="defaults of the engine",
        ),
    ] = None
    ray: Annotated[
        str | None,
        option(
            NUMERICS,
            "Run on Ray: auto, local, or the address of a cluster.",
            metavar="ADDRESS",
        ),
    ] = None
    only: Annotated[
        list[str] | None,
        option(
            SELECTION,
            "Ids, patterns or task files.",
            metavar="ID",
            show_default="ids of the file",
        ),
    ] = None
    shard: Annotated[
        str,
        option(
            SELECTION,
            "Run one part, as 0/16; parts may run at the same time.",
            metavar="NUMBER/COUNT",
            show_default="all",
        ),
    ] = "0/1"
    retry_failed: Annotated[
        bool,
        option(SELECTION, "Run again what failed before.", "--retry-failed"),
    ] = False
    dry_run: Annotated[
        bool,
        option(arguments.OUTPUT, "Show the plan; run nothing.", "--dry-run"),
    ] = False
    out: Annotated[Path, arguments.folder("Folder for the result files.")] = Path(
        "sweep"
    )

    def spec_of(self, file: Path | None) -> RunSpec:
        """Return the sweep of a file, with its keys replaced by given options."""
        from gauge_envs.tools.run.spec import load_sweep_file, run_spec

        values = {} if file is None else load_sweep_file(file)
        values |= self._given()
        if self.only:
            values["variants"] = self.only
        if self.preset:
            values["presets"] = self.preset
        if "variants" not in values:
            raise ParameterError(
                "nothing to run: give a sweep file or experiments, for example --only 'SlopeSlider-2-*'"
            )
        settings = values.setdefault("settings", {})
        # The name of a setting may have the prefix of an engine: mujoco.iterations.
        for name, texts in arguments.assigned("--set", self.settings or ()).items():
            engine, dot, key = name.rpartition(".")
            table = settings.setdefault(engine, {}) if dot else settings
            table[key] = list(map(arguments.value_of, arguments.split_values(texts)))
        return run_spec(values)


# --- values ----------------------------------------------------------------------------------------------------------


def parsed_parameters(texts: Sequence[str] | None) -> str | dict[str, Any] | None:
    """Return the name of a parameter set, or overrides such as `cube.friction=0.3` as a dictionary."""
    if not texts:
        return None
    if len(texts) == 1 and "=" not in texts[0]:
        return texts[0]
    if not all("=" in text for text in texts):
        raise ParameterError(
            f"--parameter {','.join(texts)}: expected {arguments.ASSIGNED}, or the name of one set alone"
        )
    changes = arguments.assigned("--parameter", texts)
    return {name: arguments.value_of(value) for name, value in changes.items()}


def parameter_sets(texts: Sequence[str] | None) -> list[Any] | None:
    """Return the parameter sets of a sweep: several names, or one set of overrides."""
    if not texts:
        return None
    if any("=" in text for text in texts):
        return [parsed_parameters(texts)]
    return list(texts)


DEVIATION = re.compile(r"((?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?)\s*(mm|deg)")
"""A standard deviation of `--jitter`: its number and its unit."""


def parsed_jitter(texts: Sequence[str] | None) -> Jitter | None:
    """Return the noise of `--jitter`: `1mm` and `0.5deg`, `real`, or `off`; None if it is not given."""
    from gauge_envs.scene.jitter import Jitter

    if not texts:
        return None
    if list(texts) == ["real"]:
        return Jitter()
    if list(texts) == ["off"]:
        return Jitter(position_m=0.0, angle_rad=0.0)
    matches = [DEVIATION.fullmatch(text) for text in texts]
    numbers = {match[2]: float(match[1]) for match in matches if match}
    if len(numbers) < len(texts):
        raise ParameterError(
            f"--jitter {','.join(texts)}: expected numbers of 0 or more in mm and deg, each once, as 1mm,0.5deg; or "
            "real; or off"
        )
    return Jitter(
        position_m=1.0e-3 * numbers.get("mm", 0.0),
        angle_rad=math.radians(numbers.get("deg", 0.0)),
    )
