"""Plant known motions and known faults in the first frames of the tasks, and judge the tracker by them.

    gauge video prompts --out inputs
    python studies/world_models/planted.py inputs --seeds 0:300 --out calibration.csv

Each seed is one clip: a task, a law with random constants, and one nuisance. The object is cut out of the task's first
frame, what it hid is filled in, and it is drawn along its path with motion blur, noise and JPEG marks. A clip is wrong
when it is graded valid although

- a metric is off: more than 10 % of an acceleration or a period, 0.05 of a momentum transfer, 0.05 N of a dynamic
  error;
- the track is off by more than 5 px and a tenth of the object (median of the retained frames); or
- nothing in it may be valid: another object takes the place of the object, a second one is seen, or the clip is of
  another scene.
"""

from __future__ import annotations

import argparse
import csv
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gauge_envs.tools.video import Grade, Motion, VideoTask, score_track, video_task
from gauge_envs.tools.video.frames import ArrayFrames
from gauge_envs.tools.video.tracker import track_object

TASKS = (
    "SlopeSlider-2-wood",
    "SlopeSlider-2-plastic",
    "SlopeSlider-2-metal",
    "BouncingBall-rubber",
    "BouncingBall-rubber",
    "Turntable-2-wood",
    "Turntable-2-plastic",
    "Turntable-2-metal",
    "NewtonsCradle-metal",
    "Pendulum-metal",
)
NUISANCES = (
    "none", "oblique", "zoom", "shake", "pan", "blur", "jpeg", "noise", "occlusion", "duplicate", "vanish",
    "wrong object", "merge", "hallucination", "blip", "light", "foreign",
)  # fmt: skip
NEVER_VALID = ("wrong object", "duplicate", "hallucination", "foreign")
LIMITS = {"a_m_s2": 0.1, "pd_s": 0.1, "mte": 0.05, "de_n": 0.05}
"""Largest errors of a right clip: relative of accelerations and periods."""

TRACK_PX, TRACK_SIZES = 5.0, 0.1
CUBES = ("SlopeSlider-2", "Turntable-2")
OTHER = {"wood": "metal", "plastic": "wood", "metal": "plastic"}
PLATE_PX = (386.6, 239.5)
"""Centre of the turntable, from a circle through its edge in the three first frames."""

EXPOSURES = 3
Image = NDArray[np.float32]
Path2 = Callable[[float], tuple[NDArray[np.float64], float]]


@dataclass
class Clip:
    """Frames in red, green and blue, their rate, the truth, and the true places [px], shape [frame_count, 2]."""

    task: VideoTask
    nuisance: str
    frames: list[NDArray[np.uint8]]
    fps: float
    truth: dict[str, float]
    places: NDArray[np.float64]
    first: NDArray[np.uint8] | None


