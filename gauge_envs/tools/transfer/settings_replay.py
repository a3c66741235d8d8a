"""Replay policies of a MuJoCo environment with the settings of their training and with others: what do they keep?"""

from __future__ import annotations

import fnmatch
import importlib
import warnings
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gauge_envs.backends.mujoco.versions import sparse_advice
from gauge_envs.errors import GaugeError, ParameterError
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.control import Policy
from gauge_envs.tools.transfer.estimates import Estimate
from gauge_envs.tools.transfer.transfer import (
    FALL_SHARE,
    estimate,
    success_share,
)

FIELDS = {
    "geom": {"friction", "solref", "solimp", "margin", "gap", "condim"},
    "pair": {"friction", "solref", "solreffriction", "solimp", "margin", "gap"},
    "joint": {"damping", "armature", "frictionloss", "stiffness"},
    "actuator": {"kp", "kv", "gear", "forcerange"},
}
"""Attributes that a setting may change, by kind of element; options of the model need no kind."""
MULTIPLE = 1e-6
"""Relative error up to which a control interval is a multiple of a time step."""
ENUMS: Mapping[str, tuple[str, Any]] = {
    "integrator": ("mjINT_", mujoco.mjtIntegrator),
    "cone": ("mjCONE_", mujoco.mjtCone),
    "solver": ("mjSOL_", mujoco.mjtSolver),
    "jacobian": ("mjJAC_", mujoco.mjtJacobian),
}
"""Options whose values have names: prefix and type of these."""


@dataclass(frozen=True, kw_only=True)
class SettingsRow:
    """What policies earn with one set of settings.

    Attributes:
        settings: The settings that replace those of the environment.
        reward: Mean reward of an episode, with its interval over seeds and policies.
        kept: Reward over that with the settings of the training; None where that is not positive.
        change: Reward less that with the settings of the training, of the same seeds.
        success: Share of the episodes that succeed, with its exact interval; None where it states none.
        full_length: Share of the episodes that do not end early.
    """

    settings: Mapping[str, str]
    reward: Estimate
    kept: Estimate | None
    change: Estimate
    success: Estimate | None
    full_length: float


@dataclass(frozen=True, kw_only=True)
class SettingsReport:
    """What policies keep of their reward with other settings of the engine.

    Attributes:
        env: The environment.
        policies: Names of the policies.
        seeds: Number of seeds.
        training: The row of the training's settings.
        test: The row of the other settings.
        falls: Whether less than `FALL_SHARE` is kept, with the whole interval; or the reward
            falls, where that of the training is not positive.
    """

    env: str
    policies: tuple[str, ...]
    seeds: int
    training: SettingsRow
    test: SettingsRow
    falls: bool


class ModelEnv(gymnasium.Env[FloatArray, NDArray[np.float32]]):
    """An environment of an MJCF file: positions and velocities are observed, the action is ctrl within its range.

    Attributes:
        model: The model.
        data: Its state.
        frame_skip: Steps of the engine in a step of the environment.
    """

    def __init__(
        self,
        path: Path,
        reward: Callable[[mujoco.MjModel, mujoco.MjData], Any],
        *,
        control_s: float,
        duration_s: float,
    ) -> None:
        """Load a model.

        Args:
            path: The MJCF file.
            reward: Function of model and data that returns a reward, or a reward and whether the episode succeeded.
            control_s: Time between actions [s].
            duration_s: Length of an episode [s].
        """
        try:
            self.model = mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            raise ParameterError(
                f"--env {path}: MuJoCo cannot load it: {error}"
            ) from None
        self.data = mujoco.MjData(self.model)
        self.frame_skip = _steps(control_s, self.model.opt.timestep)
        self._reward, self._count, self._done = reward, round(duration_s / control_s), 0
        low, high = self.model.actuator_ctrlrange.T
        is_free = self.model.actuator_ctrllimited == 0
        size = self.model.nq + self.model.nv
        self.observation_space = spaces.Box(-np.inf, np.inf, (size,), np.float64)
        self.action_space = spaces.Box(
            np.where(is_free, -np.inf, low).astype(np.float32),
            np.where(is_free, np.inf, high).astype(np.float32),
        )

    def _observation(self) -> FloatArray:
        return np.concatenate([self.data.qpos, self.data.qvel])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[FloatArray, dict[str, Any]]:
        """Start at the first keyframe, or the model's own pose, with rates of 1 mm/s and 1 mrad/s at random."""
        super().reset(seed=seed)
        self._done = 0
        mujoco.mj_resetData(self.model, self.data)
        if self.model.nkey:
            mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        self.data.qvel += 1e-3 * self.np_random.standard_normal(self.model.nv)
        mujoco.mj_forward(self.model, self.data)
        return self._observation(), {}

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[FloatArray, float, bool, bool, dict[str, Any]]:
        """Apply an action for one control interval."""
        self.data.ctrl[:] = action
        mujoco.mj_step(self.model, self.data, nstep=self.frame_skip)
        paid = self._reward(self.model, self.data)
        reward, *success = paid if isinstance(paid, tuple) else (paid,)
        self._done += 1
        info = {"is_success": bool(success[0])} if success else {}
        return (
            self._observation(),
            float(reward),
            False,
            self._done >= self._count,
            info,
        )


