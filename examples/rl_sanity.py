"""Train a policy in one configuration of a simulator, then ask the law and better simulators what it is worth.

The task is to use as much of a cube's friction as there is (docs/control.md). A policy is trained with MuJoCo as it
comes, or with its contacts set with care, and replayed without exploration where contacts follow the law: MuJoCo as
this package sets it, the same with half the step, Newton, and at the edges of the measured friction.

Takes about two minutes on two cores. Needs pip install 'gauge-envs[rl]'.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np
import torch
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table
from stable_baselines3 import PPO
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from gauge_envs.envs.control.env import ControlEnv
from gauge_envs.envs.control.friction import SLIP_SPEED_M_PER_S, FrictionLimit
from gauge_envs.envs.control.limit import Ending, LimitReport
from gauge_envs.envs.control.play import Policy, engine_limit, play
from gauge_envs.errors import MissingExtraError

SEED = 0


class Training(StrEnum):
    """Configuration of MuJoCo in which the policy is trained."""

    OUT_OF_BOX = "out_of_box"
    """What a model has that states nothing, at the nearest step that divides the environment's 1/180 s."""
    CAREFUL = "careful"
    """This package's contacts, with the longest step that they allow."""


SETTINGS: Mapping[Training, Mapping[str, Any]] = {
    Training.OUT_OF_BOX: {"preset": "out_of_box", "timestep_s": 1 / 540, "drive_interval_s": 1 / 180},
    Training.CAREFUL: {"timestep_s": 1 / 1080},
}


@dataclass(frozen=True, kw_only=True)
class Replay:
    """One run of the trained policy.

    Attributes:
        name: Where it ran.
        report: What it reached beside what the law allows.
        course: Observations of its frames, shape [frame_count, 5].
    """

    name: str
    report: LimitReport
    course: NDArray[np.float64]

    @property
    def held(self) -> bool:
        """Whether the cube stayed where it was."""
        return self.report.ending is Ending.HELD


def make_task(task: str, **arguments: Any) -> ControlEnv:
    """The bare environment of a control task."""
    env = gym.make(f"GAUGE/{task}", **arguments).unwrapped
    if not isinstance(env, FrictionLimit):
        raise typer.BadParameter(
            f"{task} is not one of the tasks with friction: Turntable-Limit-*, SlopeSlider-Limit-*"
        )
    return env


def train(task: str, settings: Mapping[str, Any], steps: int, *, hide_slip: bool) -> Policy:
    """PPO, with observations scaled to unit variance; deterministic afterwards."""

    def seen(observation: NDArray[np.float64]) -> NDArray[np.float64]:
        shown = observation.copy()
        if hide_slip:
            shown[FrictionLimit.OBSERVED.index("slip_over_threshold")] = 0.0
        return shown

    def world() -> gym.Env:
        env = make_task(task, settings=settings)
        return Monitor(gym.wrappers.TransformObservation(env, seen, env.observation_space))

    # The networks are so small that threads cost more than they bring.
    torch.set_num_threads(1)
    scaled = VecNormalize(DummyVecEnv([world] * 4), norm_reward=False)
    model = PPO(
        "MlpPolicy",
        scaled,
        n_steps=300,
        batch_size=300,
        # Falls to 0, so that the policy settles this side of the limit.
        learning_rate=lambda left: 1e-3 * left,
        gamma=0.98,
        # An action of 0.4 changes the rate by a thirtieth of what is reached: more noise falls off the limit.
        policy_kwargs={"log_std_init": -1.0, "net_arch": [32, 32]},
        seed=SEED,
        device="cpu",
    )
    model.learn(steps, progress_bar=False)
    return lambda observation: model.predict(scaled.normalize_obs(seen(observation)), deterministic=True)[0]


def replays(task: str, policy: Policy, training: Training) -> list[Replay]:
    """The policy where it was trained, where contacts follow the law, and at the edges of the measured friction."""
    limit = make_task(task).limit
    worlds: dict[str, dict[str, Any]] = {
        f"MuJoCo, {training.value}: as trained": {"settings": SETTINGS[training]},
        "MuJoCo, default": {},
        "MuJoCo, half the step": {"settings": {"timestep_s": 1 / 18000}},
        "Newton, default": {"backend": "newton"},
        "MuJoCo, friction - 2 sigma": {"parameters": {"cube.friction": limit.value - 2 * limit.sigma}},
        "MuJoCo, friction + 2 sigma": {"parameters": {"cube.friction": limit.value + 2 * limit.sigma}},
    }
    done = []
    for name, arguments in track(worlds.items(), description="replaying", console=Console(stderr=True), transient=True):
        try:
            env = make_task(task, **arguments)
        except MissingExtraError as error:
            print(f"left out: {name}: {error}")
            continue
        report = play(env, policy, seed=SEED)
        done.append(Replay(name=name, report=report, course=env.trajectory()))
    return done


