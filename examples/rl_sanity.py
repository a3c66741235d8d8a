"""Train a policy in one configuration of a simulator, and compare it with the law and with better simulators.

The task is to use as much of a cube's friction as the law allows (docs/control.md). The policy is trained in MuJoCo
with the engine's default contacts or with those of this package. It is then replayed without exploration where contacts
follow the law: MuJoCo with this package's preset, the same with half the step, Newton, and with the friction at the
edges of its uncertainty.

Takes about two minutes on two cores. Needs pip install "./gauge-envs[rl]".
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

from gauge_envs.errors import MissingExtraError
from gauge_envs.tools.control.env import ControlEnv, Policy, play_paid
from gauge_envs.tools.control.friction import SLIP_SPEED_M_PER_S, FrictionLimit
from gauge_envs.tools.control.task import Ending, LimitReport

SEED = 0


class Training(StrEnum):
    """Configuration of MuJoCo in which the policy is trained."""

    OUT_OF_BOX = "out_of_box"
    """MuJoCo's defaults, with the nearest step that divides the environment's 1/180 s."""
    CAREFUL = "careful"
    """The contacts of this package's preset, with the longest step that they allow."""


SETTINGS: Mapping[Training, Mapping[str, Any]] = {
    Training.OUT_OF_BOX: {"preset": "out_of_box", "timestep_s": 1 / 540, "drive_interval_s": 1 / 180},
    Training.CAREFUL: {"timestep_s": 1 / 1080},
}


@dataclass(frozen=True, kw_only=True)
class Replay:
    """One run of the trained policy.

    Attributes:
        name: Name of the simulator and its configuration.
        report: Result of the policy, and limit of the law.
        trajectory: Observations of its frames, shape [frame_count, 5].
    """

    name: str
    report: LimitReport
    trajectory: NDArray[np.float64]

    @property
    def holds(self) -> bool:
        """Whether the cube holds to the end."""
        return self.report.ending is Ending.HELD


def make_task(task: str, **arguments: Any) -> ControlEnv:
    """Return the environment of a control task without wrappers."""
    env = gym.make(f"GAUGE/{task}", **arguments).unwrapped
    if not isinstance(env.task, FrictionLimit):
        raise typer.BadParameter(
            f"{task} is not one of the tasks with friction: Turntable-Limit-*, SlopeSlider-Limit-*"
        )
    return env


def train(task: str, settings: Mapping[str, Any], steps: int, *, hide_slip: bool) -> Policy:
    """Train with PPO on observations of unit variance, and return the deterministic policy."""

    def seen(observation: NDArray[np.float64]) -> NDArray[np.float64]:
        shown = observation.copy()
        if hide_slip:
            shown[FrictionLimit.OBSERVED.index("slip_over_threshold")] = 0.0
        return shown

    def world() -> gym.Env:
        env = make_task(task, settings=settings)
        return Monitor(gym.wrappers.TransformObservation(env, seen, env.observation_space))

    # With networks this small, threads only add cost.
    torch.set_num_threads(1)
    scaled = VecNormalize(DummyVecEnv([world] * 4), norm_reward=False)
    model = PPO(
        "MlpPolicy",
        scaled,
        n_steps=300,
        batch_size=300,
        # The rate falls to 0, so that the policy settles below the limit.
        learning_rate=lambda left: 1e-3 * max(left, 0.0),
        gamma=0.98,
        # An action of 0.4 changes the angular rate by 1/30 of its final value; more noise would cause slips.
        policy_kwargs={"log_std_init": -1.0, "net_arch": [32, 32]},
        seed=SEED,
        device="cpu",
    )
    model.learn(steps, progress_bar=False)
    return lambda observation: model.predict(scaled.normalize_obs(seen(observation)), deterministic=True)[0]


def replays(task: str, policy: Policy, training: Training) -> list[Replay]:
    """Replay the policy as trained, where contacts follow the law, and at the edges of the measured friction."""
    limit = make_task(task).task.limit()
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
        _, report = play_paid(env, policy, seed=SEED)
        done.append(Replay(name=name, report=report, trajectory=env.trajectory()))
    return done