class Scene:
    """First frame of a task taken apart: what stands still, and the object with its mask."""

    def __init__(self, folder: Path, task: VideoTask) -> None:
        whole = cv2.imread(str(folder / f"{task.id}.png"))
        self.task, height, width = task, *whole.shape[:2]
        self.mask = np.zeros((height, width), np.float32)
        object_px = task.rest_px or task.centre_px
        if task.motion in (Motion.SLIDE, Motion.TURN):
            angle = 31.6 if task.motion is Motion.SLIDE else 0.0
            box = cv2.boxPoints((object_px, (1.06 * task.size_px,) * 2, -angle))
            if task.motion is Motion.TURN:
                box[box[:, 0] > object_px[0], 0] += 0.18 * task.size_px
            cv2.fillConvexPoly(
                self.mask, np.round(16 * box).astype(int), 1.0, cv2.LINE_AA, 4
            )
        else:
            place = tuple(round(16 * value) for value in object_px)
            cv2.circle(
                self.mask, place, round(8.2 * task.size_px), 1.0, -1, cv2.LINE_AA, 4
            )
        hidden = cv2.dilate((self.mask > 0).astype(np.uint8), np.ones((9, 9), np.uint8))
        if task.motion in (Motion.CRADLE, Motion.PENDULUM):
            end = task.centre_px
            cv2.circle(
                hidden, tuple(round(v) for v in end), round(0.62 * task.size_px), 1, -1
            )
            start = task.pivot_px if task.motion is Motion.PENDULUM else (300.0, 85.0)
            if task.motion is Motion.PENDULUM:
                start = (task.pivot_px[0] + 14.0, task.pivot_px[1] + 60.0)
            cv2.line(
                hidden,
                tuple(round(v) for v in start),
                tuple(round(v) for v in end),
                1,
                9,
            )
        self.whole = whole.astype(np.float32)
        self.still = cv2.inpaint(whole, hidden, 5, cv2.INPAINT_TELEA).astype(np.float32)
        self.object_px = np.array(object_px)
        if task.motion is Motion.TURN:
            rows, columns = np.mgrid[0:height, 0:width]
            self.plate = (
                np.hypot(columns - PLATE_PX[0], rows - PLATE_PX[1]) < 223.0
            ).astype(np.float32)

    def backdrop(self, place: NDArray[np.float64], angle: float) -> Image:
        """Return what is behind the object: the plate turns, and the pendulum has its rod."""
        task, picture = self.task, self.still.copy()
        if task.motion is Motion.TURN:
            turned = cv2.warpAffine(
                self.still, about(PLATE_PX, angle, (0, 0)), (832, 480)
            )
            picture += self.plate[..., None] * (turned - picture)
        if task.motion is Motion.PENDULUM:
            ends = [tuple(round(16 * v) for v in one) for one in (task.pivot_px, place)]
            cv2.line(picture, *ends, (60, 100, 140), 4, cv2.LINE_AA, 4)
        return picture

    def draw(
        self,
        picture: Image,
        exposed: list[tuple[NDArray[np.float64], float]],
        gain: float = 1.0,
    ) -> None:
        """Draw the object into a picture, as the mean over its places and rotations during the exposure."""
        places = np.array([place for place, _ in exposed])
        low = np.clip(
            np.floor(places.min(axis=0) - self.task.size_px).astype(int), 0, (832, 480)
        )
        high = np.clip(
            np.ceil(places.max(axis=0) + self.task.size_px).astype(int), 0, (832, 480)
        )
        if (high <= low).any():
            return
        size, part = (
            tuple(int(v) for v in high - low),
            picture[low[1] : high[1], low[0] : high[0]],
        )
        covered, colour = np.zeros_like(part), np.zeros_like(part)
        for place, angle in exposed:
            turn = angle if self.task.motion is Motion.TURN else 0.0
            matrix = about(self.object_px, turn, place - self.object_px - low)
            mask = cv2.warpAffine(self.mask, matrix, size)[..., None] / len(exposed)
            covered += mask
            colour += mask * gain * cv2.warpAffine(self.whole, matrix, size)
        part *= 1.0 - covered
        part += colour


def about(centre: object, angle: float, shift: object) -> NDArray[np.float64]:
    """Return a rotation about a point, clockwise in the picture [rad], and a shift after it."""
    matrix = cv2.getRotationMatrix2D(tuple(map(float, centre)), -np.degrees(angle), 1.0)
    matrix[:, 2] += shift
    return matrix


