"""The policy's side: its observation, its action and its file against the state and the command of the log."""

from collections.abc import Callable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gauge_envs.errors import FileError
from gauge_envs.optional import needs_extra
from gauge_envs.reading import faults_of
from gauge_envs.tools.replay.log import FloatArray, Log, noise_of

Variants: TypeAlias = list[tuple[str, FloatArray]]
"""The right values of a term, without a text, and the usual wrong ones, shape [N, K]."""
Term: TypeAlias = tuple[str, str, Variants]
"""A term of the observation, its number of columns where it cannot be rebuilt, and its variants where it can."""
Policy: TypeAlias = Callable[[FloatArray], FloatArray]

OF_BASE = ("base_linvel", "base_angvel", "projected_gravity")
DOWN = (0.0, 0.0, -1.0)
DELAYS = (0, 1, 2, 3)
"""Delays that are tried [samples]."""
SAME = 0.03
"""Difference of a term and its rebuilt values, over their spread, below which they are one."""
MAX_RATIO = 0.4
"""Difference that a usual mistake leaves, over the one without it; noise is part of both."""
UNLIKE = 0.5
"""Difference from which on a term is named without a usual mistake."""
WHITE = 0.8
"""Noise of a difference, over its standard deviation, from which on it is noise."""
LOUD = 3.0
"""Noise of an observation, over that of the state, from which on it is named."""
WORD = 0.02
"""Difference that one more word must bring."""
FAR_S = 0.3
"""Time from which on two samples of a log are no neighbours in time."""
MAX_SCATTER = 0.1
"""Scatter of the commands at one state, over their spread, from which on the state does not decide them."""
MIN_PAIRS = 30
"""Samples of a second log in states of the first one from which on their commands are compared."""


def check_policy(
    log: Log, home: FloatArray, policy: Policy | None = None
) -> Iterator[str]:
    """Yield in what observation and action differ from state and command, a sentence each.

    Args:
        log: The log; its map names the terms of the observation in their order, and their scales.
        home: Default pose of the joints of the log, shape [J].
        policy: Returns the actions to observations.

    Raises:
        FileError: The terms do not have the columns of the observation, or cannot be rebuilt.
    """
    terms: list[Term] = []
    for named in log.mapped.observation:
        term, _, count = named.partition(" ")
        scale = log.mapped.observation_scale.get(term, 1.0)
        rebuilt = () if count else _variants(log, term, home)
        terms.append((term, count, [(text, scale * each) for text, each in rebuilt]))
    if log.observation.size and terms:
        yield from _check_terms(log, terms)
    yield from _check_action(log, home)
    if policy is not None:
        observations = [("", log.observation)]
        if not log.observation.size:
            observations = [*_observations(log, terms)]
        actions = [(text, policy(values)) for text, values in observations]
        for text in _differs(_actions(log, home), actions):
            yield f"The logged action differs from the policy: {text}."


def _check_terms(log: Log, terms: Sequence[Term]) -> Iterator[str]:
    """Yield in what each term of the observation differs from the state."""
    widths = [
        int(count) if count else variants[0][1].shape[1] for _, count, variants in terms
    ]
    if sum(widths) != log.observation.shape[1]:
        reason = (
            f"the terms have {sum(widths)} columns, obs has {log.observation.shape[1]}"
        )
        raise FileError("--map", "observation", reason)
    seen = np.split(log.observation, np.cumsum(widths)[:-1], axis=1)
    for (term, _, variants), columns in zip(terms, seen, strict=True):
        for text in _differs(columns, variants):
            yield f"The policy sees {term} {text}."


