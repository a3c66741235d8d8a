"""Generated faults of pairs that collide, of joints and of attachments: those that are missing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from gauge_envs.scene import (
    Attachment,
    BodyHinge,
    Box,
    Contact,
    Hinge,
    Scene,
    Slider,
    Tether,
)


def _pairs(scene: Scene) -> list[tuple[Contact, tuple[str, str]]]:
    return [
        (one, pair) for one in scene.contacts for pair in scene.colliding_pairs(one)
    ]


def _without_pairs(
    chosen: Callable[[int, int, Contact, tuple[str, str], Scene], bool],
) -> Callable[[Scene], Scene]:
    def changed(scene: Scene) -> Scene:
        pairs = _pairs(scene)
        left = [
            (contact, pair)
            for number, (contact, pair) in enumerate(pairs)
            if not chosen(number, len(pairs), contact, pair, scene)
        ]
        if len(left) == len(pairs):
            return scene
        contacts = tuple(
            replace(contact, first=(one,), second=(other,))
            for contact, (one, other) in left
        )
        return replace(scene, contacts=contacts)

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


def pair_faults() -> Iterator[tuple[str, str, str, Callable[[Scene], Scene]]]:  # noqa: C901
    for number, name in ((0, "first"), (1, "second"), (-1, "last")):
        yield (
            "Contact.pair",
            "kth",
            name,
            _without_pairs(
                lambda n, count, c, pair, s, m=number: (
                    count > 1 and n == (m if m >= 0 else count - 1)
                )
            ),
        )
    yield (
        "Contact.pair",
        "drop",
        "all",
        _without_pairs(lambda n, count, c, pair, s: True),
    )
    yield (
        "Contact.pair",
        "frame",
        "crossed-boxes",
        _without_pairs(lambda n, count, c, pair, s: _crossed(pair, s)),
    )
    for soft in ("Cloth", "SoftBody", "Rope", "Rod"):
        for other in ("dynamic", "fixed", "kinematic", soft):
            yield (
                "Contact.pair",
                "side",
                f"deformable-{soft}-{other}",
                _without_pairs(
                    lambda n, count, c, pair, s, one=soft, two=other: (
                        sorted(_kind(x, s) for x in pair) == sorted((one, two))
                    )
                ),
            )
    for one, two in (
        ("dynamic", "dynamic"),
        ("dynamic", "fixed"),
        ("dynamic", "kinematic"),
    ):
        yield (
            "Contact.pair",
            "side",
            f"{one}-{two}",
            _without_pairs(
                lambda n, count, c, pair, s, x=one, y=two: (
                    sorted(_kind(z, s) for z in pair) == sorted((x, y))
                )
            ),
        )
    for side in ("fixed-first", "dynamic-first"):
        yield (
            "Contact.pair",
            "side",
            side,
            _without_pairs(
                lambda n, count, c, pair, s, x=side: (
                    (_kind(pair[0], s) == "dynamic") == (x == "dynamic-first")
                )
            ),
        )
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
                parts = [one for one in getattr(scene, name) if isinstance(one, kind)]
                if not parts or (number is not None and len(parts) < 2):
                    return scene
                gone = parts if number is None else [parts[number]]
                return replace(
                    scene,
                    **{
                        name: tuple(
                            one for one in getattr(scene, name) if one not in gone
                        )
                    },
                )

            yield owner, how, variant, changed
    for motion in ("dynamic", "fixed", "kinematic"):

        def unattached(scene, motion=motion):
            left = tuple(
                one for one in scene.attachments if _kind(one.to, scene) != motion
            )
            return (
                scene
                if len(left) == len(scene.attachments)
                else replace(scene, attachments=left)
            )

        yield "Attachment.pair", "side", motion, unattached