def make_env(
    name: str,
    *,
    reward: str | None,
    control_s: float | None,
    duration_s: float | None,
    trust: bool,
) -> gymnasium.Env[Any, Any]:
    """Return a Gymnasium id, what a function returns, or the environment of an MJCF file.

    Args:
        name: Gymnasium id, `module:function` without arguments, or a path of an MJCF file.
        reward: `module:function` of an MJCF file's reward; see `ModelEnv`.
        control_s: Time between actions of an MJCF file [s].
        duration_s: Length of an episode of an MJCF file [s].
        trust: Whether to import modules.
    """
    is_file = Path(name).suffix.lower() in (".xml", ".mjcf")
    stated = {"--reward": reward, "--control": control_s, "--duration": duration_s}
    if is_file:
        if missing := [one for one, value in stated.items() if value is None]:
            raise ParameterError(
                f"--env {name}: an MJCF states no task: give {', '.join(missing)} too"
            )
        assert reward is not None and control_s is not None and duration_s is not None
        function = _function(reward, trust=trust)
        return ModelEnv(
            Path(name), function, control_s=control_s, duration_s=duration_s
        )
    if given := [one for one, value in stated.items() if value is not None]:
        raise ParameterError(
            f"{given[0]} is of an MJCF file, and --env {name} states its own"
        )
    if ":" in name:
        return _function(name, trust=trust)()
    try:
        return gymnasium.make(name)
    except gymnasium.error.Error as error:
        raise ParameterError(
            f"--env {name}: Gymnasium cannot make it: {error}. Install the package that registers it, and name a "
            "function that imports it and returns the environment, as my_robot:make_env with --trust"
        ) from None


def _function(name: str, *, trust: bool) -> Callable[..., Any]:
    if not trust:
        raise ParameterError(
            f"{name}: importing a module runs its code: add --trust if you trust it"
        )
    module, _, attribute = name.partition(":")
    try:
        found: Callable[..., Any] = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise ParameterError(f"{name}: {error}") from None
    return found


def apply_settings(env: gymnasium.Env[Any, Any], settings: Mapping[str, str]) -> None:
    """Write settings into the MuJoCo model of an environment; the time between actions stays.

    Args:
        env: The environment.
        settings: Values by name: an option as `impratio`, or `KIND:PATTERN.attribute` as `geom:*foot*.friction`, where
            the pattern is of names of elements, or of the bodies of geoms. Fewer numbers replace the first ones.

    Raises:
        ParameterError: The environment has no MuJoCo model, or a name or value is unknown.
    """
    inner: Any = env.unwrapped
    model = getattr(inner, "model", None)
    if not isinstance(model, mujoco.MjModel):
        raise ParameterError(
            f"{type(inner).__name__} has no MuJoCo model (env.unwrapped.model) to change. A stack that builds its own, "
            "as Isaac Lab or Playground, needs a function that returns a Gymnasium environment with "
            "`model` and `frame_skip`: --env module:function --trust"
        )
    for name, text in settings.items():
        if ":" in name:
            _write_elements(model, name, text)
        elif name == "timestep":
            interval_s = inner.frame_skip * model.opt.timestep
            model.opt.timestep = _numbers(name, text, 1)[0]
            inner.frame_skip = _steps(interval_s, model.opt.timestep)
        else:
            _write_option(model, name, text)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    if advice := sparse_advice(model):
        name = env.spec.id if env.spec is not None else type(inner).__name__
        warnings.warn(f"{name}: {advice}", stacklevel=2)


def _steps(interval_s: float, step_s: float) -> int:
    count = round(interval_s / step_s) if step_s > 0.0 else 0
    if count < 1 or abs(count * step_s / interval_s - 1.0) > MULTIPLE:
        raise ParameterError(
            f"{interval_s:.6g} s between actions are no multiple of the time step {step_s:g} s"
        )
    return count


def _numbers(name: str, text: str, largest_count: int) -> list[float]:
    try:
        values = [float(one) for one in text.split()]
    except ValueError:
        values = []
    if not 1 <= len(values) <= largest_count:
        raise ParameterError(f"{name}={text}: expected 1 to {largest_count} numbers")
    return values


def _write_option(model: mujoco.MjModel, name: str, text: str) -> None:
    known = [one for one in dir(model.opt) if not one.startswith("_")]
    if name not in known:
        raise ParameterError(
            f"{name}: no option of MuJoCo. Known: {', '.join(known)}; or KIND:PATTERN.attribute, as geom:*.friction"
        )
    before = getattr(model.opt, name)
    if name in ENUMS and not text.isdigit():
        prefix, values_by_name = ENUMS[name]
        kinds = {
            key.removeprefix(prefix).lower(): value
            for key, value in values_by_name.__members__.items()
        }
        if text.lower() not in kinds:
            raise ParameterError(f"{name}={text}: known are {', '.join(kinds)}")
        setattr(model.opt, name, kinds[text.lower()])
        return
    values = _numbers(name, text, np.size(before))
    if np.ndim(before):
        before[: len(values)] = values
    else:
        setattr(model.opt, name, type(before)(values[0]))


