"""Reader of driven bodies of a USD stage: exact motion, and time samples of its transform."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from pxr import Usd

from gauge_envs.errors import ShapeError
from gauge_envs.scene.drivers import Driver, DriverMotion
from gauge_envs.scene.geometry import Pose, pose_distance
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.bench.driver_fit import sampled_motions
from gauge_envs.tools.usd.layer import (
    TEXT,
    WRITTEN,
    motions_digest,
    motions_from_json,
    samples_digest,
)
from gauge_envs.tools.usd.source import Source

AGREES = 1e-6
"""Largest difference between time samples and `gauge:driver` [m, rad] if both were edited."""

LONGEST_S = 3600.0
"""Longest duration of time samples [s]; longer ones have another unit of time or are damaged."""

Track = dict[float, Pose]
"""Poses by time code."""


def driven_body(
    source: Source, prim: Usd.Prim, name: str, pose_at: Callable[[Usd.TimeCode], Pose]
) -> tuple[Pose, Driver | None, int | None]:
    """Return the start pose and the driver of a kinematic body.

    `gauge:driver` contains the exact motion; the time samples of the transform contain its poses at the frames. The
    edited one of both counts. Edited samples, and samples without `gauge:driver`, become sampled motions with monotone
    cubic interpolation. Between samples that are more than a frame apart, the poses at the frames are added. An edited
    motion was not measured, so its provenance is `nominal` and mentions the edit.

    Args:
        source: The stage.
        prim: Prim of the body.
        name: Name of the body.
        pose_at: Function that returns the body's pose at a time code.

    Returns:
        The pose before anything moves; the driver, or None if the body does not move; and the index of the driver in
        the scene, or None if the file does not define it.
    """
    start = Usd.TimeCode(source.start)
    samples = {code: pose_at(Usd.TimeCode(code)) for code in source.sample_codes(prim)}
    if samples and source.seconds(max(samples)) > LONGEST_S:
        last_s = source.seconds(max(samples))
        raise source.fault(
            prim,
            f"its time samples end after {last_s:.6g} s: {LONGEST_S:.6g} s at most are expected",
        )
    track = _timeline(source, samples, pose_at)
    attribute = prim.GetAttribute("gauge:driver")
    text = source.text(attribute)
    if text is None:
        poses = list(track.values())
        if all(pose_distance(pose, poses[0]) == 0.0 for pose in poses):
            return pose_at(start), None, None
        motions = _sampled(source, prim, poses[0], track, ())
        if not motions:
            return poses[0], None, None
        provenance = f"nominal: time samples of {source.file.name}"
        return poses[0], Driver(body=name, motions=motions, provenance=provenance), None
    try:
        motions, place = motions_from_json(text)
    except ValueError as error:
        reason = "; ".join(str(error).splitlines()[:3])
        raise source.fault(
            attribute, f"is not as the writer writes it: {reason}"
        ) from None
    provenance = source.text(prim.GetAttribute("gauge:driver_provenance")) or "nominal"
    driver = Driver(body=name, motions=motions, provenance=provenance)
    pose, driver = _edited(
        source, prim, driver, pose_at(Usd.TimeCode.Default()), samples, track
    )
    return pose, driver, place


def _edited(
    source: Source,
    prim: Usd.Prim,
    driver: Driver,
    start: Pose,
    samples: Track,
    track: Track,
) -> tuple[Pose, Driver]:
    """Return the start pose and the driver of a body with `gauge:driver` and possibly time samples."""
    attribute = prim.GetAttribute("gauge:driver")
    changed = replace(
        driver,
        provenance=f"nominal: edited in {source.file.name}, was {driver.provenance}",
    )
    is_edited = motions_digest(attribute.Get()) != attribute.GetCustomDataByKey(TEXT)
    written = attribute.GetCustomDataByKey(WRITTEN)
    apart = [
        pose_distance(driver.pose(start, source.seconds(code)), pose)
        for code, pose in track.items()
        if samples
    ]
    if not samples or (written is not None and _digest(source, samples) == written):
        if not is_edited and samples and apart[0] > AGREES:
            raise source.fault(
                prim,
                "its pose was edited, but not the time samples of its transform: edit both, or delete the samples, so "
                "that gauge:driver moves it from the edited pose",
            )
        return start, changed if is_edited else driver
    if is_edited or written is None:
        if max(apart) > AGREES:
            raise source.fault(
                attribute,
                f"puts the body up to {max(apart):.3g} (m, rad) away from the time samples of its transform, and both "
                "were edited: make them agree, or delete one",
            )
        return start, changed
    first = next(iter(track.values()))
    # If the samples start elsewhere than the driver, the body starts there too: a jump would throw other bodies.
    if apart[0] > AGREES:
        start = first
    return start, replace(
        changed, motions=_sampled(source, prim, start, track, driver.motions)
    )


def _timeline(
    source: Source, samples: Track, pose_at: Callable[[Usd.TimeCode], Pose]
) -> Track:
    """Return poses from the start of the stage on, at two times or more, with at most a frame between them.

    USD interpolates stored values such as angles. Poses at the keys alone would miss a full rotation between two keys.
    """
    keys = sorted({source.start, *(code for code in samples if code > source.start)})
    if len(keys) == 1:
        keys.append(source.start + 1.0)
    codes = [keys[0]]
    for one, other in pairwise(keys):
        steps = math.ceil((other - one) / source.rate * FRAME_RATE_HZ - 1e-6)
        codes += (
            [one + (other - one) * step / steps for step in range(1, steps)]
            if steps > 1
            else []
        )
        codes.append(other)
    return {code: samples.get(code) or pose_at(Usd.TimeCode(code)) for code in codes}


def _digest(source: Source, samples: Track) -> str:
    return samples_digest(
        np.array([source.seconds(code) for code in samples]),
        np.array([pose.position_m for pose in samples.values()]),
        np.array([pose.quaternion for pose in samples.values()]),
    )


def _sampled(
    source: Source,
    prim: Usd.Prim,
    start: Pose,
    track: Track,
    like: Sequence[DriverMotion],
) -> tuple[DriverMotion, ...]:
    times_s = [source.seconds(code) for code in track]
    try:
        return sampled_motions(start, times_s, list(track.values()), like=like)
    except ShapeError as error:
        raise source.fault(
            prim, f"the time samples of its transform: {error}"
        ) from None
