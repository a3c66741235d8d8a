"""Build the bundled bands of real trials in `scoring/bands/` and the summaries in `scoring/facts/` from the facts.

The facts hold what was measured: 59 slides and 22 bounces. Each trial is reconstructed at the published number of 30 Hz
frames, then the band is the mean and the sample standard deviation over trials. `scoring/README.md` defines all terms.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gauge_envs import load_experiment
from gauge_envs.evaluation.estimators import slide_friction
from gauge_envs.evaluation.metrics.trajectory import trajectory_dtw, trajectory_rmse
from gauge_envs.references.published import published_baselines
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.scene.geometry import BoolArray, FloatArray
from gauge_envs.scene.timing import FRAME_RATE_HZ
from scripts.generated import SCORING, frame_table

SLOPE_RAD = math.radians(30)
SLOPE_MATERIALS = ("wood", "plastic", "metal")
BALL_VARIANT = "BouncingBall-rubber"
BALL_FIRST_MEASURED_FRAME = (
    4  # the arcs lack three or four first frames; the count of each trial is unknown
)

BALL_FIT_STD_MM = 0.1  # residual of the ballistic fits, scoring/README.md

GENERATED = "# Written by scripts/build_bands.py; do not edit."
DATASET = "InternRobotics/GAUGE-Dataset, revision 9e0acb7, MIT licence"


@dataclass(frozen=True)
class Trials:
    """Reconstructed real trials of one variant, along the one coordinate that was measured.

    Attributes:
        coordinate: Name of the coordinate.
        direction: Its unit vector in the motion-capture world frame, shape [3].
        positions_mm: Coordinate of the body's centre, in mm, shape [trial_count, frame_count].
        measured: Whether the trial was measured at the frame, shape [trial_count, frame_count].
        fit_std_mm: Standard error of each trial's position, from the misfit of its law, same shape.
        method: How the trials were reconstructed.
    """

    coordinate: str
    direction: tuple[float, float, float]
    positions_mm: FloatArray
    measured: BoolArray
    fit_std_mm: FloatArray
    method: str


@dataclass(frozen=True)
class Slide:
    """Measured samples of one slide, with the quadratic through them.

    Attributes:
        frames: Numbers of the measured frames, shape [sample_count].
        positions_mm: Downhill coordinate at these frames, in mm, shape [sample_count].
    """

    frames: FloatArray
    positions_mm: FloatArray

    def standard_error_mm(self, frame_count: int) -> FloatArray:
        """Return the standard error of the quadratic at each frame [mm], shape [frame_count]."""
        times = self.frames / FRAME_RATE_HZ
        coefficients, covariance = np.polyfit(times, self.positions_mm, 2, cov=True)
        powers = np.vander(np.arange(frame_count) / FRAME_RATE_HZ, len(coefficients))
        return np.sqrt(np.einsum("fi,ij,fj->f", powers, covariance, powers))

    def quadratic(self) -> tuple[float, float, float]:
        """Return the acceleration in mm/s^2, and the vertex: its time in s and its position in mm."""
        square, linear, constant = np.polyfit(
            self.frames / FRAME_RATE_HZ, self.positions_mm, 2
        )
        return (
            2 * float(square),
            float(-linear / (2 * square)),
            float(constant - linear**2 / (4 * square)),
        )


@dataclass(frozen=True)
class Impact:
    """The first impact of one trial of the bouncing ball; heights are of the ball's centre, in the world frame.

    Attributes:
        speed_in: Vertical speed just before it, in m/s.
        speed_out: Vertical speed just after it, in m/s.
        time: Time from frame 0, in s.
        height: Height, in m.
        next_time: Time of the next impact, in s.
    """

    speed_in: float
    speed_out: float
    time: float
    height: float
    next_time: float

    @property
    def start_height(self) -> float:
        """Height from which the ball fell from rest, in m."""
        return self.height + self.speed_in**2 / (2 * GRAVITY_M_PER_S2)

    @property
    def release_time(self) -> float:
        """Time at which the fall began, in s."""
        return self.time - self.speed_in / GRAVITY_M_PER_S2


def read_rows(file: Path) -> list[dict[str, str]]:
    """Return the rows of a facts file; its header comments start with `#`."""
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(line for line in stream if not line.startswith("#")))


def read_slides(facts: Path, material: str) -> list[Slide]:
    """Return all slides of one material, in order of trial."""
    samples: dict[int, list[tuple[int, float]]] = {}
    for row in read_rows(facts / "slope_slider_30deg.csv"):
        if row["material"] == material:
            samples.setdefault(int(row["trial"]), []).append(
                (int(row["frame"]), float(row["downhill_mm"]))
            )
    return [
        Slide(*np.array(samples[trial], dtype=np.float64).T)
        for trial in sorted(samples)
    ]


def read_impacts(facts: Path) -> list[Impact]:
    """Return the first impacts of all trials of the bouncing ball."""
    rows = read_rows(facts / "bouncing_ball.csv")
    next_times = {
        row["trial"]: float(row["time_s"]) for row in rows if row["impact"] == "2"
    }
    return [
        Impact(
            speed_in=float(row["speed_in_m_s"]),
            speed_out=float(row["speed_out_m_s"]),
            time=float(row["time_s"]),
            height=float(row["height_m"]),
            next_time=next_times[row["trial"]],
        )
        for row in rows
        if row["impact"] == "1"
    ]


def reconstruct_slides(slides: Sequence[Slide], frame_count: int) -> Trials:
    """Return trials of the measured samples; other frames take their quadratic, at rest before its vertex."""
    positions = np.empty((len(slides), frame_count))
    measured = np.zeros((len(slides), frame_count), dtype=bool)
    errors = np.array([slide.standard_error_mm(frame_count) for slide in slides])
    for trial, slide in enumerate(slides):
        acceleration, start_time, start = slide.quadratic()
        sliding_time = np.maximum(
            np.arange(frame_count) / FRAME_RATE_HZ - start_time, 0
        )
        positions[trial] = start + acceleration / 2 * sliding_time**2
        inside = slide.frames < frame_count
        frames = slide.frames[inside].astype(int)
        positions[trial, frames] = slide.positions_mm[inside]
        measured[trial, frames] = True
    return Trials(
        coordinate="downhill",
        direction=(math.cos(SLOPE_RAD), 0.0, -math.sin(SLOPE_RAD)),
        positions_mm=positions,
        measured=measured,
        fit_std_mm=errors,
        method="samples where listed; elsewhere the quadratic through them, at rest before its vertex",
    )


def reconstruct_bounces(impacts: Sequence[Impact], frame_count: int) -> Trials:
    """Return trials of rest until the release and free fall before and after the first impact; none has a second."""
    times = np.arange(frame_count) / FRAME_RATE_HZ
    positions = np.empty((len(impacts), frame_count))
    for trial, impact in enumerate(impacts):
        if impact.next_time <= times[-1]:
            raise ValueError(
                f"impact 2 at {impact.next_time} s falls inside {frame_count} frames"
            )
        after_impact = np.maximum(times, impact.release_time) - impact.time
        speed = np.where(after_impact < 0, -impact.speed_in, impact.speed_out)
        height = (
            impact.height
            + speed * after_impact
            - GRAVITY_M_PER_S2 / 2 * after_impact**2
        )
        positions[trial] = 1000 * height
    measured = np.broadcast_to(
        np.arange(frame_count) >= BALL_FIRST_MEASURED_FRAME, positions.shape
    )
    return Trials(
        coordinate="z",
        direction=(0.0, 0.0, 1.0),
        positions_mm=positions,
        measured=measured,
        fit_std_mm=np.full(positions.shape, BALL_FIT_STD_MM),
        method="at rest until released, then free fall into and out of the first impact",
    )


def trial_scores(trials: Trials) -> dict[str, FloatArray]:
    """Return E_RMSE and E_DTW of each trial to the mean over trials [mm], each of shape [trial_count]."""
    mean = trials.positions_mm.mean(axis=0)[:, np.newaxis]
    return {
        metric: np.array(
            [score(trial[:, np.newaxis], mean) for trial in trials.positions_mm]
        )
        for metric, score in (("rmse", trajectory_rmse), ("dtw", trajectory_dtw))
    }


def uncertainty_mm(trials: Trials, variant: str) -> FloatArray:
    """Return the 1-sigma uncertainty of the mean over trials at each frame [mm], without their scatter.

    It is the misfit of the laws over the root of the number of trials. Before the first sample of a trial, the start
    may also be that of the metadata: the difference is the half width of a rectangular distribution.
    """
    count = len(trials.measured)
    experiment = load_experiment(variant)
    start_mm = 1e3 * np.dot(
        trials.direction, experiment.scene.body(experiment.recorded[0]).pose.position_m
    )
    offset = abs(float(trials.positions_mm[:, 0].mean()) - float(start_mm))
    before = ~np.logical_or.accumulate(trials.measured, axis=1)
    misfit = np.square(trials.fit_std_mm).mean(axis=0) / count
    return np.sqrt(misfit + before.mean(axis=0) * offset**2 / 3)


def band_csv(trials: Trials, variant: str) -> str:
    """Return the text of a band's table."""
    mean, sigma = (
        trials.positions_mm.mean(axis=0),
        trials.positions_mm.std(axis=0, ddof=1),
    )
    uncertainty = uncertainty_mm(trials, variant)
    counts = trials.measured.sum(axis=0)
    columns = ",".join(
        f"{quantity}.{trials.coordinate}"
        for quantity in ("mean", "sigma", "uncertainty")
    )
    lines = [f"frame,time_s,measured,measured_trials,{columns}"]
    for frame, count in enumerate(counts):
        measured = int(2 * count >= len(trials.measured))
        numbers = f"{mean[frame]:.6f},{sigma[frame]:.6f},{uncertainty[frame]:.6f}"
        lines.append(
            f"{frame},{frame / FRAME_RATE_HZ:.6f},{measured},{count},{numbers}"
        )
    return "\n".join(lines) + "\n"