def _variants(
    log: Log, term: str, home: FloatArray
) -> Iterator[tuple[str, FloatArray]]:
    """Yield the variants of a term."""
    turn = Rotation.identity()
    if term in OF_BASE:
        if not log.base_pose.size:
            raise FileError(log.name, term, "the log has no base_quat to rebuild it")
        turn = Rotation.from_quat(log.base_pose[:, 3:], scalar_first=True)
    if term == "joint_pos":
        yield "", log.position - home
        yield "without minus the default pose", log.position
    elif term == "joint_vel":
        yield "", log.velocity
    elif term == "last_action":
        actions = _actions(log, home)
        yield "", np.roll(actions, 1, axis=0)
        yield "of the present step", actions
    elif term == "projected_gravity":
        yield "", turn.inv().apply(DOWN)
        yield "turned the other way", turn.apply(DOWN)
        yield (
            "turned into the body frame twice",
            turn.inv().apply(turn.inv().apply(DOWN)),
        )
        for order, shift in (
            ("x y z w read as w x y z", -1),
            ("w x y z read as x y z w", 1),
        ):
            numbers = np.roll(log.base_pose[:, 3:], shift, axis=1)
            wrong = Rotation.from_quat(numbers, scalar_first=True)
            text = f"with a quaternion {order}"
            yield text, wrong.inv().apply(DOWN)
            yield f"{text} turned the other way", wrong.apply(DOWN)
    elif term in OF_BASE:
        body = log.base_twist[:, 3:]
        if term == "base_linvel":
            body = turn.inv().apply(log.base_twist[:, :3])
        yield "", body
        yield "in the world frame", turn.apply(body)
        yield "turned into the body frame twice", turn.inv().apply(body)
    else:
        known = ", ".join((*OF_BASE, "joint_pos", "joint_vel", "last_action"))
        reason = f"no such term; give {known}, or a name and a number of columns"
        raise FileError("--map", f"observation {term}", reason)


def _actions(log: Log, home: FloatArray) -> FloatArray:
    """Return the actions, which the targets contain where the log has none."""
    if log.action.size or log.command_kind != "target":
        return log.action if log.action.size else log.held_command()
    return (log.held_command() - home) / _action_scale(log)


def _action_scale(log: Log) -> FloatArray:
    return np.array(
        [log.mapped.control.of(name)["action_scale"] for name in log.joints]
    )


def _check_action(log: Log, home: FloatArray) -> Iterator[str]:
    """Yield in what the targets of a log differ from its actions."""
    target = log.held_command()
    if (
        log.command_kind != "target"
        or not log.action.shape == target.shape == log.position.shape
    ):
        return
    moved = _action_scale(log) * log.action
    variants = [
        ("", moved),
        ("without the default pose", moved - home),
        ("added to the present pose", moved + log.position - home),
    ]
    for text in _differs(target - home, variants):
        yield f"The target is the action {text}."


def _observations(log: Log, terms: Sequence[Term]) -> Iterator[tuple[str, FloatArray]]:
    """Yield the rebuilt observation, and that with each usual mistake of a term."""
    for term, count, _ in terms:
        if count:
            reason = "it is not in the state of the log; log the observation as obs"
            raise FileError(log.name, f"observation {term}", reason)
    values = [variants[0][1] for _, _, variants in terms]
    yield "", np.hstack(values)
    for place, (term, _, (right, *wrong)) in enumerate(terms):
        for text, values[place] in wrong:
            yield f"with {term} {text}", np.hstack(values)
        values[place] = right[1]


def load_policy(file: Path) -> Policy:
    """Return a policy of a file in ONNX or TorchScript, with one input and one output.

    Raises:
        FileError: The file is no such policy.
        MissingExtraError: The package that runs it is not installed.
    """
    if file.suffix == ".onnx":
        with needs_extra("running a policy in ONNX", "logs"):
            import onnxruntime
        with faults_of(file, FileError, "a policy in ONNX"):
            session = onnxruntime.InferenceSession(
                str(file), providers=["CPUExecutionProvider"]
            )
            given, *others = session.get_inputs()
            if others:
                names = ", ".join(each.name for each in (given, *others))
                raise FileError(file, "inputs", f"{names}; one is supported")

        def run(row: Any) -> Any:
            return session.run(None, {given.name: row})[0]
    else:
        with needs_extra("running a policy in TorchScript", "rl"):
            import torch
        with faults_of(file, FileError, "a policy in TorchScript"):
            module = torch.jit.load(file, map_location="cpu")

        def run(row: Any) -> Any:
            with torch.no_grad():
                return module(torch.from_numpy(row)).numpy()

    def policy(observations: FloatArray) -> FloatArray:
        with faults_of(file, FileError, "a policy of this observation"):
            # A file may have a batch of one.
            rows = [run(row[None].astype(np.float32)) for row in observations]
        return np.concatenate(rows).astype(float)

    return policy


