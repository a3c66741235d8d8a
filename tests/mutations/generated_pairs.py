"""Generated faults of pairs that collide, of joints and of attachments: those that are missing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from gauge_envs.scene import (
    Attachment,
    BodyHinge,
    Box,
    Hinge,
    Scene,
    Slider,
    Tether,
)

Chosen = Callable[[int, int, tuple[str, str], Scene], bool]
"""Number of a pair, number of pairs, pair, scene -> whether it is meant."""


def _without_pairs(chosen: Chosen) -> Callable[[Scene], Scene]:
    def changed(scene: Scene) -> Scene:
        pairs = [
            (one, pair) for one in scene.contacts for pair in scene.colliding_pairs(one)
        ]
        left = [
            replace(contact, first=pair[:1], second=pair[1:])
            for number, (contact, pair) in enumerate(pairs)
            if not chosen(number, len(pairs), pair, scene)
        ]
        if len(left) == len(pairs):
            return scene
        return replace(scene, contacts=tuple(left))

    return changed


def _kind(name: str, scene: Scene) -> str:
    for one in scene.deformables:
        if one.name == name:
            return type(one).__name__
    return scene.body(name).motion.value


def _crossed(pair: tuple[str, str], scene: Scene) -> bool:
    if any(one in {body.name for body in scene.deformables} for one in pair):
        return False
    bodies = [scene.body(name) for name in pair]
    if not all(isinstance(one.shape, Box) for one in bodies):
        return False
    apart = np.abs(
        (bodies[0].pose.rotation.inv() * bodies[1].pose.rotation).as_matrix()
    )
    return bool(((apart > np.cos(np.radians(2.0))).sum()) <= 1) and bool(
        (apart < np.cos(np.radians(88.0))).sum() < 4
    )


MIXES = (
    *(
        (f"deformable-{soft}-{other}", soft, other)
        for soft in ("Cloth", "SoftBody", "Rope", "Rod")
        for other in ("dynamic", "fixed", "kinematic", soft)
    ),
    *(
        (f"dynamic-{other}", "dynamic", other)
        for other in ("dynamic", "fixed", "kinematic")
    ),
)
"""Names of pairs of kinds of bodies, and the two kinds."""


def _lost_pairs() -> Iterator[tuple[str, str, Chosen]]:
    """Yield kind and variant of pairs that do not collide, and which they are."""
    for number, name in ((0, "first"), (1, "second"), (-1, "last")):

        def is_one(n: int, count: int, *rest: Any, number: int = number) -> bool:
            return count > 1 and n in (number, number + count)

        yield "kth", name, is_one
    yield "drop", "all", lambda n, count, pair, scene: True
    yield "frame", "crossed-boxes", lambda n, count, pair, scene: _crossed(pair, scene)
    for name, one, other in MIXES:

        def is_mix(n, count, pair, scene, kinds=(one, other)):
            return sorted(_kind(x, scene) for x in pair) == sorted(kinds)

        yield "side", name, is_mix
    for name, is_dynamic in (("fixed-first", False), ("dynamic-first", True)):

        def is_first(n, count, pair, scene, is_dynamic=is_dynamic):
            return (_kind(pair[0], scene) == "dynamic") == is_dynamic

        yield "side", name, is_first


def pair_faults() -> Iterator[tuple[str, str, str, Callable[[Scene], Scene]]]:
    """Yield quantity, kind, variant and change of the scene."""
    for kind, variant, chosen in _lost_pairs():
        yield "Contact.pair", kind, variant, _without_pairs(chosen)
    for name, kind, owner in (
        ("joints", Hinge, "Hinge.joint"),
        ("joints", Tether, "Tether.joint"),
        ("body_hinges", BodyHinge, "BodyHinge.joint"),
        ("guides", Slider, "Slider.joint"),
        ("attachments", Attachment, "Attachment.pair"),
    ):
        for number, variant, how in (
            (None, "all", "drop"),
            (0, "first", "kth"),
            (-1, "last", "kth"),
        ):

            def changed(scene, name=name, kind=kind, number=number):
                every = getattr(scene, name)
                gone = [one for one in every if isinstance(one, kind)]
                if number is not None:
                    gone = [gone[number]] if len(gone) > 1 else []
                left = tuple(one for one in every if one not in gone)
                return replace(scene, **{name: left}) if gone else scene

            yield owner, how, variant, changed
    for motion in ("dynamic", "fixed", "kinematic"):

        def unattached(scene, motion=motion):
            left = tuple(
                one for one in scene.attachments if _kind(one.to, scene) != motion
            )
            return replace(scene, attachments=left)

        yield "Attachment.pair", "side", motion, unattached