def _write_elements(model: mujoco.MjModel, name: str, text: str) -> None:
    kind, _, rest = name.partition(":")
    pattern, _, field = rest.rpartition(".")
    if field not in FIELDS.get(kind, ()):
        known = "; ".join(
            f"{one}: {', '.join(sorted(fields))}" for one, fields in FIELDS.items()
        )
        raise ParameterError(f"{name}: expected KIND:PATTERN.attribute with {known}")
    count = {
        "geom": model.ngeom,
        "pair": model.npair,
        "joint": model.njnt,
        "actuator": model.nu,
    }[kind]
    chosen = [row for row in range(count) if _is_named(model, kind, row, pattern)]
    if not chosen:
        raise ParameterError(f"{name}: no {kind} of the model has such a name")
    prefix, rows = kind, chosen
    if kind == "joint" and field != "stiffness":
        prefix = "dof"
        rows = [dof for dof in range(model.nv) if int(model.dof_jntid[dof]) in chosen]
    if kind == "joint" and field == "stiffness":
        prefix = "jnt"
    if field in ("kp", "kv"):
        (value,) = _numbers(name, text, 1)
        model.actuator_biasprm[rows, 1 if field == "kp" else 2] = -value
        if field == "kp":
            model.actuator_gainprm[rows, 0] = value
        return
    table = getattr(model, f"{prefix}_{field}")
    values = _numbers(name, text, 1 if table.ndim == 1 else table.shape[1])
    if table.ndim == 1:
        table[rows] = values[0]
    else:
        table[rows, : len(values)] = values


def _is_named(model: mujoco.MjModel, kind: str, row: int, pattern: str) -> bool:
    names = [getattr(model, kind)(row).name]
    if kind == "geom":
        names.append(model.body(model.geom_bodyid[row]).name)
    return any(fnmatch.fnmatchcase(name, pattern) for name in names)


def replay_settings(
    name: str,
    make: Callable[[], gymnasium.Env[Any, Any]],
    policies: Mapping[str, Policy],
    training: Mapping[str, str],
    test: Mapping[str, str],
    *,
    seeds: int,
    notify: Callable[[str], None] = lambda _: None,
) -> SettingsReport:
    """Replay policies with two sets of settings, from the same seeds.

    Args:
        name: Name of the environment.
        make: Function that makes it.
        policies: Policies by name.
        training: Settings of the training, in place of the environment's.
        test: Other settings, in place of the environment's.
        seeds: Number of seeds: 0 and so on.
        notify: Called with what is being done.
    """
    played = []
    for title, settings in (("training", training), ("test", test)):
        notify(title)
        with closing(make()) as env:
            apply_settings(env, settings)
            episodes = [
                _episode(env, policy, seed)
                for policy in policies.values()
                for seed in range(seeds)
            ]
        played.append(np.array(episodes).reshape(len(policies), seeds, 3))
    rows = [
        _row(settings, one, played[0])
        for settings, one in zip((training, test), played, strict=True)
    ]
    kept, change = rows[1].kept, rows[1].change
    if kept is not None:
        falls = (kept.value if kept.high is None else kept.high) < FALL_SHARE
    else:
        falls = (change.value if change.high is None else change.high) < 0.0
    return SettingsReport(
        env=name,
        policies=tuple(policies),
        seeds=seeds,
        training=rows[0],
        test=rows[1],
        falls=falls,
    )


def _episode(
    env: gymnasium.Env[Any, Any], policy: Policy, seed: int
) -> tuple[float, float, float]:
    """Return reward, success (NaN where it is not stated) and whether an episode does not end early."""
    observation, _ = env.reset(seed=seed)
    total, success = 0.0, np.nan
    while True:
        observation, reward, ended, cut, info = env.step(
            policy(np.asarray(observation, dtype=np.float64))
        )
        total += float(reward)
        stated = info.get("is_success", info.get("success"))
        if stated is not None:
            success = float(stated)
        if not np.isfinite(total):
            raise GaugeError(
                f"seed {seed}: the reward is {total}: the simulation diverges"
            )
        if ended or cut:
            return total, success, float(not ended)


def _row(
    settings: Mapping[str, str],
    played: FloatArray,
    trained: FloatArray,
) -> SettingsRow:
    rewards, promised = played[..., 0], float(trained[..., 0].mean())
    mean, kept = float(rewards.mean()), None
    difference = rewards - trained[..., 0]
    if promised > 0.0:
        share = mean / promised
        # A share is a ratio of means: to first order its error is the mean of these deviations.
        kept = estimate(share, (rewards - share * trained[..., 0]) / promised)
    return SettingsRow(
        settings=settings,
        reward=estimate(mean, rewards),
        kept=kept,
        change=estimate(float(difference.mean()), difference),
        success=success_share(played[..., 1].ravel()),
        full_length=float(played[..., 2].mean()),
    )