def path_of(  # noqa: C901
    task: VideoTask, rng: np.random.Generator, duration: float
) -> tuple[Path2, dict[str, float], float, float]:
    """Return place and rotation as a function of time, the truth, and when the motion begins and ends [s]."""
    scale, start = task.scale_m_per_px, np.array(task.centre_px)
    release = float(rng.uniform(0.2, 0.8))
    if task.motion in (Motion.SLIDE, Motion.FALL):
        reach = 400.0 if task.motion is Motion.SLIDE else 365.0
        lasts = float(rng.uniform(0.6, duration - release - 0.3))
        a = 2.0 * reach * scale / lasts**2

        def straight(t):
            since = np.clip(t - release, 0.0, lasts)
            s = 0.5 * a * since**2 / scale
            late = t - release - lasts
            if task.motion is Motion.FALL and late > 0.0:
                s = max(0.0, s - (0.6 * a * lasts * late - 0.5 * a * late**2) / scale)
            return start + np.array(task.direction) * s, 0.0

        return straight, {"a_m_s2": a}, release, release + lasts
    pivot = np.array(PLATE_PX if task.motion is Motion.TURN else task.pivot_px)
    if task.motion is Motion.TURN:
        rate, sign = float(rng.uniform(0.8, 3.0)), rng.choice([-1.0, 1.0])

        def turning(t):
            since = max(0.0, t - release)
            angle = (
                sign * rate * (0.5 * since**2 / 0.5 if since < 0.5 else since - 0.25)
            )
            c, s = np.cos(angle), np.sin(angle)
            return pivot + np.array([[c, -s], [s, c]]) @ (start - pivot), angle

        return turning, {"de_n": 0.0}, release, duration
    if task.motion is Motion.PENDULUM:
        period, damping = float(rng.uniform(0.8, 2.2)), float(rng.uniform(0.0, 0.2))
        length, amplitude = (
            float(np.linalg.norm(start - pivot)),
            float(np.arctan2(*(start - pivot))),
        )

        def swinging(t):
            angle = amplitude * np.exp(-damping * t) * np.cos(2.0 * np.pi * t / period)
            return pivot + length * np.array([np.sin(angle), np.cos(angle)]), 0.0

        return swinging, {"pd_s": period}, 0.0, duration
    length = task.rest_px[1] - task.pivot_px[1]
    ratios = rng.uniform(0.35, 0.95) * np.array([1.08, 0.92])
    peaks = np.arccos(1.0 - ratios**2 * task.release_height_m / scale / length)

    def outgoing(t):
        angle = 0.0
        for number, peak in enumerate(peaks):
            since = t - release - 1.0 * number
            if 0.0 < since < 0.5:
                angle = float(peak * np.sin(np.pi * since / 0.5))
        return pivot + length * np.array([np.sin(angle), np.cos(angle)]), 0.0

    return outgoing, {"mte": float(ratios.mean())}, release, duration


