"""Which of several models predicts logs best, whatever identified them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gauge_envs.backends.mujoco.messages import mujoco_warnings
from gauge_envs.errors import FileError, ParameterError
from gauge_envs.optional import needs_extra
from gauge_envs.pages.document import Document, Paragraph, Tone
from gauge_envs.pages.table import Column, Table
from gauge_envs.reading import reading
from gauge_envs.scoring.interval import mean_half_width
from gauge_envs.tools.replay.causes import candidates, change_setup
from gauge_envs.tools.replay.log import FloatArray, LogMap
from gauge_envs.tools.replay.model import (
    Replayer,
    Setup,
    joint_names,
    law_setups,
    load_model,
)
from gauge_envs.tools.replay.readers import read_log
from gauge_envs.tools.replay.schema import ModelLine

YAML = (".yaml", ".yml")
HORIZONS_S = (0.1, 0.5, 2.0)
MAX_PIECES = 60
"""Pieces of a log; they do not overlap, so that they count as independent."""
MIN_PIECES = 4


def judge_models(
    logs: Sequence[Path], models: Sequence[Path], mapped: LogMap
) -> list[ModelLine]:
    """Return the predictions of each model over each horizon, in units of the first one.

    Args:
        logs: Logs that no model was fitted to.
        models: MJCF or URDF; the first one is the nominal one. A `ParameterDict` of `mujoco.sysid`, in YAML, is this
            model with other constants.
        mapped: Names, signs, units and gains.

    Raises:
        FileError: A file cannot be used.
        ParameterError: The logs are too short, or a log and a model do not go together.
    """
    with mujoco_warnings():
        setups = []
        for model in models:
            is_values = model.suffix in YAML
            pairs = load_setups(logs, models[0] if is_values else model, mapped)
            if is_values:
                pairs = [
                    (each, with_constants(each, setup, model)) for each, setup in pairs
                ]
            setups.append(pairs)
        return judge_setups([model.name for model in models], setups)


def load_setups(
    logs: Sequence[Path], model: Path, mapped: LogMap
) -> list[tuple[Replayer, Setup]]:
    """Return each log with the setup of a model."""
    compiled = load_model(model, mapped.control)
    names = joint_names(compiled)
    replayers = [Replayer(read_log(file, names, mapped), compiled) for file in logs]
    return [(each, law_setups(each)[0]) for each in replayers]


def with_constants(replayer: Replayer, setup: Setup, file: Path) -> Setup:
    """Return a setup with the constants of a `ParameterDict` of `mujoco.sysid`, as `armature of hip`.

    Raises:
        FileError: The file is no such dictionary, or names no constant of the model.
    """
    with needs_extra("reading YAML", "logs"):
        import yaml
    with reading(file, FileError, "a ParameterDict of mujoco.sysid") as content:
        states = yaml.safe_load(content)
        values = {
            name: float(np.ravel(each["value"])[0]) for name, each in states.items()
        }
    changes = []
    for cause in candidates(replayer, setup):
        names = [f"{cause.name} of {parameter}" for parameter in cause.parameters]
        if not values.keys().isdisjoint(names):
            present = zip(names, cause.present, strict=True)
            found = [values.pop(name, value) for name, value in present]
            changes.append((cause, np.array(found)))
    if values:
        example = f"armature of {replayer.log.joints[0]}"
        reason = f"no constant of the model; a name is as {example!r}"
        raise FileError(file, next(iter(values)), reason)
    return change_setup(setup, changes)


def judge_setups(
    names: Sequence[str], setups: Sequence[Sequence[tuple[Replayer, Setup]]]
) -> list[ModelLine]:
    """Return the predictions of each named row of setups, which has one for each log."""
    lines = []
    for horizon_s in HORIZONS_S:
        # Shape [models, pieces, 2].
        errors = np.array([_errors(each, horizon_s) for each in setups])
        if errors.shape[1] < MIN_PIECES:
            continue
        for name, pieces in zip(names, errors, strict=True):
            rms, over_noise = np.sqrt(np.mean(pieces**2, axis=0))
            ratio, low, high = _ratio(pieces[:, 1], errors[0, :, 1]).tolist()
            better = "yes" if high < 1.0 else "no" if low > 1.0 else "cannot tell"
            better = "nominal" if name == names[0] else better
            lines.append(
                ModelLine(name, horizon_s, rms, over_noise, ratio, low, high, better)
            )
    if not lines:
        shortest_s = HORIZONS_S[0] * MIN_PIECES
        raise ParameterError(f"the logs have less than {shortest_s:g} s in a row")
    return lines


def _errors(setups: Sequence[tuple[Replayer, Setup]], horizon_s: float) -> FloatArray:
    """Return the error of each piece, as it is and over the noise, shape [P, 2]."""
    rows = [np.zeros((0, 2))]
    for replayer, setup in setups:
        count = min(int(replayer.longest_s() / horizon_s), MAX_PIECES)
        if not count:
            continue
        pieces = replayer.pieces(horizon_s, count)
        error = replayer.predict(setup, pieces)[..., replayer.is_joint]
        noise = replayer.spread(pieces)[replayer.is_joint]
        both = [np.mean(each**2, axis=(1, 2)) for each in (error, error / noise)]
        rows.append(np.sqrt(np.transpose(both)))
    return np.concatenate(rows)


def _ratio(errors: FloatArray, nominal: FloatArray) -> FloatArray:
    """Return the geometric mean of ratios of errors, and its 95 % interval."""
    logarithms = np.log(np.maximum(errors, 1e-9) / np.maximum(nominal, 1e-9))
    mean, half = np.mean(logarithms), mean_half_width(logarithms)
    return np.exp([mean, mean - half, mean + half])


def judge_document(lines: Sequence[ModelLine]) -> Document:
    """Return a sentence on the longest horizon, and a table by model and horizon."""
    last = [line for line in lines if line.horizon_s == lines[-1].horizon_s]
    best = min(last, key=lambda line: line.over_nominal)
    answer = (
        f"{best.model} predicts best over {best.horizon_s:g} s: {best.over_nominal:.2g} "
        f"times the error of {last[0].model} ({best.low:.2g} to {best.high:.2g})."
    )
    if best.better != "yes":
        answer = f"No model is better than {last[0].model} over {best.horizon_s:g} s."
    number = "{:.3g}".format
    columns = (
        Column("model", "model"),
        Column("horizon_s", "s", number, is_number=True),
        Column("rms", "error", lambda rms: number(1e3 * rms), is_number=True),
        Column("over_noise", "/noise", number, is_number=True),
        Column("over_nominal", "/nominal", number, is_number=True),
        Column("low", "from", number, is_number=True),
        Column("high", "to", number, is_number=True),
        Column("better", "better"),
    )
    title = "Predictions from recorded states [mrad or mm]"
    return Document(
        parts=(
            Paragraph(answer, Tone.ANSWER),
            Table(title=title, columns=columns, rows=lines),
        )
    )