def trials_csv(trials: Trials) -> str:
    """Return the text of the table of single trials."""
    numbers = range(1, len(trials.positions_mm) + 1)
    names = [f"trial.{number}.{trials.coordinate}" for number in numbers]
    return frame_table(names, trials.positions_mm.T, decimals=6)


def band_toml(trials: Trials) -> str:
    """Return the text of a band's sidecar: what the table's numbers are, and the scores of the trials themselves."""
    direction = ", ".join(f"{component:.12g}" for component in trials.direction)
    scores = "".join(
        f"\n[{metric}]  # {metric.upper()} of each trial to the mean, over all frames, in the unit above\n"
        + statistics_toml(values)
        for metric, values in trial_scores(trials).items()
    )
    return (
        f"{GENERATED}\n"
        'grade = "trials"\n'
        'sigma_source = "trials"\n'
        'unit = "mm"\n'
        f"trial_count = {len(trials.positions_mm)}\n"
        f'coordinates = ["{trials.coordinate}"]\n'
        f"projection = [[{direction}]]  # of the body's centre, world frame\n"
        f'source = "{DATASET}; {trials.method}"\n'
        f"{scores}"
    )


def slides_summary_toml(slides: dict[str, list[Slide]]) -> str:
    """Return the summary of SlopeSlider-2 as text: measured acceleration, and the kinetic friction from it."""
    lines = [
        GENERATED,
        f"# Over the trials of each material of SlopeSlider-2; g = {GRAVITY_M_PER_S2} m/s^2.",
    ]
    for material, trials in slides.items():
        acceleration = np.array([slide.quadratic()[0] / 1000 for slide in trials])
        friction = [
            slide_friction(one, SLOPE_RAD, gravity_m_per_s2=GRAVITY_M_PER_S2)
            for one in acceleration
        ]
        lines += ["", f"[{material}]", f"trial_count = {len(trials)}"]
        lines += [
            f"acceleration_m_s2 = {inline_statistics(acceleration)}",
            f"friction = {inline_statistics(friction)}",
        ]
    return "\n".join(lines) + "\n"


