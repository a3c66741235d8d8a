"""Fit armature and dry friction to each run of a double pendulum, and predict the others.

Usage: `python studies/replay/transfer.py FILE...`, with the CSV files in `sys_id` of
`data/experiment_records/design_A.0/20220812` and `20220815` of
https://github.com/dfki-ric-underactuated-lab/double_pendulum (BSD-3-Clause), at least two of them.
"""

from __future__ import annotations

import sys
import tempfile
from itertools import permutations
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from gauge_envs.tools.replay import read_log
from gauge_envs.tools.replay.causes import candidates, change_setup
from gauge_envs.tools.replay.constants import fit_constants
from gauge_envs.tools.replay.log import FloatArray
from gauge_envs.tools.replay.model import Replayer, Setup, build_setup, load_model

MODEL = Path(__file__).parents[2] / "examples/replay/double_pendulum.xml"
JOINTS = ("shoulder", "elbow")
FITTED = ("armature", "dry friction")
HORIZONS_S = (0.5, 2.0)
PIECES = 40
PLAIN_PIECES, PLAIN_S = 20, 0.5


def read_run(file: Path, folder: Path) -> tuple[Replayer, Setup]:
    """Return a run, with the model of its published constants."""
    table = np.genfromtxt(file, delimiter=",", names=True)
    is_first_day = "pos1" in table.dtype.names
    kinds = (
        ("pos", "vel", "tau") if is_first_day else ("pos_meas", "vel_meas", "tau_con")
    )
    columns = {
        name: np.transpose([table[f"{kind}{joint}"] for joint in (1, 2)])
        for name, kind in zip(("q", "dq", "tau"), kinds, strict=True)
    }
    np.savez(folder / "log.npz", t=table["time"], joints=JOINTS, **columns)
    model, log = load_model(MODEL), read_log(folder / "log.npz")
    return Replayer(log, model), build_setup(model, log)


def weighted(run: tuple[Replayer, Setup], setups: list[Setup]) -> list[Setup]:
    """Return setups with the constants that `gauge replay --fit` finds in a run."""
    fit, _ = fit_constants([run], FITTED, ())
    return [fit.change(setup) for setup in setups]


def plain(run: tuple[Replayer, Setup], setups: list[Setup]) -> list[Setup]:
    """Return setups with the constants of unweighted least squares of the angles of a run."""
    replayer, setup = run
    causes = [each for each in candidates(replayer, setup) if each.name in FITTED]
    pieces = replayer.pieces(PLAIN_S, PLAIN_PIECES)

    def changed(each: Setup, numbers: FloatArray) -> Setup:
        parts = np.split(numbers, len(causes))
        values = [cause.scale * part for cause, part in zip(causes, parts, strict=True)]
        return change_setup(each, zip(causes, values, strict=True))

    def residuals(numbers: FloatArray) -> FloatArray:
        return replayer.predict(changed(setup, numbers), pieces).ravel()

    start = np.full(len(JOINTS) * len(causes), 0.5)
    found = least_squares(residuals, start, bounds=(0.0, np.inf), diff_step=1e-2)
    return [changed(each, found.x) for each in setups]


def main() -> None:
    """Print the error over that of the published model, as a geometric mean over ordered pairs of runs."""
    with tempfile.TemporaryDirectory() as folder:
        runs = [read_run(Path(file), Path(folder)) for file in sys.argv[1:]]
    setups = [setup for _, setup in runs]

    def errors(changed: list[Setup]) -> FloatArray:
        rows = []
        for (replayer, _), setup in zip(runs, changed, strict=True):
            deviations = [
                replayer.predict(setup, replayer.pieces(horizon_s, PIECES, outputs=1))
                for horizon_s in HORIZONS_S
            ]
            rows.append([np.sqrt(np.mean(each**2)) for each in deviations])
        return np.array(rows)

    published = errors(setups)
    print("fit", *(f"{horizon_s:g} s" for horizon_s in HORIZONS_S))
    for name, fit in {"weighted": weighted, "plain": plain}.items():
        ratios = np.array([errors(fit(run, setups)) / published for run in runs])
        pairs = [ratios[pair] for pair in permutations(range(len(runs)), 2)]
        print(name, *np.exp(np.mean(np.log(pairs), axis=0)).round(3))


if __name__ == "__main__":
    main()
