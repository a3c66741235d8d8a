"""Features of a scene that the Drake backend does not support. Needs no engine, so it is fast."""

from __future__ import annotations

from collections.abc import Iterator

from gauge_envs.scene import Compound, Scene

REASONS = {
    "Cloth": "Drake has no cloth",
    "SoftBody": "this backend does not build Drake's volume elements, linear tetrahedra, which lock: a cantilever of "
    "480 of them bends by 3.63 mm and one of 3840 by 5.43 mm, where theory gives 5.89 mm",
    "Rope": "Drake has no ropes",
    "Rod": "Drake has no elastic rods",
}


def unsupported_features(scene: Scene) -> Iterator[str]:
    """Yield one sentence for each kind of feature of a scene that this backend does not build."""
    compound = next((body.name for body in scene.bodies if isinstance(body.shape, Compound)), None)
    if compound is not None:
        yield f"{compound!r} is a compound of solids, and this backend builds one solid or convex pieces for each body"
    subjects: dict[str, list[str]] = {}
    for body in scene.deformables:
        subjects.setdefault(REASONS[type(body).__name__], []).append(body.name)
    for reason, names in subjects.items():
        others = f" (and {len(names) - 1} more)" if len(names) > 1 else ""
        yield f"{names[0]!r}{others} is deformable: {reason}"
