"""Draw the learning curves of the cloth (`curves.png`), and film a policy (`policy.gif`).

    python studies/learned_cloth/learned_cloth.py trained --out studies/learned_cloth

The folder holds Fling-Limit-satin-SEED.csv, .zip and .pkl of `examples/train_control.py`. The film shows the first seed
with the default preset of MuJoCo, beside the law's policy. It needs the extra `rl`, matplotlib and Pillow.
"""

from __future__ import annotations

import argparse
import csv
import pickle
from pathlib import Path

import gymnasium
import numpy as np
from matplotlib.figure import Figure
from PIL import Image
from stable_baselines3 import PPO

import gauge_envs  # noqa: F401  # registers the ids
from gauge_envs.tools.control.fling import FlingLimit
from gauge_envs.tools.control.play import Policy, play

TASK = "Fling-Limit-satin"
SHARE = 0.8
"""Share of the law's policy that the training is to reach."""
FRAME_MS = 66
"""Time of a picture, of which every second frame has one: real time."""


def draw_curves(folder: Path, file: Path) -> None:
    """Draw the ratio to the law's limit over steps and processor time, and write the rows of all seeds."""
    rows = []
    for path in sorted(folder.glob(f"{TASK}-*.csv")):
        with path.open(newline="") as opened:
            rows += [
                {"seed": path.stem.rpartition("-")[2], **row}
                for row in csv.DictReader(opened)
            ]
    with file.with_suffix(".csv").open("w", newline="") as opened:
        writer = csv.DictWriter(opened, [*rows[0]])
        writer.writeheader()
        writer.writerows(rows)
    env = FlingLimit("satin", settings={"preset": "training"})
    law = play(env, lambda _: env.law_action(1.0)).ratio
    figure = Figure(figsize=(6.5, 3.4), layout="constrained")
    axis = figure.subplots()
    for seed in sorted({row["seed"] for row in rows}):
        own = [row for row in rows if row["seed"] == seed]
        axis.plot(
            [1e-3 * float(row["steps"]) for row in own],
            [float(row["ratio"]) for row in own],
            label=f"seed {seed}",
        )
    axis.axhline(law, color="#303030", lw=1, ls="--", label="the law's policy")
    axis.axhline(SHARE * law, color="#303030", lw=1, ls=":", label=f"{SHARE:.0%} of it")
    axis.set(
        xlabel="steps [thousands]",
        ylabel="rise over the law's limit (0 if U is left)",
        ylim=(0.0, 0.7),
    )
    axis.legend(loc="lower right", fontsize=8)
    figure.savefig(file, dpi=110)


def film(policies: list[Policy | None], file: Path) -> None:
    """Write a film of policies side by side with the default preset; None stands for the law's policy."""
    columns = []
    for policy in policies:
        env = gymnasium.make(
            f"GAUGE/{TASK}", render_mode="rgb_array", width=240, height=200
        )
        observation, _ = env.reset(seed=0)
        pictures, over = [env.render()], False
        while not over:
            action = (
                env.unwrapped.law_action(1.0) if policy is None else policy(observation)
            )
            observation, _, terminated, truncated, _ = env.step(action)
            over = terminated or truncated
            pictures.append(env.render())
        columns.append(pictures[::2])
        env.close()
    longest = max(map(len, columns))
    rows = zip(
        *([*column, *[column[-1]] * (longest - len(column))] for column in columns),
        strict=True,
    )
    frames = [
        Image.fromarray(np.hstack(row)).quantize(32, dither=Image.Dither.NONE)
        for row in rows
    ]
    frames[0].save(
        file,
        save_all=True,
        append_images=frames[1:],
        duration=FRAME_MS,
        loop=0,
        optimize=True,
    )


def main() -> None:
    """Draw and film the trainings of a folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path())
    arguments = parser.parse_args()
    draw_curves(arguments.folder, arguments.out / "curves.png")
    first = sorted(arguments.folder.glob(f"{TASK}-*.zip"))[0]
    model, scaled = (
        PPO.load(first, device="cpu"),
        pickle.loads(first.with_suffix(".pkl").read_bytes()),
    )

    def learned(observation):
        return model.predict(scaled.normalize_obs(observation), deterministic=True)[0]

    film([learned, None], arguments.out / "policy.gif")


if __name__ == "__main__":
    main()