def bounces_summary_toml(impacts: Sequence[Impact]) -> str:
    """Return the summary of BouncingBall as text: quantities of the first impact for an effective parameter set."""
    quantities = {
        "rebound_ratio": [impact.speed_out / impact.speed_in for impact in impacts],
        "start_height_m": [impact.start_height for impact in impacts],
        "contact_height_m": [impact.height for impact in impacts],
        "release_time_s": [impact.release_time for impact in impacts],
    }
    lines = [
        GENERATED,
        f"# Over the first impacts of BouncingBall, heights of the ball's centre; g = {GRAVITY_M_PER_S2} m/s^2.",
    ]
    lines += [f"trial_count = {len(impacts)}"]
    lines += [
        f"{name} = {inline_statistics(values)}" for name, values in quantities.items()
    ]
    return "\n".join(lines) + "\n"


def statistics_toml(values: FloatArray) -> str:
    """Return mean and sample standard deviation as two lines of TOML."""
    return f"mean = {np.mean(values):.6f}\nstd = {np.std(values, ddof=1):.6f}\n"


def inline_statistics(values: Sequence[float] | FloatArray) -> str:
    """Return mean, sample standard deviation and median as an inline TOML table."""
    return f"{{ mean = {np.mean(values):.6f}, std = {np.std(values, ddof=1):.6f}, median = {np.median(values):.6f} }}"


def reconstruct(scoring: Path) -> dict[str, Trials]:
    """Return the trials of every variant that has facts, over its published number of frames."""
    trials = {}
    for material in SLOPE_MATERIALS:
        variant = f"SlopeSlider-2-{material}"
        frame_count = published_baselines(variant)["rmse"].frames
        trials[variant] = reconstruct_slides(
            read_slides(scoring / "facts", material), frame_count
        )
    frame_count = published_baselines(BALL_VARIANT)["rmse"].frames
    trials[BALL_VARIANT] = reconstruct_bounces(
        read_impacts(scoring / "facts"), frame_count
    )
    return trials


def contents(scoring: Path = SCORING) -> dict[Path, str]:
    """Return every generated file with the text that the facts give it."""
    facts = scoring / "facts"
    slides = {material: read_slides(facts, material) for material in SLOPE_MATERIALS}
    files = {
        facts / "slope_slider_30deg_summary.toml": slides_summary_toml(slides),
        facts / "bouncing_ball_summary.toml": bounces_summary_toml(read_impacts(facts)),
    }
    for variant, trials in reconstruct(scoring).items():
        files[scoring / "bands" / f"{variant}.csv"] = band_csv(trials, variant)
        files[scoring / "bands" / f"{variant}.toml"] = band_toml(trials)
        files[scoring / "trials" / f"{variant}.csv"] = trials_csv(trials)
    return files
