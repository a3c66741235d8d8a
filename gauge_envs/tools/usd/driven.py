"""Reader of driven bodies of a USD stage: exact motion, and time samples of its transform."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from pxr import Usd
from pydantic import ValidationError

from gauge_envs.errors import ShapeError, first_fault
from gauge_envs.scene import Pose
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.geometry import pose_distance
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.bench.driver_fit import sampled_motions
from gauge_envs.tools.usd.layer import (
    TEXT,
    WRITTEN,
    DriverRecord,
    motions_digest,
    samples_digest,
)
from gauge_envs.tools.usd.source import MAX_DURATION_S, Source

SAME_POSE = 1e-6
"""Largest difference between equal start poses of time samples and `gauge:driver` [m, rad]."""

Track = dict[float, Pose]
"""Poses by time code."""


def read_driven(
    source: Source, prim: Usd.Prim, name: str, pose_at: Callable[[Usd.TimeCode], Pose]
) -> tuple[Pose, Driver | None, int | None]:
    """Return the start pose and the driver of a kinematic body.

    `gauge:driver` contains the exact motion; the time samples of the transform contain its poses at the frames. The
    edited one of both counts, and the samples if both were edited. Edited samples, and samples without `gauge:driver`,
    become sampled motions with monotone cubic interpolation. An edited motion was not measured, so its provenance is
    `nominal` and mentions the edit.

    Args:
        source: The stage.
        prim: Prim of the body.
        name: Name of the body.
        pose_at: Function that returns the body's pose at a time code.

    Returns:
        The pose before anything moves; the driver, or None if the body does not move; and the index of the driver in
        the scene, or None if the file does not define it.

    Raises:
        AssetError: The motion cannot be read, or contradicts the time samples.
    """
    samples = {code: pose_at(Usd.TimeCode(code)) for code in source.sample_codes(prim)}
    if samples and source.seconds(max(samples)) > MAX_DURATION_S:
        raise source.fault(
            prim, f"its time samples end after more than {MAX_DURATION_S:g} s"
        )
    attribute = prim.GetAttribute("gauge:driver")
    text = source.text(attribute)
    if text is None:
        track = _track(source, samples, pose_at)
        start = track[source.start]
        if all(pose_distance(pose, start) == 0.0 for pose in track.values()):
            return start, None, None
        motions = _sampled(source, prim, start, track)
        provenance = f"nominal: time samples of {source.file.name}"
        driver = Driver(body=name, motions=motions, provenance=provenance)
        return start, driver if motions else None, None
    try:
        record = DriverRecord.model_validate_json(text)
    except ValidationError as error:
        place, reason = first_fault(error)
        raise source.fault(
            attribute, f"is not as the writer writes it: {place} {reason}"
        ) from None
    provenance = source.text(prim.GetAttribute("gauge:driver_provenance")) or "nominal"
    driver = Driver(body=name, motions=record.motions, provenance=provenance)
    start, driver = _edited(source, prim, driver, samples, pose_at)
    return start, driver, record.index


def _edited(
    source: Source,
    prim: Usd.Prim,
    driver: Driver,
    samples: Track,
    pose_at: Callable[[Usd.TimeCode], Pose],
) -> tuple[Pose, Driver]:
    """Return the start pose and the driver of a body with `gauge:driver` and possibly time samples."""
    attribute = prim.GetAttribute("gauge:driver")
    start = pose_at(Usd.TimeCode.Default())
    is_edited = motions_digest(attribute.Get()) != attribute.GetCustomDataByKey(TEXT)
    note = f"nominal: edited in {source.file.name}, was {driver.provenance}"
    changed = replace(driver, provenance=note)
    if not samples:
        return start, changed if is_edited else driver
    track = _track(source, samples, pose_at)
    is_moved = pose_distance(driver.pose(start, 0.0), track[source.start]) > SAME_POSE
    times_s = [source.seconds(code) for code in samples]
    poses = np.array(
        [[*pose.position_m, *pose.quaternion] for pose in samples.values()]
    )
    if samples_digest(times_s, poses) != attribute.GetCustomDataByKey(WRITTEN):
        # If the samples start elsewhere than the driver, the body starts there too: a jump would throw other bodies.
        start = track[source.start] if is_moved else start
        motions = _sampled(source, prim, start, track, driver.motions)
        return start, replace(changed, motions=motions)
    if is_moved and not is_edited:
        raise source.fault(
            prim,
            "its pose was edited, but not the time samples of its transform: edit both, or delete the samples, so that "
            "gauge:driver moves it from the edited pose",
        )
    return start, changed if is_edited else driver


def _track(
    source: Source, samples: Track, pose_at: Callable[[Usd.TimeCode], Pose]
) -> Track:
    """Return poses from the start of the stage on, at two times or more, with at most a frame between them.

    USD interpolates stored values such as angles. Poses at the keys alone would miss a full rotation between two keys.
    """
    keys = sorted({source.start, *(code for code in samples if code > source.start)})
    if len(keys) == 1:
        keys.append(source.start + 1.0)
    codes = keys[:1]
    for first, last in pairwise(keys):
        count = math.ceil((last - first) / source.rate_hz * FRAME_RATE_HZ - 1e-6)
        codes += np.linspace(first, last, max(count, 1) + 1)[1:].tolist()
    return {code: samples.get(code) or pose_at(Usd.TimeCode(code)) for code in codes}


def _sampled(
    source: Source,
    prim: Usd.Prim,
    start: Pose,
    track: Track,
    like: Sequence[DriverMotion] = (),
) -> tuple[DriverMotion, ...]:
    times_s = [source.seconds(code) for code in track]
    try:
        return sampled_motions(start, times_s, list(track.values()), like=like)
    except ShapeError as error:
        raise source.fault(
            prim, f"the time samples of its transform: {error}"
        ) from None
