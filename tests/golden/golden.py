"""Golden numbers: results before a change, which `test_every_id.py` compares.

    python -m tests.golden.golden                                    # all numbers
    python -m tests.golden.golden --only jitter                      # one part
    python -m tests.golden.golden --only episodes SlopeSlider-1-wood

Each part has a function that returns plain numbers and texts for a name. The numbers are those of version 0.3.0, but
for the scores against ten of the 17 newer references: TextileStretching, FoamBending and CantileverBeam. Funnel and
RopeWinding have no score here. They are a rail for the
clean-up before 1.0. This folder leaves with the release of 1.1.
"""

import argparse
import json
import warnings
from pathlib import Path

import gymnasium
import numpy as np

from gauge_envs import load_experiment

FILE = Path(__file__).with_name("golden.json")

CHAOTIC = ("Funnel", "RopeWinding", "RotatingBall", "WallBreaking")
"""Families with chaotic motions: only ten frames count, and no score."""

LAST_FRAME = dict.fromkeys(CHAOTIC, 10) | {
    "NewtonsCradle": 170,
    "TableclothPulling": 60,
    "TextileFlinging": 150,
}
"""Last compared frame of g(t) by family; rounding affects later frames."""

SCORE_FIELDS = (
    "rmse",
    "dtw",
    "time_offset_s",
    "rmse_aligned",
    "compared_frames",
    "rmse_normalized",
    "dtw_normalized",
    "rmse_aligned_normalized",
)


def family_of(name):
    """Return the family of an experiment, as `SlopeSlider`."""
    return name.partition("-")[0]


def chosen_frames(name, last):
    """Return the first three frames and up to seven later ones."""
    last = min(last, LAST_FRAME.get(family_of(name), last))
    later = np.linspace(min(4, last), last, 7).round().astype(int)
    return sorted({1, 2, 3, *later.tolist()})


def episode(name, *, engine="mujoco", seed=0, options=None, last_frame=None):
    """Return the start, g(t) at ten frames, reward sum and score of an episode without actions.

    With `last_frame` the episode stops there, and has no reward sum and no score.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        env = gymnasium.make(f"GAUGE/{name}", backend=engine)
        observation, info = env.reset(seed=seed, options=options)
    length = env.spec.max_episode_steps
    frames = chosen_frames(name, length)
    is_chaotic = family_of(name) in CHAOTIC
    last = last_frame or (frames[-1] if is_chaotic else length)
    start = observation["bodies" if "bodies" in observation else "markers"]
    entry = {"start": start, "g": {}, "markers": {}}
    rewards = []
    action = np.zeros(env.action_space.shape, env.action_space.dtype)
    for frame in range(1, last + 1):
        observation, reward, _, _, info = env.step(action)
        rewards.append(reward)
        if frame in frames:
            entry["g"][str(frame)] = observation["observable"]
            entry["markers"][str(frame)] = observation.get("markers", [])
    if load_experiment(name).score.observable.unit == "mm":
        del entry["markers"]
    if last_frame is None and not is_chaotic:
        score = info["score"]
        entry |= {"reward": sum(rewards), "score": score_values(score)}
        if engine == "mujoco" and options is None and last_frame is None:
            entry["answers"] = [score.solves, score.like_reality]
    env.close()
    return entry


def score_values(score):
    """Return the known numbers of a score."""
    values = {name: getattr(score, name) for name in SCORE_FIELDS}
    for name, event in score.events.items():
        if name in ("lsd", "mte", "pd"):
            values[name] = [event.value, event.over_real]
        elif name == "el":
            values[name] = event.value
    values["estimates"] = {
        name: [
            estimate.value,
            estimate.uncertainty,
            estimate.real,
            estimate.real_uncertainty,
        ]
        for name, estimate in score.estimates.items()
    }
    if score.primary == "solution_distance" and score.distance is not None:
        values["distance"] = score.distance
        values["motion"] = score.solution_motion
    absent = (None, {}, [None, None])
    return {key: value for key, value in values.items() if value not in absent}


def jittered(name):
    """Return the episode with initial-state noise of seed 1."""
    return episode(name, seed=1, options={"jitter": True})


def trial(name):
    """Return the episode of a bundled trial, as `CubePush-light/0`."""
    name, number = name.split("/")
    return episode(name, options={"trial": int(number)})


def on_engine(name):
    """Return an episode on another engine, as `newton/SlopeSlider-1-metal`."""
    engine, name = name.split("/")
    return episode(name, engine=engine)


PARTS = {
    "episodes": episode,
    "jitter": jittered,
    "trial": trial,
    "engines": on_engine,
}


def plain(value):
    """Return a value as plain JSON; numbers have ten digits, because tolerances are wider."""
    if isinstance(value, dict):
        return {key: plain(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, float | np.floating):
        return float(f"{value:.10g}")
    return value


def read():
    """Return the stored entries by part and name."""
    return json.loads(FILE.read_text(encoding="utf-8"))


def write(parts):
    """Write the file with one line per entry, so that a diff shows the changes."""
    texts = []
    for part, entries in parts.items():
        lines = [
            f"{json.dumps(key)}: {json.dumps(entry)}" for key, entry in entries.items()
        ]
        texts.append(json.dumps(part) + ": {\n" + ",\n".join(lines) + "\n}")
    FILE.write_text("{\n" + ",\n".join(texts) + "\n}\n", encoding="utf-8")


def main():
    """Compute the entries of the file again, and add missing names."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--only", choices=PARTS, help="one part")
    parser.add_argument("names", nargs="*", help="entries of that part")
    given = parser.parse_args()
    parts = read()
    for part in [given.only] if given.only else PARTS:
        for name in given.names or parts[part]:
            parts[part][name] = plain(PARTS[part](name))
        write(parts)


if __name__ == "__main__":
    main()
