"""What laws without contact miss of odd tosses at 0.3 s: plain.csv.

    python -m studies.tosses.plain

A ballistic law flies on until the centre is as high as it rests, then keeps its height; a linear law of start velocity
and height is fitted to even tosses. Median over tosses, with quartiles.
"""

import csv
import tomllib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gauge_envs.files import data_folder
from gauge_envs.scene import GRAVITY_M_PER_S2

DATA = data_folder("scoring") / "single_shot"
AT_S = 0.3
REST_HEIGHT_M = {"CubeToss-acrylic": 0.0524, "ElbowToss-blocks": 0.025}
"""Height of the centre of a body that lies on a face [m]."""


def row(name: str) -> list[object]:
    """Return the errors of an experiment: tosses, ballistic law, linear law [mm]."""
    sidecar = tomllib.loads((DATA / f"{name}.toml").read_text(encoding="utf-8"))
    data = dict(np.load(DATA / f"{name}.npz"))
    copies = {one["trial"] for one in sidecar.get("copies", [])}
    frames = round(AT_S * sidecar["rate_hz"])
    after_s = frames / sidecar["rate_hz"]
    lengths = np.diff(data["first"])
    trials = [
        trial
        for trial, length in enumerate(lengths.tolist())
        if trial not in copies and length > frames
    ]
    starts = data["first"][trials]
    positions_m = sidecar["position_unit_m"] * data["position"].astype(float)
    moved_m = positions_m[starts + frames] - positions_m[starts]
    heights_m = positions_m[starts, 2]
    rates = data["start_velocity"][trials].astype(float)
    flown_m = after_s * rates
    flown_m[:, 2] -= 0.5 * GRAVITY_M_PER_S2 * after_s**2
    flown_m[:, 2] = np.maximum(flown_m[:, 2], REST_HEIGHT_M[name] - heights_m)
    is_odd = np.array(trials) % 2 == 1
    known = np.column_stack([rates, heights_m, np.ones(len(trials))])
    slopes = np.linalg.lstsq(known[~is_odd], moved_m[~is_odd], rcond=None)[0]
    errors = (flown_m - moved_m, known @ slopes - moved_m)
    return [name, int(is_odd.sum()), *(quartiles(one[is_odd]) for one in errors)]


def quartiles(errors_m: NDArray[np.float64]) -> str:
    """Return median and quartiles of distances [mm]."""
    distances_mm = 1e3 * np.linalg.norm(errors_m, axis=1)
    low, middle, high = np.percentile(distances_mm, (25, 50, 75))
    return f"{middle:.1f} ({low:.1f} to {high:.1f})"


if __name__ == "__main__":
    table = [row(name) for name in REST_HEIGHT_M]
    table.insert(0, ["experiment", "tosses", "ballistic, mm", "linear, mm"])
    file = Path(__file__).with_name("plain.csv")
    with file.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, lineterminator="\n").writerows(table)
