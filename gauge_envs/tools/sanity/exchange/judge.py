"""Judge the motion that another simulator wrote for the scenes of an exported folder.

Example:
    >>> from pathlib import Path
    >>> from gauge_envs.tools.sanity import judge
    >>> report = judge(Path("my_engine"))  # doctest: +SKIP
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gauge_envs.errors import TargetError
from gauge_envs.files import json_document, read_regular, versions
from gauge_envs.runs.rollout import DivergedError, Rollout
from gauge_envs.scene import Box, Sphere
from gauge_envs.tools.sanity.exchange.export import MOST_MANIFEST_BYTES
from gauge_envs.tools.sanity.exchange.motion import driver_misses, read_motion
from gauge_envs.tools.sanity.exchange.scenes import FORMAT, MANIFEST, MOTION, VERSION, ExportedScene, scenes
from gauge_envs.tools.sanity.measure import Measured, curve_of, judged, result_of
from gauge_envs.tools.sanity.model import PhenomenonResult, Report, TrainingConfiguration, Verdict
from gauge_envs.tools.sanity.phenomena import GRAVITY_ID, selection
from gauge_envs.tools.sanity.phenomena.base import Phenomenon
from gauge_envs.tools.sanity.phenomena.impact import CLEAR_MM
from gauge_envs.tools.sanity.stacks.dialect import TOML
from gauge_envs.tools.sanity.stated import gravity_row

UNKNOWN_ENGINE = "recorded motion"
"""Name of an engine that the user does not state."""

FREE_FALL = "drop"
"""Scene whose balls fall freely, from which gravity is measured."""

SAME_NUMBER = 1e-9
"""Relative difference up to which numbers of a manifest are those of this version."""

DRIVER_MM, DRIVER_DEG = 1.0, 1.0
"""Distance and angle of a driven body from its driver that are reported."""


def judge(folder: Path, *, only: Sequence[str] = (), engine: str = "") -> Report:
    """Return what physics a simulator gets wrong, from the motion that it wrote for exported scenes.

    Gravity is measured in the free fall of the balls of the scene `drop`. A scene without a motion file is declined.

    Args:
        folder: Folder that `gauge_envs.tools.sanity.export` wrote.
        only: Ids of phenomena or patterns such as `creep-*`; all that were exported when empty.
        engine: Name of the simulator for the report.

    Returns:
        The report, with a row for each phenomenon in a fixed order, and neither causes nor values of a preset.
    """
    started = time.perf_counter()
    exported = _exported(folder)
    chosen = selection(only)
    outcomes = {
        scene: _read(folder, scene)
        for scene in exported
        if any(one.id in chosen for one in scene.phenomena) or (GRAVITY_ID in chosen and scene.name == FREE_FALL)
    }
    configuration = _configuration(folder, engine, outcomes)
    rows = [_row(one, outcomes[scene]) for scene in outcomes for one in scene.phenomena if one.id in chosen]
    rows.sort(key=lambda row: chosen.index(row.phenomenon))
    if GRAVITY_ID in chosen:
        rows = [_gravity_row(configuration, outcomes), *rows]
    return Report(
        configuration=configuration,
        rows=tuple(rows),
        versions=versions(),
        wall_s=time.perf_counter() - started,
    )


def _exported(folder: Path) -> tuple[ExportedScene, ...]:
    """Return the scenes of a folder, which must be those of this version of the package."""
    path = folder / MANIFEST
    try:
        content = json_document(read_regular(path, MOST_MANIFEST_BYTES))
    except OSError as error:
        raise TargetError(
            f"{path}: cannot be read: {error.strerror or error}: export with gauge sanity export"
        ) from None
    except ValueError as error:
        raise TargetError(f"{path}: {error}: export again with gauge sanity export") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise TargetError(f"{path}: is no manifest of gauge sanity export")
    if content.get("version") != VERSION:
        raise TargetError(f"{path}: has version {content.get('version')!r}, expected {VERSION}: export again")
    listed = content.get("scenes")
    named = (one for one in (listed if isinstance(listed, list) else ()) if isinstance(one, dict))
    entries = {one["name"]: one for one in named if isinstance(one.get("name"), str)}
    known = {scene.name: scene for scene in scenes()}
    if not entries or not set(entries) <= set(known):
        raise TargetError(f"{path}: lists no scenes, or unknown ones: export again")
    for name, entry in entries.items():
        place = _difference(known[name].entry(), entry)
        if place is not None:
            raise TargetError(
                f"{path}: scene {name!r}: {place} is not that of this version of gauge-envs: export again, and run the "
                "scenes again"
            )
    return tuple(scene for name, scene in known.items() if name in entries)


def _difference(expected: Any, found: Any, place: str = "") -> str | None:
    """Return the place of the first difference between two JSON documents beyond rounding; None without one."""
    if isinstance(expected, dict) and isinstance(found, dict) and expected.keys() == found.keys():
        parts = ((key, expected[key], found[key]) for key in expected)
    elif isinstance(expected, list) and isinstance(found, list) and len(expected) == len(found):
        parts = ((str(i), one, other) for i, (one, other) in enumerate(zip(expected, found, strict=True)))
    elif isinstance(expected, float) and isinstance(found, int | float):
        return None if math.isclose(expected, found, rel_tol=SAME_NUMBER, abs_tol=1e-12) else place
    else:
        return None if type(expected) is type(found) and expected == found else place
    for key, one, other in parts:
        different = _difference(one, other, f"{place}.{key}".lstrip("."))
        if different is not None:
            return different
    return None


_Outcome = Rollout | DivergedError | str
"""Motion of a scene, why it diverged, or why there is none."""

_Outcomes = Mapping[ExportedScene, _Outcome]


def _read(folder: Path, scene: ExportedScene) -> _Outcome:
    file = folder / scene.name / MOTION
    if not file.exists():
        return f"{scene.name}/{MOTION} is missing"
    try:
        return read_motion(file, scene)
    except DivergedError as error:
        return error


def _configuration(folder: Path, engine: str, outcomes: _Outcomes) -> TrainingConfiguration:
    rollouts = {scene: one for scene, one in outcomes.items() if isinstance(one, Rollout)}
    missing = [scene.name for scene, one in outcomes.items() if isinstance(one, str)]
    notes = []
    if missing:
        notes.append(f"{len(missing)} of {len(outcomes)} scenes have no {MOTION}: {', '.join(missing)}")
    slow = sum(one.interval_s > 1.01 * scene.scenario.interval_s for scene, one in rollouts.items())
    if slow:
        notes.append(f"samples of {slow} scenes are farther apart than asked for: write more if your step is shorter")
    for scene, rollout in rollouts.items():
        for body, (millimetres, degrees) in driver_misses(rollout).items():
            if millimetres > DRIVER_MM or degrees > DRIVER_DEG:
                off = f"{millimetres:.3g} mm and {degrees:.3g} deg"
                notes.append(f"{scene.name}: driven body {body!r} is up to {off} off its driver")
    notes.append("nothing was simulated here: there is no preset to compare with, and no change was tried")
    intervals = sorted({float(f"{one.interval_s:.6g}") for one in rollouts.values()})
    settings = {"sample_interval_s": intervals[0] if len(intervals) == 1 else intervals} if intervals else {}
    return TrainingConfiguration(
        name=engine or folder.resolve().name,
        source=f"motion files in {folder}",
        backend=engine or UNKNOWN_ENGINE,
        settings=settings,
        origins=dict.fromkeys(settings, MOTION),
        notes=tuple(notes),
        gravity_m_per_s2=next((_gravity(one) for scene, one in rollouts.items() if scene.name == FREE_FALL), None),
    )


# --- rows ------------------------------------------------------------------------------------------------------------


def _row(phenomenon: Phenomenon, outcome: _Outcome) -> PhenomenonResult:
    measured = _measured(phenomenon, outcome)
    return result_of(phenomenon, measured, None, curve=curve_of(phenomenon, measured, None))


def _measured(phenomenon: Phenomenon, outcome: _Outcome) -> Measured:
    if isinstance(outcome, DivergedError):
        return Measured(verdict=Verdict.WRONG, remark=f"diverged: {outcome}")
    if isinstance(outcome, str):
        return Measured(verdict=Verdict.DECLINED, remark=outcome)
    measured = judged(phenomenon.read(outcome), phenomenon.reality, outcome)
    if measured.verdict in (Verdict.VISIBLE, Verdict.WRONG) and measured.value is not None:
        text = _friction_text(phenomenon, measured.value)
        return replace(measured, remark="; ".join(part for part in (measured.remark, text) if part))
    return measured


def _friction_text(phenomenon: Phenomenon, value: float) -> str:
    """Return the coefficient of friction with which a cube slides at an acceleration; empty for other phenomena."""
    scene = phenomenon.scenario.scene
    if not phenomenon.id.startswith("slide-") or not isinstance(scene.body("board").shape, Box):
        return ""
    downhill = scene.body("board").pose.rotation.apply([1.0, 0.0, 0.0])
    friction = (-float(downhill[2]) - value / scene.gravity_m_per_s2) / float(np.hypot(*downhill[:2]))
    stated = next(contact.friction for contact in scene.contacts if "board" in contact.second)
    return f"as with a friction of {friction:.3f}, stated is {stated:.3f}"


def _gravity_row(configuration: TrainingConfiguration, outcomes: _Outcomes) -> PhenomenonResult:
    row = gravity_row(configuration, TOML)
    if row.configured is not None:
        return replace(row, default=None, default_verdict=Verdict.DECLINED)
    reason = next((str(one) for scene, one in outcomes.items() if scene.name == FREE_FALL), "was not exported")
    return replace(row, remark=f"measured in the fall of the balls of the scene {FREE_FALL!r}: {reason}")


def _gravity(rollout: Rollout) -> tuple[float, float, float] | None:
    """Return the mean acceleration of the balls before they reach the ground [m/s^2], shape [3]."""
    ground = rollout.scene.body("ground").pose.position_m[2]
    fits = []
    for ball in rollout.scene.dynamic_bodies:
        assert isinstance(ball.shape, Sphere)
        place = rollout.position(ball.name)
        low = place[:, 2] - ground - ball.shape.radius_m < 1e-3 * CLEAR_MM
        flight = slice(0, int(low.argmax()) if low.any() else len(low))
        if flight.stop >= 4:
            # The first sample is left out: the first step of some integrators is half a step of gravity off.
            fits.append(2.0 * np.polyfit(rollout.times_s[1 : flight.stop], place[1 : flight.stop], 2)[0])
    if not fits:
        return None
    x, y, z = np.mean(fits, axis=0).tolist()
    return x, y, z
