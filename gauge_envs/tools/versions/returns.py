"""Compare return and success of a policy, or of scripted actions, in an environment on two sides."""

from __future__ import annotations

import math
import sys
import sysconfig
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gauge_envs.errors import ParameterError
from gauge_envs.experiments.variants import find_variant, variants
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.versions.environments import (
    NUMPY_2_SINCE,
    made_environment,
    sides_at_once,
    version_key,
)
from gauge_envs.tools.versions.model import Estimate, ReturnComparison, Side, Verdict
from gauge_envs.tools.versions.processes import Bench

WORKER = ("-B", str(Path(__file__).with_name("episodes_worker.py")))
"""Arguments of Python for the worker, which imports what the user's Python has."""


def compare_returns(
    subject: str,
    before: Side,
    after: Side,
    *,
    policy: str,
    seeds: int,
    seed: int,
    say: Callable[[str], object],
) -> ReturnComparison:
    """Return what a policy reaches on two sides, from the same seeds.

    Args:
        subject: Id of Gymnasium or of this suite, or `module:function` that makes an environment.
        before: First side.
        after: Second side.
        policy: `module:function` that returns a policy, or a file .npy of actions, a row each.
        seeds: Number of episodes.
        seed: Seed of the first.
        say: Prints what is installed.

    Raises:
        ParameterError: The policy is neither.
        VersionsError: A side cannot play the episodes.
    """
    is_file = policy.endswith(".npy")
    if not is_file and ":" not in policy:
        raise ParameterError(
            f"--policy {policy}: expected module:function that returns a policy, or a file .npy of actions"
        )
    if is_file and not Path(policy).is_file():
        raise ParameterError(f"--policy {policy}: there is no such file")
    title = subject
    if subject in {name for one in variants() for name in (one.name, one.id)}:
        subject = f"gauge_envs:{find_variant(subject).id}"
    with TemporaryDirectory(prefix="gauge-versions-") as name:
        bench = Bench(Path(), Path(name), steps=0, seed=seed, title=title, say=say)
        job = {"subject": subject, "policy": policy, "seeds": seeds, "seed": seed}

        def played(side: Side) -> tuple[str, FloatArray, FloatArray]:
            release = _release(side, say)
            side = replace(side, python=side.python or sys.executable)
            words = bench.work(side, job | release, WORKER)
            rows = [np.array(words[key], float) for key in ("returns", "successes")]
            return words["version"], *rows

        with sides_at_once() as pool:
            (one, first, won), (two, second, won_after) = pool.map(
                played, (before, after)
            )
    change = _mean(second - first)
    shares = [_success_share(values) for values in (won, won_after)]
    has_success = None not in shares
    success_change = _mean(won_after - won) if has_success else None
    verdict = Verdict.SAME
    if np.array_equal(first, second):
        verdict = Verdict.IDENTICAL
    elif any(_excludes_zero(each) for each in (change, success_change)):
        verdict = Verdict.DIFFERENT
    return ReturnComparison(
        subject=title,
        before=before.title,
        after=after.title,
        verdict=verdict,
        versions=(one, two),
        seeds=seeds,
        returns=(_mean(first), _mean(second)),
        change=change,
        success=(shares[0], shares[1]) if has_success else (None, None),
        success_change=success_change,
    )


def _release(side: Side, say: Callable[[str], object]) -> dict[str, object]:
    """Return the folder from which a side takes MuJoCo."""
    if not side.requirement:
        return {}
    base = str(made_environment(side.requirement, say).parents[1])
    folder = sysconfig.get_path("platlib", "venv", {"base": base, "platbase": base})
    version = version_key(side.requirement.partition("==")[2])
    return {"release": folder, "has_numpy": version < NUMPY_2_SINCE}


def _mean(values: FloatArray) -> Estimate:
    """Return the mean over seeds with the interval of Student's t."""
    mean = float(values.mean())
    if len(values) < 2:
        return Estimate(value=mean)
    # The import takes longer than the whole module.
    from scipy.stats import t as student

    error = float(values.std(ddof=1)) / math.sqrt(len(values))
    half = float(student.ppf(0.975, len(values) - 1)) * error
    return Estimate(value=mean, low=mean - half, high=mean + half)


def _success_share(values: FloatArray) -> Estimate | None:
    """Return the share of successes with the exact interval of Clopper and Pearson."""
    if np.isnan(values).any():
        return None
    from scipy.stats import binomtest

    found = binomtest(int(values.sum()), len(values)).proportion_ci(method="exact")
    return Estimate(
        value=float(values.mean()), low=float(found.low), high=float(found.high)
    )


def _excludes_zero(change: Estimate | None) -> bool:
    if change is None or change.low is None or change.high is None:
        return False
    return change.low > 0.0 or change.high < 0.0