def compare_commands(first: Log, second: Log) -> Iterator[str]:
    """Yield in what the commands of a second log differ from those of the first one at the same state.

    States of the first log that come back tell whether its commands depend on the state alone, and how far.
    """
    states, commands = [_state(log) for log in (first, second)], first.held_command()
    names = [
        (log.joints, log.command_kind, log.command_names) for log in (first, second)
    ]
    if (
        names[0] != names[1]
        or not first.command_kind
        or states[0].shape[1] != states[1].shape[1]
    ):
        return
    spread = states[0].std(axis=0) + 1e-9
    known, asked = (each / spread for each in states)
    tree = KDTree(known)
    step = np.linalg.norm(np.diff(known, axis=0), axis=1)
    limit = 0.5 * float(np.median(step))
    pairs = tree.query_pairs(limit, output_type="ndarray")
    pairs = pairs[np.diff(first.time_s[pairs])[:, 0] > FAR_S]
    distance, nearest = tree.query(asked)
    is_near = distance < limit
    if min(len(pairs), is_near.sum()) < MIN_PAIRS:
        return
    scatter = 0.5 * np.mean(np.diff(commands[pairs], axis=1) ** 2)
    if scatter > (MAX_SCATTER * np.std(commands)) ** 2:
        return
    expected = [("", commands[nearest[is_near]])]
    for text in _differs(second.held_command()[is_near], expected, (0,), 2.0 * scatter):
        yield f"At the same state, the commands of {second.name} differ from {first.name}: {text}."


def _state(log: Log) -> FloatArray:
    """Return what a policy can know of the robot, without its place and heading, shape [N, D]."""
    terms = [log.position, log.velocity]
    if log.base_pose.size:
        for term in OF_BASE:
            terms.append(next(_variants(log, term, log.position[0]))[1])
    return np.hstack(terms)


def _differs(
    seen: FloatArray,
    variants: Variants,
    delays: Sequence[int] = DELAYS,
    noise: float = 0.0,
) -> Iterator[str]:
    """Yield in what values differ from the right ones, if they do.

    Args:
        seen: The values, shape [N, K].
        variants: See above.
        delays: Delays that are tried [samples].
        noise: Squared difference without a mistake.
    """
    tried = []
    skipped, limit = max(delays), np.abs(seen).max()
    shown = seen[skipped:]
    for (text, values), delay in product(variants, delays):
        if values.shape != seen.shape:
            continue
        late = np.roll(values, delay, axis=0)[skipped:]
        words = [text, f"{delay} sample{'s' * (delay > 1)} late" if delay else ""]
        order, shift = _order(shown, late), np.mean(shown - late, axis=0)
        gain = np.sum(shown * late) / max(np.sum(late**2), 1e-12)
        largest = shift[np.argmax(np.abs(shift))]
        for moved, *more in (
            (late,),
            (late[:, order], f"with columns in the order {' '.join(map(str, order))}"),
            (gain * late, f"with {gain:.3g} times its scale"),
            (np.clip(late, -limit, limit), f"clipped at {limit:.3g}"),
            (
                late + shift,
                f"with an offset of up to {largest:.3g}",
                "from another default pose",
            ),
        ):
            tried.append((_gap(shown, moved, noise), [*words, *more]))
    first = tried[0][0] if tried else 0.0
    if first < SAME:
        return
    gap, words = min(tried, key=lambda row: row[0] + WORD * sum(map(bool, row[1])))
    if gap < MAX_RATIO * first:
        yield " ".join(filter(None, words))
        return
    rest = seen - variants[0][1]
    rows = np.arange(float(len(rest)))
    white, own = noise_of(rows, rest), noise_of(rows, variants[0][1])
    loudest = np.argmax(white - LOUD * own)
    # The state of the log has noise too.
    limit = max(WHITE * np.std(rest[:, loudest]), LOUD * own[loudest])
    if white[loudest] > limit:
        yield f"with noise of {white[loudest]:.2g}"
    elif first > UNLIKE:
        yield f"{100.0 * first:.0f} % off its motion, and no usual mistake explains it"


def _gap(seen: FloatArray, rebuilt: FloatArray, noise: float) -> float:
    """Return the root mean square difference beyond the noise, over the motion."""
    difference = np.mean((seen - rebuilt) ** 2) - noise
    motion = max(np.var(seen, axis=0).mean(), 1e-12)
    return float(np.sqrt(max(difference, 0.0) / motion))


def _order(seen: FloatArray, rebuilt: FloatArray) -> FloatArray:
    """Return the column of the rebuilt values that each column follows."""
    gaps = np.mean((seen[:, :, None] - rebuilt[:, None]) ** 2, axis=0)
    order: FloatArray = linear_sum_assignment(gaps)[1]
    return order