def planted(scenes: dict[str, Scene], seed: int) -> Clip:  # noqa: C901
    """Return the clip of a seed."""
    rng = np.random.default_rng([36, seed])
    scene = scenes[TASKS[int(rng.integers(len(TASKS)))]]
    task = scene.task
    nuisance = NUISANCES[int(rng.integers(len(NUISANCES)))]
    fps, duration = float(rng.choice([12, 16, 24])), 2.4
    place, truth, begins, ends = path_of(task, rng, duration)
    middle = begins + rng.uniform(0.3, 0.7) * (ends - begins)
    if nuisance == "vanish" and task.motion is Motion.CRADLE:
        # The truth is what the clip shows: the apices before the ball vanishes.
        shown = [
            truth["mte"] * ratio
            for ratio, at in ((1.08, 0.25), (0.92, 1.25))
            if begins + at < middle
        ]
        truth = {"mte": float(np.mean(shown)) if shown else float("nan")}
    noise = rng.uniform(8, 18) if nuisance == "noise" else rng.uniform(0, 3)
    quality = (
        int(rng.uniform(8, 25)) if nuisance == "jpeg" else int(rng.uniform(70, 95))
    )
    strength = float(rng.uniform(0.2, 1.0))
    away = rng.normal(0.0, 1.0, (2,))
    name, material = task.id.rsplit("-", 1)
    other = scenes[
        f"{name}-{OTHER[material]}"
        if material in OTHER and name in CUBES
        else "Turntable-2-wood"
    ]
    shake = np.cumsum(rng.normal(0.0, 1.0, (200, 2)), axis=0) * 0.2 + rng.normal(
        0.0, 1.0, (200, 2)
    )
    still = scene.still
    if nuisance == "merge":
        scene.still = still.copy()
        at = (
            np.array(place(begins + 0.6 * (ends - begins))[0])
            + away / np.linalg.norm(away) * task.size_px
        )
        colour = scene.whole[int(scene.object_px[1]), int(scene.object_px[0])]
        cv2.circle(
            scene.still,
            tuple(map(round, at)),
            round(0.7 * task.size_px),
            tuple(map(float, colour)),
            -1,
        )
    sheet = rng.normal(0.0, noise, (480, 832, 1)).astype(np.float32)
    blip = int(rng.integers(1, 4))
    corners = np.float32([[0, 0], [832, 0], [832, 480], [0, 480]])
    bent = cv2.getPerspectiveTransform(
        corners, corners + rng.uniform(-30, 30, (4, 2)).astype(np.float32)
    )
    drift = rng.normal(0.0, 1.0, 2)
    frames, places = [], []
    for number in range(int(duration * fps)):
        t = number / fps
        picture = scene.backdrop(*place(t))
        exposed = [
            place(max(t + part / EXPOSURES * 0.4 / fps, 0.0))
            for part in range(-1, EXPOSURES - 1)
        ]
        if nuisance == "blip" and number == blip:
            exposed = [
                (where + 23.0 * away / np.linalg.norm(away), angle)
                for where, angle in exposed
            ]
        if nuisance == "wrong object" and t > begins + 0.1 * (ends - begins):
            other.draw(picture, exposed)
        elif not (nuisance == "vanish" and t > middle):
            scene.draw(
                picture,
                exposed,
                1.0 + 0.35 * strength * np.sin(4.0 * t) * (nuisance == "light"),
            )
        if nuisance == "duplicate" and t > middle:
            scene.draw(
                picture,
                [
                    (where - 1.6 * task.size_px * np.sign(away), angle)
                    for where, angle in exposed
                ],
            )
        if nuisance == "hallucination" and t > middle:
            scene.draw(
                picture,
                [(np.array([280.0 + (t - middle) * 120.0 * strength, 240.0]), 0.0)],
            )
        if nuisance == "occlusion" and t > 0.15:
            at = place(middle)[0]
            cv2.rectangle(picture, *[tuple(map(round, at + s * np.array([0.35, 0.9]) * task.size_px)) for s in (-1, 1)],
                          (120.0, 60.0, 150.0), -1)  # fmt: skip
        if nuisance in ("zoom", "shake", "pan"):
            zoom = 1.0 + (
                0.06 * strength * np.sign(away[0]) * t / duration
                if nuisance == "zoom"
                else 0.0
            )
            matrix = cv2.getRotationMatrix2D((416, 240), 0.0, zoom)
            if nuisance == "shake":
                matrix[:, 2] += 3.0 * strength * (shake[number] - shake[0])
            if nuisance == "pan":
                matrix[:, 2] += 40.0 * strength * t / duration * drift
            picture = cv2.warpAffine(
                picture, matrix, (832, 480), borderMode=cv2.BORDER_REPLICATE
            )
        if nuisance == "oblique":
            picture = cv2.warpPerspective(
                picture, bent, (832, 480), borderMode=cv2.BORDER_REPLICATE
            )
        if nuisance == "blur":
            picture = cv2.GaussianBlur(picture, (0, 0), 1.0 + 2.5 * strength)
        grain = np.roll(sheet, rng.integers(0, 400, 2), axis=(0, 1))
        grainy = np.clip(picture + grain, 0, 255).astype(np.uint8)
        packed = cv2.imencode(".jpg", grainy, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        frames.append(cv2.imdecode(packed, cv2.IMREAD_COLOR)[:, :, ::-1])
        places.append(place(t)[0])
    scene.still = still
    first = None
    if nuisance == "foreign":
        # The picture that is given is the clip's own first frame, and shows another scene.
        flipped = [np.ascontiguousarray(frame[:, ::-1]) for frame in frames]
        frames, first = flipped, flipped[0]
    return Clip(task, nuisance, frames, fps, truth, np.array(places), first)


def judged(clip: Clip, seed: int) -> tuple[dict[str, str], float]:
    """Return a row of the table, with what was planted and what was measured, and the processor time [s]."""
    started = time.process_time()
    source = ArrayFrames(clip.frames, fps=clip.fps)
    with tempfile.TemporaryDirectory() as folder:
        first = None
        if clip.first is not None:
            first = Path(folder) / "first.png"
            cv2.imwrite(str(first), clip.first[:, :, ::-1])
        track = track_object(source, clip.task, first_frame=first)
        result = score_track(track, clip.task)
    cpu_s = time.process_time() - started
    ((name, truth),) = clip.truth.items()
    value, interval = result.metrics[name], result.uncertainty[name]
    off_px = float("nan")
    if result.interval_frames is not None:
        first_row, last_row = np.searchsorted(track.frames, result.interval_frames)
        rows = np.arange(first_row, last_row + 1)[
            track.is_found[first_row : last_row + 1]
        ]
        off = np.linalg.norm(
            track.points_px[rows] - clip.places[track.frames[rows]], axis=1
        )
        off_px = float(np.median(off)) if len(off) else off_px
    limit = LIMITS[name] * (truth if name in ("a_m_s2", "pd_s") else 1.0)
    is_off = value is None or not abs(value - truth) <= limit
    is_valid = result.grade is Grade.VALID
    is_wrong = is_valid and (
        is_off
        or not off_px <= max(TRACK_PX, TRACK_SIZES * clip.task.size_px)
        or clip.nuisance in NEVER_VALID
    )
    holds = interval is not None and interval[0] - 1e-9 <= truth <= interval[1] + 1e-9
    ends = [""] * 2 if interval is None else [f"{end:.4g}" for end in interval]
    return {
        "seed": str(seed), "task": clip.task.id, "nuisance": clip.nuisance, "metric": name, "truth": f"{truth:.4g}",
        "value": "" if value is None else f"{value:.4g}", "low": ends[0], "high": ends[1], "grade": result.grade.value,
        "off_px": f"{off_px:.2f}", "is_wrong": str(int(is_wrong)), "holds": str(int(holds)),
        "reasons": "; ".join(result.reasons)[:160],
    }, cpu_s  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("inputs", type=Path, help="folder with TASK.png")
    parser.add_argument("--seeds", default="0:300")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    scenes = {task: Scene(arguments.inputs, video_task(task)) for task in set(TASKS)}
    rows, seconds = [], []
    with arguments.out.open("w", newline="", encoding="utf-8") as file:
        writer = None
        for seed in range(*map(int, arguments.seeds.split(":"))):
            row, cpu_s = judged(planted(scenes, seed), seed)
            if writer is None:
                writer = csv.DictWriter(file, row, lineterminator="\n")
                writer.writeheader()
            writer.writerow(row)
            file.flush()
            rows.append(row)
            seconds.append(cpu_s)
    for name in ("task", "nuisance"):
        for value in sorted({row[name] for row in rows}):
            print(f"{value}: {counted([row for row in rows if row[name] == value])}")
    print(counted(rows))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    print(
        f"{np.mean(seconds):.1f} s of processor time a clip, {max(seconds):.1f} at most; {memory:.0f} MB at most"
    )


def counted(rows: list[dict[str, str]]) -> str:
    """Return how many clips are valid, wrong and within their intervals."""
    valid = [row for row in rows if row["grade"] == "valid"]
    fair = [row for row in valid if row["nuisance"] not in NEVER_VALID]
    doubtful = sum(row["grade"] == "doubtful" for row in rows)
    wrong, held = (
        sum(int(row[name]) for row in part)
        for name, part in (("is_wrong", valid), ("holds", fair))
    )
    grades = f"{len(rows)} clips, {len(valid)} valid, {doubtful} doubtful"
    return f"{grades}; {wrong} wrong among the valid; intervals hold in {held} of {len(fair)}"


if __name__ == "__main__":
    main()