def verdict(runs: list[Replay]) -> str:
    """Return the conclusion from the replays, in a few sentences."""
    trained, *replayed = runs
    edges = [run for run in replayed if "sigma" in run.name]
    checks = [run for run in replayed if run not in edges]
    slipped = [run for run in checks if not run.holds]
    uses = f"uses {trained.report.ratio:.2f} of what the law allows"
    if trained.holds and len(slipped) == len(checks):
        first = min(run.report.time_s for run in slipped)
        return (
            f"The policy exploits an error of its simulator. There it {uses}, and the cube holds. In every simulator "
            f"whose contacts follow the law the cube slips, first after {first:.1f} s."
        )
    if slipped:
        names = "; ".join(f"{run.name} ({run.report.time_s:.1f} s)" for run in slipped)
        return (
            f"The policy depends on its simulator: it {uses} there, and the cube slips in {len(slipped)} of "
            f"{len(checks)} others: {names}."
        )
    weak = [run.name for run in edges if not run.holds]
    if weak:
        return (
            f"The policy does not exploit an error of its simulator: it {uses}, and the cube holds wherever contacts "
            f"follow the law. It depends on a constant: the cube slips within its uncertainty: {'; '.join(weak)}."
        )
    return f"The policy {uses}, and the cube holds in every replay."


def table(runs: list[Replay]) -> Table:
    """Return a table with one row for each replay."""
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
            "[green]held[/]" if run.holds else f"[red]{report.ending.value} after {report.time_s:.2f} s[/]",
        )
    return rows


def draw(runs: list[Replay], task: str, path: Path) -> None:
    """Draw the friction used and the motion of the cube over time, with a cross at each slip."""
    figure, (above, below) = plt.subplots(2, 1, figsize=(8, 7), sharex=True, height_ratios=(3, 2), layout="constrained")
    limit = runs[1].report.limit
    above.axhspan(limit.value - 2 * limit.sigma, limit.value + 2 * limit.sigma, color="0.9", label="law, +- 2 sigma")
    above.axhline(limit.value, color="0.4", lw=1, label="law, published friction")
    below.axhline(1e3 * SLIP_SPEED_M_PER_S, color="0.4", lw=1, label="counts as a slip")
    for number, run in enumerate(runs):
        _, _, used, slip, time_s = run.trajectory.T
        slip_mm_per_s = 1e3 * SLIP_SPEED_M_PER_S * slip
        style = {"color": f"C{number}", "ls": ("-", "--", ":", "-.", "-", "--")[number % 6], "lw": 1.6}
        above.plot(time_s, used, label=run.name, **style)
        below.plot(time_s, slip_mm_per_s, **style)
        if not run.holds:
            above.plot(time_s[-1], used[-1], "X", color=style["color"], ms=9, mec="w")
            below.plot(time_s[-1], slip_mm_per_s[-1], "X", color=style["color"], ms=9, mec="w")
    above.set(ylabel="friction used", ylim=(0.0, 1.25 * limit.value), title=f"{task}: a trained policy, replayed")
    below.set(ylabel="speed of the slip [mm/s]", xlabel="time [s]", yscale="symlog", ylim=(0.0, 100.0))
    figure.legend(fontsize=8, loc="outside lower center", ncols=3)
    figure.savefig(path, dpi=130)
    plt.close(figure)


def main(
    task: Annotated[str, typer.Option(help="A control task with friction.")] = "Turntable-Limit-wood",
    training: Annotated[Training, typer.Option(help="Configuration to train in.")] = Training.OUT_OF_BOX,
    hide_slip: Annotated[
        bool, typer.Option("--hide-slip", help="Hide the creep of the cube from the policy, as a real sensor would.")
    ] = False,
    steps: Annotated[int, typer.Option(min=1, help="Steps of training.")] = 50_000,
    out: Annotated[Path, typer.Option(help="Picture to write.")] = Path("rl_sanity.png"),
) -> None:
    """Train a policy, replay it in other simulators, and print a conclusion."""
    policy = train(task, SETTINGS[training], steps, hide_slip=hide_slip)
    runs = replays(task, policy, training)
    # Without a terminal, rich would cut the table to 80 characters.
    console = Console(width=None if Console().is_terminal else 120)
    console.print(table(runs))
    console.print(f"\n{verdict(runs)}")
    draw(runs, task, out)
    console.print(f"picture: {out}")


if __name__ == "__main__":
    typer.run(main)
