"""Play episodes of an environment on one side: `python episodes_worker.py JOB.json`. Needs Gymnasium, NumPy and MuJoCo.

The process runs in the user's Python, where the environment and the policy are, or in another stack of the user. The
job is a JSON object:

    {"subject": "Ant-v5", "policy": "my_policy:make", "seeds": 20, "seed": 0, "settings": {"iterations": 4},
     "release": "/cache/mujoco-3.3.0/lib/python3.12/site-packages", "has_numpy": false, "out": "side"}

MuJoCo is imported from the folder `release` if one is stated, and NumPy too if `has_numpy` is true. `OUT.json` has the
version, and return and success of each seed.
"""

import importlib
import importlib.util
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

Job = dict[str, Any]


def use_release(job: Job) -> None:
    """Import MuJoCo from the folder of a release, and all else from where the user has it."""
    # The folder of this file has modules with common names; the user's own lie in the working folder.
    sys.path[0] = ""
    if not job.get("release"):
        return
    if not job["has_numpy"]:
        importlib.import_module("numpy")
    sys.path.insert(0, job["release"])
    importlib.import_module("mujoco")
    sys.path.remove(job["release"])


def called(text: str) -> Any:
    """Return what a function of `module:function` returns."""
    module, _, function = text.partition(":")
    return getattr(importlib.import_module(module), function)()


def made(job: Job) -> Any:
    """Return the environment of a job, with the settings of the side."""
    text = job["subject"]
    if Path(text.partition(":")[0]).suffix or ":" not in text or "/" in text:
        env = importlib.import_module("gymnasium").make(text)
    else:
        env = called(text)
    if job["settings"]:
        place = Path(__file__).with_name("worker.py")
        found = importlib.util.spec_from_file_location("gauge_versions_worker", place)
        assert found is not None and found.loader is not None
        worker = importlib.util.module_from_spec(found)
        found.loader.exec_module(worker)
        worker.set_options(env.unwrapped.model, job["settings"])
    return env


def actor(text: str) -> Callable[[Any, int], Any]:
    """Return the action of an observation and a step: by a policy `module:function`, or from a file of actions."""
    if text.endswith(".npy"):
        rows = importlib.import_module("numpy").load(text)
        return lambda observation, step: rows[min(step, len(rows) - 1)]
    policy = called(text)
    # Stable-Baselines3 returns the action with a state.
    act = getattr(policy, "predict", policy)

    def action(observation: Any, step: int) -> Any:
        found = act(observation)
        return found[0] if isinstance(found, tuple) else found

    return action


def episodes(job: Job) -> Iterator[tuple[float, float | None]]:
    """Yield return and success of each seed; None where the environment states no success."""
    env, act = made(job), actor(job["policy"])
    for seed in range(job["seed"], job["seed"] + job["seeds"]):
        observation, _ = env.reset(seed=seed)
        total, success, step, is_over = 0.0, None, 0, False
        while not is_over:
            observation, reward, terminated, truncated, info = env.step(
                act(observation, step)
            )
            total, step = total + float(reward), step + 1
            stated = info.get("is_success", info.get("success"))
            if stated is not None:
                success = max(float(stated), success or 0.0)
            is_over = terminated or truncated
        yield total, success


def main(file: Path) -> None:
    """Do the job of a file."""
    job = json.loads(file.read_text(encoding="utf-8"))
    use_release(job)
    played = list(episodes(job))
    words = {
        "version": importlib.import_module("mujoco").__version__,
        "returns": [total for total, _ in played],
        "successes": [success for _, success in played],
    }
    Path(job["out"] + ".json").write_text(json.dumps(words), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