def verdict(runs: list[Replay], engine_share: float) -> str:
    """What the replays say of the policy, in a sentence."""
    trained, *others = runs
    edges = [run for run in others if "sigma" in run.name]
    checks = [run for run in others if run not in edges]
    slipped = [run for run in checks if not run.held]
    uses = f"uses {trained.report.ratio:.2f} of what the law allows"
    if trained.held and len(slipped) == len(checks):
        first = min(run.report.time_s for run in slipped)
        return (
            f"The policy lives on its simulator's error. There it {uses}, and the cube holds; wherever contacts follow "
            f"the law the cube slips, first after {first:.1f} s. (The law's own policy can use {engine_share:.2f} in "
            "that simulator before its cube slips.)"
        )
    if slipped:
        names = "; ".join(f"{run.name} ({run.report.time_s:.1f} s)" for run in slipped)
        return (
            f"The policy depends on its simulator: it {uses} there, and the cube slips in {len(slipped)} of "
            f"{len(checks)} others: {names}."
        )
    weak = [run.name for run in edges if not run.held]
    if weak:
        return (
            f"The policy does not live on its simulator's error: it {uses}, and the cube holds wherever contacts "
            f"follow the law. It does live on a constant, within whose uncertainty the cube slips: {'; '.join(weak)}."
        )
    return f"The policy holds everywhere, and {uses}: reality will pay it."


def table(runs: list[Replay]) -> Table:
    """One row a replay."""
    rows = Table(box=None, header_style="bold", pad_edge=False)
    for title in ("replay", "law allows", "used for 1 s", "ratio", "z", "cube"):
        rows.add_column(title, justify="left" if title in ("replay", "cube") else "right", no_wrap=True)
    for run in runs:
        report = run.report
        rows.add_row(
            run.name,
            f"{report.limit.value:.3f} +- {report.limit.sigma:.3f}",
            f"{report.reached:.3f}",
            f"{report.ratio:.2f}",
            f"{report.z:+.1f}",
            "[green]held[/]" if run.held else f"[red]{report.ending.value} after {report.time_s:.2f} s[/]",
        )
    return rows


def draw(runs: list[Replay], task: str, path: Path) -> None:
    """Friction used and motion of the cube over time; a cross where it slips."""
    figure, (above, below) = plt.subplots(2, 1, figsize=(8, 7), sharex=True, height_ratios=(3, 2), layout="constrained")
    limit = runs[1].report.limit
    above.axhspan(limit.value - 2 * limit.sigma, limit.value + 2 * limit.sigma, color="0.9", label="law, +- 2 sigma")
    above.axhline(limit.value, color="0.4", lw=1, label="law, calibrated friction")
    below.axhline(1e3 * SLIP_SPEED_M_PER_S, color="0.4", lw=1, label="counts as a slip")
    for number, run in enumerate(runs):
        _, _, used, slip, time_s = run.course.T
        slip_mm_per_s = 1e3 * SLIP_SPEED_M_PER_S * slip
        style = {"color": f"C{number}", "ls": ("-", "--", ":", "-.", "-", "--")[number % 6], "lw": 1.6}
        above.plot(time_s, used, label=run.name, **style)
        below.plot(time_s, slip_mm_per_s, **style)
        if not run.held:
            above.plot(time_s[-1], used[-1], "X", color=style["color"], ms=9, mec="w")
            below.plot(time_s[-1], slip_mm_per_s[-1], "X", color=style["color"], ms=9, mec="w")
    above.set(ylabel="friction used", ylim=(0.0, 1.25 * limit.value), title=f"{task}: a trained policy, replayed")
    below.set(ylabel="speed of the cube on it [mm/s]", xlabel="time [s]", yscale="symlog", ylim=(0.0, 100.0))
    figure.legend(fontsize=8, loc="outside lower center", ncols=3)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def main(
    task: Annotated[str, typer.Option(help="A control task with friction.")] = "Turntable-Limit-wood",
    training: Annotated[Training, typer.Option(help="Configuration to train in.")] = Training.OUT_OF_BOX,
    hide_slip: Annotated[
        bool, typer.Option("--hide-slip", help="Do not show the policy how the cube creeps, as no real sensor would.")
    ] = False,
    steps: Annotated[int, typer.Option(min=1, help="Steps of training.")] = 50_000,
    out: Annotated[Path, typer.Option(help="Picture to write.")] = Path("rl_sanity.png"),
) -> None:
    """Train a policy, replay it elsewhere, and say what it lives on."""
    policy = train(task, SETTINGS[training], steps, hide_slip=hide_slip)
    runs = replays(task, policy, training)
    # Where there is no terminal, rich would cut the table to 80 characters.
    console = Console(width=None if Console().is_terminal else 120)
    console.print(table(runs))
    share = engine_limit(make_task(task, settings=SETTINGS[training]), bounds=(0.05, 1.5), resolution=0.01)
    console.print(f"\n{verdict(runs, share)}")
    draw(runs, task, out)
    console.print(f"picture: {out}")


if __name__ == "__main__":
    typer.run(main)
