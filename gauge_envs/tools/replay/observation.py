"""The policy's side: each term of its observation against the state of the log."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.transform import Rotation

from gauge_envs.errors import FileError
from gauge_envs.tools.replay.log import FloatArray, Log, LogMap, noise_of

TERMS = (
    "base_angvel",
    "base_linvel",
    "projected_gravity",
    "joint_pos",
    "joint_vel",
    "last_action",
)
DOWN = (0.0, 0.0, -1.0)
DELAYS = (0, 1, 2, 3)
"""Delays of an observation that are tried [samples]."""
SAME = 0.1
"""Difference of a term and its rebuilt values beyond the noise, over their spread, below which they are one."""
MAX_RATIO = 0.4
"""Difference that a usual mistake leaves, over the one without it."""
UNLIKE = 0.5
"""Difference from which on a term is named without a usual mistake."""
WORD = 0.02
"""Difference that one more word must bring."""


def check_observation(log: Log, mapped: LogMap, home: FloatArray) -> Iterator[str]:
    """Yield what each term of the observation has in place of the state.

    Args:
        log: The log, with base and joints in the terms of the model.
        mapped: Names the terms in their order, and their scales.
        home: Default pose of the joints of the log, shape [J].

    Raises:
        FileError: The terms do not have the columns of the observation.
    """
    if not mapped.observation:
        return
    variants, widths = [], []
    for name in mapped.observation:
        term, _, count = name.partition(" ")
        variants.append((term, [] if count else [*_variants(log, term, home)]))
        widths.append(int(count) if count else variants[-1][1][0][1].shape[1])
    if sum(widths) != log.observation.shape[1]:
        reason = (
            f"the terms have {sum(widths)} columns, obs has {log.observation.shape[1]}"
        )
        raise FileError("--map", "observation", reason)
    columns = np.split(log.observation, np.cumsum(widths)[:-1], axis=1)
    for (term, values), seen in zip(variants, columns, strict=True):
        if values:
            scale = mapped.observation_scale.get(term, 1.0)
            yield from _differs(term, seen, values, scale)


def _variants(
    log: Log, term: str, home: FloatArray
) -> Iterator[tuple[str, FloatArray]]:
    """Yield the right values of a term, without a text, and the usual wrong ones, shape [N, K]."""
    if (
        term in ("base_angvel", "base_linvel", "projected_gravity")
        and not log.base_pose.size
    ):
        raise FileError(log.name, term, "the log has no base_quat to rebuild it")
    if term == "joint_pos":
        yield "", log.position - home
        yield "without minus the default pose", log.position
    elif term == "joint_vel":
        yield "", log.velocity
    elif term == "last_action":
        yield "", np.roll(log.command, 1, axis=0)
        yield "of the present step", log.command
    elif term == "projected_gravity":
        quaternion = log.base_pose[:, 3:]
        for order, numbers in (
            ("", quaternion),
            ("x y z w", np.roll(quaternion, -1, axis=1)),
            ("w x y z", np.roll(quaternion, 1, axis=1)),
        ):
            turn = Rotation.from_quat(numbers, scalar_first=True)
            text = (
                f"from numbers {order} of the quaternion that are taken for the other order"
                if order
                else ""
            )
            yield text, turn.inv().apply(DOWN)
            yield f"{text} turned the other way".strip(), turn.apply(DOWN)
    elif term in ("base_angvel", "base_linvel"):
        turn = Rotation.from_quat(log.base_pose[:, 3:], scalar_first=True)
        body = log.base_twist[:, 3:]
        if term == "base_linvel":
            body = turn.inv().apply(log.base_twist[:, :3])
        yield "", body
        yield "in the world frame", turn.apply(body)
        yield "turned into the body frame twice", turn.inv().apply(body)
    else:
        reason = (
            f"no such term; give {', '.join(TERMS)}, or a name and a number of columns"
        )
        raise FileError("--map", f"observation {term}", reason)


def _differs(
    term: str, seen: FloatArray, variants: list[tuple[str, FloatArray]], scale: float
) -> Iterator[str]:
    """Yield in what a term differs from its right values, if it does."""
    tried = []
    for (text, values), delay in product(variants, DELAYS):
        late = np.roll(values, delay, axis=0)[max(DELAYS) :]
        shown = seen[max(DELAYS) :]
        late_text = f"{delay} samples late" if delay else ""
        words = [text, late_text]
        tried.append((_gap(shown, scale * late), words))
        order = _order(shown, late)
        if (order != np.arange(len(order))).any():
            moved = scale * late[:, order]
            columns = " ".join(map(str, order))
            tried.append(
                (_gap(shown, moved), [*words, f"with columns in the order {columns}"])
            )
        gain = np.sum(shown * late) / max(np.sum(late**2), 1e-12)
        tried.append((_gap(shown, gain * late), [*words, f"with the scale {gain:.3g}"]))
        limit = np.abs(shown).max()
        clipped = np.clip(scale * late, -limit, limit)
        tried.append((_gap(shown, clipped), [*words, f"clipped at {limit:.3g}"]))
    first = tried[0][0]
    gap, words = min(tried, key=lambda row: row[0] + WORD * sum(map(bool, row[1])))
    if first > SAME and gap < MAX_RATIO * first:
        yield f"{term} {' '.join(filter(None, words))}"
    elif first > UNLIKE:
        yield f"{term} {100.0 * first:.0f} % off its motion, and no usual mistake explains it"


def _gap(seen: FloatArray, rebuilt: FloatArray) -> float:
    """Return the root mean square difference beyond the noise of both, over the motion."""
    rows = np.arange(float(len(seen)))
    noise = np.concatenate([noise_of(rows, seen), noise_of(rows, rebuilt)])
    difference = np.mean((seen - rebuilt) ** 2) - 2.0 * np.mean(noise**2)
    motion = max(np.var(seen, axis=0).mean(), 1e-12)
    return float(np.sqrt(max(difference, 0.0) / motion))


def _order(seen: FloatArray, rebuilt: FloatArray) -> FloatArray:
    """Return the column of the rebuilt values that each column follows."""
    gaps = np.mean((seen[:, :, None] - rebuilt[:, None]) ** 2, axis=0)
    order: FloatArray = linear_sum_assignment(gaps)[1]
    return order
