"""Reader of driven bodies of a USD stage: exact motion, and time samples of its transform."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from pxr import Usd
from pydantic import TypeAdapter

from gauge_envs.formats.usd.layer import (
    TEXT,
    WRITTEN,
    motions_digest,
    samples_digest,
)
from gauge_envs.formats.usd.source import Source
from gauge_envs.scene import Pose
from gauge_envs.scene.driver_fit import sampled_motions
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.timing import FRAME_RATE_HZ

MOTIONS = TypeAdapter(tuple[DriverMotion, ...])
Track = dict[float, Pose]
"""Poses by time code."""


def read_driven(
    source: Source, prim: Usd.Prim, name: str, pose_at: Callable[[Usd.TimeCode], Pose]
) -> tuple[Pose, Driver | None, float]:
    """Return the start pose and the driver of a kinematic body.

    `gauge:driver` contains the exact motion relative to the start pose; the time samples of the transform contain its
    poses at the frames. Edited samples override `gauge:driver`. Edited samples, and samples without
    `gauge:driver`, become sampled motions with monotone cubic interpolation. An edited motion was not measured, so its
    provenance is `nominal` and mentions the edit.

    Args:
        source: The stage.
        prim: Prim of the body.
        name: Name of the body.
        pose_at: Function that returns the body's pose at a time code.

    Returns:
        The pose before anything moves; the driver, or None if the body does not move; and the index of the driver in
        the scene, which is infinite if the file does not define it.

    Raises:
        AssetError: The motion cannot be read.
    """
    samples = {code: pose_at(Usd.TimeCode(code)) for code in source.sample_codes(prim)}
    provenance = f"nominal: time samples of {source.file.name}"
    index: float = np.inf
    like: tuple[DriverMotion, ...] = ()
    attribute = prim.GetAttribute("gauge:driver")
    if text := source.text(attribute):
        with source.errors_at(attribute):
            record = json.loads(text)
            index, like = record["index"], MOTIONS.validate_python(record["motions"])
        was = source.text(prim.GetAttribute("gauge:driver_provenance")) or "nominal"
        provenance = f"nominal: edited in {source.file.name}, was {was}"
        times_s = [source.seconds(code) for code in samples]
        poses = [[*pose.position_m, *pose.quaternion] for pose in samples.values()]
        if not samples or samples_digest(
            times_s, np.array(poses)
        ) == attribute.GetCustomDataByKey(WRITTEN):
            if motions_digest(text) == attribute.GetCustomDataByKey(TEXT):
                provenance = was
            driver = Driver(body=name, motions=like, provenance=provenance)
            return pose_at(Usd.TimeCode.Default()), driver, index
    track = _track(source, samples, pose_at)
    times_s = [source.seconds(code) for code in track]
    start = track[source.start]
    motions = sampled_motions(start, times_s, list(track.values()), like=like)
    driver = Driver(body=name, motions=motions, provenance=provenance)
    return start, driver if motions else None, index


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
