"""Golden numbers: what the suite computed before a change, for `test_golden.py` to compare with.

    python -m tests.golden.golden                           # make the whole file again
    python -m tests.golden.golden --only fabrics            # one part
    python -m tests.golden.golden --only episodes SlopeSlider-1-wood

Each part has a function that makes an entry of plain numbers and texts from its name. The names are those of the
file, also of the conformance checks. Only these functions use the package: when its code changes, change one of them,
and the file stays as it is.
"""

import argparse
import hashlib
import json
import warnings
from pathlib import Path

import gymnasium
import numpy as np

from gauge_envs import load_experiment
from gauge_envs.experiments.task_files import fabrics
from gauge_envs.references.published import published_baselines
from gauge_envs.tools.conformance import run_checks
from gauge_envs.tools.recipes.fabrics import fabric_constants
from gauge_envs.tools.sanity import check

FILE = Path(__file__).with_name("golden.json")
ASSETS = Path(__file__).parents[2] / "assets"

CHAOTIC = ("Funnel", "RopeWinding", "RotatingBall", "WallBreaking")
"""Families whose motions part by chaos: ten frames of them count, and no score."""

LAST_FRAME = dict.fromkeys(CHAOTIC, 10) | {
    "NewtonsCradle": 170,
    "TableclothPulling": 60,
    "TextileFlinging": 150,
}
"""Last frame of g(t) by family, where rounding decides later ones."""


# --- parts -----------------------------------------------------------------------------------------------------------


def episode(name, *, engine="mujoco", seed=0, options=None, last_frame=None):
    """Return the start, g(t) at ten frames, reward sum and score of an episode; the first two up to `last_frame`."""
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
        entry |= {"reward": sum(rewards), "score": score_values(info["score"])}
    env.close()
    return entry


def family_of(name):
    """Return the family of an experiment, as `SlopeSlider`."""
    return name.partition("-")[0]


def chosen_frames(name, last):
    """Return the first frames and some up to the last one, ten where an episode has as many."""
    last = min(last, LAST_FRAME.get(family_of(name), last))
    later = np.linspace(min(4, last), last, 7).round().astype(int)
    return sorted({1, 2, 3, *later.tolist()})


def score_values(score):
    """Return the numbers of a score that any later form of it has too."""
    names = (
        "rmse",
        "dtw",
        "time_offset_s",
        "rmse_aligned",
        "compared_frames",
        "signed_error",
        "rmse_normalized",
        "dtw_normalized",
        "rmse_aligned_normalized",
        "mean_abs_z",
        "inside_1sigma",
        "inside_2sigma",
        "percentile",
    )
    values = {name: getattr(score, name) for name in names}
    events = {
        name: one for name, one in score.events.items() if name in ("lsd", "mte", "pd")
    }
    values |= {name: [one.value, one.over_real] for name, one in events.items()}
    values["el"] = score.events["el"].value if "el" in score.events else None
    values["estimates"] = {
        name: [one.value, one.uncertainty, one.real, one.real_uncertainty]
        for name, one in score.estimates.items()
    }
    if score.over_uncertainty is not None:
        values["distance"] = score.distance
        values["uncertainty"] = score.distance / score.over_uncertainty
    return {
        key: value
        for key, value in values.items()
        if value not in (None, {}, [None, None])
    }


def jittered(name):
    """Return the episode of a start that is scattered by seed 1."""
    return episode(name, seed=1, options={"jitter": True})


def trial(name):
    """Return the episode of a bundled trial, as `CubePush-light/0`."""
    name, number = name.split("/")
    return episode(name, options={"trial": int(number)})


def on_engine(name):
    """Return an episode on another engine, as `newton/SlopeSlider-1-metal`."""
    engine, name = name.split("/")
    return episode(name, engine=engine)


def conformance(engine):
    """Return verdict, value and tolerance of each check on an engine."""
    return {
        one.check: [one.status.value, one.measured, one.width]
        for one in run_checks(engine, only=tuple(read()["conformance"]["mujoco"]))
    }


def sanity(target):
    """Return value, unit and verdict of each phenomenon that a training configuration shows."""
    return {
        row.phenomenon: [row.configured, row.unit, row.verdict.value]
        for row in check(
            target,
            only=tuple(read()["sanity"][target]),
            include_deformables=True,
            explain=False,
        ).rows
    }


def asset(name):
    """Return the sha256 of a checked-in file, whose numbers the writer repeats but for their last digits."""
    return hashlib.sha256((ASSETS / name).read_bytes()).hexdigest()


def asset_text(name):
    """Return what the writer makes of a scene today, as `mjcf/SlopeSlider-1-wood.xml`."""
    # It needs a library for USD, which an environment for one engine alone need not have.
    from gauge_envs.tools.assets.export import mjcf_text, usd_layer_text

    experiment = load_experiment(Path(name).stem)
    return (
        mjcf_text(experiment) if name.startswith("mjcf") else usd_layer_text(experiment)
    )


def fabric(name):
    """Return the constants of a fabric in each engine's own terms."""
    mapped = fabric_constants(fabrics("TextileFlinging")[name])
    return {engine: dict(one.constants) for engine, one in mapped.items()}


def published(name):
    """Return the rows of the published table for a variant, by metric."""
    return {
        row.metric: [row.frames, row.unit, row.mean, row.std, *row.engines.values()]
        for row in published_baselines(name).values()
    }


PARTS = {
    "episodes": episode,
    "jitter": jittered,
    "trial": trial,
    "engines": on_engine,
    "conformance": conformance,
    "sanity": sanity,
    "assets": asset,
    "fabrics": fabric,
    "published": published,
}
"""What makes an entry of a part from its name."""


# --- file ------------------------------------------------------------------------------------------------------------


def plain(value):
    """Return a value as JSON has it, numbers with ten digits: the tolerances are wider."""
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(one) for one in value]
    if isinstance(value, float | np.floating):
        return float(f"{value:.10g}")
    return value


def read():
    """Return the file: entries by part and name."""
    return json.loads(FILE.read_text(encoding="utf-8"))


def write(parts):
    """Write the file with a line for each entry, so that a change shows as the lines of what changed."""
    texts = []
    for part, entries in parts.items():
        lines = [
            f"{json.dumps(name)}: {json.dumps(entry)}"
            for name, entry in entries.items()
        ]
        texts.append(json.dumps(part) + ": {\n" + ",\n".join(lines) + "\n}")
    FILE.write_text("{\n" + ",\n".join(texts) + "\n}\n", encoding="utf-8")


def main():
    """Make the entries of the file again; a name that it does not have is added."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--only", choices=PARTS, help="one part")
    parser.add_argument("names", nargs="*", help="entries of that part")
    given = parser.parse_args()
    parts = read()
    for part in [given.only] if given.only else PARTS:
        for name in given.names or parts[part]:
            print(part, name, flush=True)
            parts[part][name] = plain(PARTS[part](name))
        write(parts)


if __name__ == "__main__":
    main()
