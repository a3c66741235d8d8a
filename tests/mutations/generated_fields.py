"""Generated faults of the fields of a scene, found by reflection, and of its pairs and joints."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from gauge_envs.backends import Simulation
from gauge_envs.errors import GaugeError
from gauge_envs.scene import Motion, Scene
from gauge_envs.scene.drivers import Driver
from gauge_envs.scene.geometry import vector
from mutations.mutant import Passed


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where a field is edited.

    Attributes:
        value: The value.
        part: The part of the scene that has it.
        every: Values of the field in all parts of its type.
        number: Number of the value among them.
        scene: The scene.
    """

    value: Any
    part: Any
    every: list[Any]
    number: int
    scene: Scene


Edit = Callable[[Place], Any]
"""Returns the new value."""


@dataclass(frozen=True)
class Variant:
    """One of the faults of a field.

    Attributes:
        kind: Kind of fault.
        name: Which of its kind.
        edit: The fault.
        condition: When it is there, as `_holds` reads it; empty for always.
    """

    kind: str
    name: str
    edit: Edit
    condition: str = ""


SKIPPED = (Driver,)


def leaves(part: Any, owner: str, field: str) -> Iterator[tuple[Any, Any]]:
    """Yield each part of a type in a tree, with its value of a field."""
    if isinstance(part, SKIPPED):
        return
    if is_dataclass(part):
        if type(part).__name__ == owner and getattr(part, field) is not None:
            yield part, getattr(part, field)
        for one in fields(part):
            if one.init:
                yield from leaves(getattr(part, one.name), owner, field)
    elif isinstance(part, tuple):
        for one in part:
            yield from leaves(one, owner, field)


def rewritten(
    part: Any, owner: str, field: str, change: Callable[[Any, Any], Any]
) -> Any:
    if isinstance(part, SKIPPED):
        return part
    if is_dataclass(part):
        changes = {}
        for one in fields(part):
            if one.init:
                old = getattr(part, one.name)
                new = rewritten(old, owner, field, change)
                if new is not old:
                    changes[one.name] = new
        if type(part).__name__ == owner and getattr(part, field) is not None:
            changes[field] = change(part, getattr(part, field))
        return replace(part, **changes) if changes else part
    if isinstance(part, tuple):
        made = tuple(rewritten(one, owner, field, change) for one in part)
        return part if all(a is b for a, b in zip(made, part, strict=True)) else made
    return part


def scene_edit(owner: str, field: str, edit: Edit) -> Callable[[Scene], Scene]:
    """Return a change of a field of all parts of a type; a scene that it would make invalid stays as it is."""

    def changed(scene: Scene) -> Scene:
        every = [value for _, value in leaves(scene, owner, field)]
        numbers = iter(range(len(every)))

        def edited(part: Any, value: Any) -> Any:
            number = next(numbers)
            return edit(
                Place(value=value, part=part, every=every, number=number, scene=scene)
            )

        try:
            return rewritten(scene, owner, field, edited)
        except (GaugeError, TypeError, ValueError, KeyError, IndexError):
            return scene

    return changed


def _unit(values: np.ndarray) -> tuple[float, ...]:
    return tuple((values / np.linalg.norm(values)).tolist())


def _is_direction(field: str) -> bool:
    return field == "axis"


def _mapped(value: Any, function: Callable[[np.ndarray], Any]) -> Any:
    """Return a number, a vector, or a tree of vectors with a function applied to each."""
    if isinstance(value, tuple) and value and isinstance(value[0], tuple):
        return tuple(_mapped(one, function) for one in value)
    if isinstance(value, tuple):
        return tuple(
            np.asarray(function(np.array(value, dtype=float)), dtype=float).tolist()
        )
    return float(function(np.array(value, dtype=float)))


OFFSETS = {
    "_m": (2e-3, 1e-2),
    "_kg": (0.02, 0.1),
    "_m_per_s": (0.02, 0.2),
    "_rad_per_s": (0.05, 0.5),
    "_m_per_s2": (0.02, 0.2),
    "_s": (0.01, 0.05),
    "_rad": (0.002, 0.01),
}
"""Small and large additions to a field, by the end of its name."""


def _offset(field: str, value: Any, large: bool) -> float:
    for end in sorted(OFFSETS, key=len, reverse=True):
        if field.endswith(end) and "_per_" not in field.removesuffix(end):
            return OFFSETS[end][large]
    largest = (
        float(np.abs(np.array(value, dtype=float)).max())
        if not isinstance(value, tuple)
        else 1.0
    )
    return (0.05, 0.2)[large] * (largest or 1.0)


def _tilted(value: np.ndarray, degrees: float) -> np.ndarray:
    across = np.cross(value, [0.3, -0.5, 0.8])
    return Rotation.from_rotvec(
        np.radians(degrees) * across / np.linalg.norm(across)
    ).apply(value)


def _turned_quaternion(value: Any, turn: Rotation) -> tuple[float, ...]:
    return tuple(
        (turn * Rotation.from_quat(value, scalar_first=True))
        .as_quat(scalar_first=True)
        .tolist()
    )


LEAN = Rotation.from_rotvec(np.radians(5.0) * np.array([0.6, 0.0, 0.8]))


def _off(field: str, value: Any, strength: float) -> Any:
    """Return a value that is wrong in a way that suits it: scaled, tilted or turned."""
    if field == "quaternion":
        return _turned_quaternion(
            value,
            Rotation.from_rotvec(
                LEAN.as_rotvec() * (2.0 if strength in (0.5, 1.6) else 1.0)
            ),
        )
    if _is_direction(field):
        return vector(
            _tilted(np.array(value), 4.0 if strength in (0.8, 1.25) else 15.0)
        )
    if field == "poisson_ratio":
        return min(strength * value, 0.45)
    return _mapped(value, lambda x: strength * x)


def _frame_of(part: Any, scene: Scene) -> Rotation:
    """Return the orientation of the body that a part belongs to."""
    name = (
        getattr(part, "name", None)
        or getattr(part, "body", None)
        or getattr(part, "first", None)
    )
    pose = next(
        (one.pose for one in (*scene.bodies, *scene.deformables) if one.name == name),
        None,
    )
    return pose.rotation if pose is not None else Rotation.identity()


STARTS = ("quaternion", "linear_velocity_m_per_s", "angular_velocity_rad_per_s")
"""Fields that only the start of a motion depends on."""


def _off_where(
    field: str, strength: float, holds: Callable[[Place], bool] = lambda at: True
) -> Edit:
    """Return an edit to a value that is off, where something holds of its place."""
    return lambda at: _off(field, at.value, strength) if holds(at) else at.value


def _form(field: str, example: Any) -> str:
    """Return the form of a field: `turn`, `direction`, `number`, `vector`, or `tree` of vectors."""
    if field == "quaternion":
        return "turn"
    if _is_direction(field):
        return "direction"
    if not isinstance(example, tuple):
        return "number"
    return "tree" if isinstance(example[0], tuple) else "vector"


def field_variants(  # noqa: C901  # one branch for each kind of fault
    owner: str, field: str, example: Any
) -> Iterator[Variant]:
    """Yield the faults of a field.

    Args:
        owner: Type of the parts that have it.
        field: Its name.
        example: One of its values.
    """
    form = _form(field, example)
    is_angle = form in ("turn", "direction")
    kind, strengths = "scale", (0.5, 0.8, 1.25, 1.6)
    if is_angle:
        kind, strengths = "offset", (0.5, 0.8)
    for strength in strengths:
        yield Variant(kind, f"{strength:g}", _off_where(field, strength))
    if form == "turn":
        yield from _of_turns()
    elif form == "direction":
        yield from (*_swaps(len(example)), *_frames())
    elif form == "number":
        yield from _of_numbers(owner, field)
    elif form == "vector":
        yield from _of_vectors(field, len(example))
    else:
        yield from _of_trees()
    yield Variant("stale", "first-for-all", lambda at: at.every[0])
    for bits in (2, 4) if not is_angle else ():
        yield Variant(
            "rounded",
            f"{bits}-bits",
            lambda at, bits=bits: _mapped(at.value, lambda x: rounded(x, bits)),
        )
    if form not in ("turn", "tree"):
        yield Variant("mixed", "half", lambda at: _mixed(field, at.value, at.every))
    yield from _of_some(field)
    yield from _of_times(field)
    if form != "tree":
        yield Variant(
            "neighbour", "next", lambda at: at.every[(at.number + 1) % len(at.every)]
        )
        yield Variant("neighbour", "before", lambda at: at.every[at.number - 1])
    for power in (0.7, 1.4) if form in ("number", "vector") else ():
        yield Variant("power", f"{power:g}", _bent(owner, field, power))
    sides = _sides(owner, is_vector=form in ("direction", "vector"))
    for name, holds in sides.items():
        for strength in (0.5, 0.8):
            edit = _off_where(field, strength, holds)
            yield Variant("side", f"{name}-{strength:g}", edit)


def _bent(owner: str, field: str, power: float) -> Edit:
    """Return an edit to a power of a value over a typical one."""

    def bent(at: Place) -> Any:
        typical = np.abs(_typical(owner, field)).max()
        return _mapped(
            at.value, lambda x: np.sign(x) * typical * (np.abs(x) / typical) ** power
        )

    return bent


def _of_turns() -> Iterator[Variant]:
    def inverse(at: Place) -> Any:
        w, x, y, z = at.value
        return w, -x, -y, -z

    yield Variant("swap", "xyzw", lambda at: (at.value[3], *at.value[:3]))
    yield Variant("frame", "inverse", inverse)
    yield Variant("drop", "identity", lambda at: (1.0, 0.0, 0.0, 0.0))


def _of_trees() -> Iterator[Variant]:
    def swapped(at: Place) -> Any:
        return tuple(tuple((y, x, z) for x, y, z in piece) for piece in at.value)

    def moved(at: Place) -> Any:
        return _mapped(at.value, lambda x: [x[0] + 3e-3, *x[1:]])

    yield Variant("offset", "x", moved)
    yield Variant("drop", "last", lambda at: at.value[:-1] or at.value)
    yield Variant("drop", "but-first", lambda at: at.value[:1])
    yield Variant("swap", "x-y", swapped)


def _of_numbers(owner: str, field: str) -> Iterator[Variant]:
    def swapped(at: Place) -> Any:
        is_end = at.number in (0, len(at.every) - 1)
        return at.every[-1 - at.number] if is_end else at.value

    def dropped(at: Place) -> Any:
        is_optional = field in ("inertia_kg_m2", "torque_limit_n_m")
        return None if is_optional else 1e-3 * at.value

    def at_least(at: Place) -> Any:
        return max(at.value, _typical(owner, field)) if at.value else at.value

    for large in (False, True):
        yield Variant(
            "offset",
            f"{large}",
            lambda at, large=large: at.value + _offset(field, at.value, large),
        )
    yield Variant("swap", "first-last", swapped)
    yield Variant("drop", "none", dropped)
    yield Variant("saturate", "most", lambda at: min(at.value, _typical(owner, field)))
    yield Variant("saturate", "least", at_least)


def _swaps(size: int) -> Iterator[Variant]:
    for one, other in ((0, 1), (1, 2), (0, 2)):
        if other < size:

            def swapped(at: Place, one: int = one, other: int = other) -> Any:
                values = list(at.value)
                values[one], values[other] = values[other], values[one]
                return tuple(values)

            yield Variant("swap", f"{one}-{other}", swapped)


def _frames() -> Iterator[Variant]:
    for name, inverse in (("body", False), ("world", True)):

        def turned(at: Place, inverse: bool = inverse) -> Any:
            turn = _frame_of(at.part, at.scene)
            return vector(turn.apply(at.value, inverse=inverse))

        yield Variant("frame", name, turned)


def _of_vectors(field: str, size: int) -> Iterator[Variant]:
    is_size = "size" in field or "radii" in field
    for large in (False, True):
        for axis in range(size):

            def moved(at: Place, axis: int = axis, large: bool = large) -> Any:
                values = list(at.value)
                values[axis] += _offset(field, at.value, large)
                return tuple(values)

            yield Variant("offset", f"{axis}-{large}", moved)
    yield from _swaps(size)
    least, cap = (0.05 if is_size else 0.0), 0.08
    if field.endswith("_rad_per_s"):
        cap = 2.5
    elif field.endswith("_m_per_s"):
        cap = 0.5
    yield Variant("drop", "zero", lambda at: (least,) * len(at.value))
    yield Variant(
        "saturate", "most", lambda at: tuple(np.clip(at.value, -cap, cap).tolist())
    )
    if not is_size:
        yield from _frames()


def _of_some(field: str) -> Iterator[Variant]:
    """Yield faults of some parts: of those of many, or of one."""
    for count in (2, 4):
        for strength in (0.5, 1.25):
            edit = _off_where(
                field, strength, lambda at, count=count: len(at.scene.bodies) > count
            )
            yield Variant("crowd", f"above-{count}-bodies-{strength:g}", edit)
    for number, name in ((0, "first"), (1, "second"), (2, "third"), (-1, "last")):

        def is_one(at: Place, number: int = number) -> bool:
            count = len(at.every)
            return count > 1 and at.number in (number, number + count)

        for strength in (0.5, 1.25):
            edit = _off_where(field, strength, is_one)
            yield Variant("kth", f"{name}-{strength:g}", edit)


def _of_times(field: str) -> Iterator[Variant]:
    """Yield faults that depend on time and speed, and on place or name."""
    if field not in STARTS:
        for condition in (
            *("after-1s", "after-2s"),
            *("above-3m/s", "above-8m/s", "above-12m/s", "below-0.1m/s"),
            "above-30rad/s",
        ):
            yield Variant("threshold", condition, _off_where(field, 0.5), condition)
    for strength in (0.5, 1.6):
        if field not in STARTS:
            for kind, condition in (
                *(("delay", "before-0.2s"), ("delay", "before-0.6s")),
                *(("alternates", "odd-0.1s"), ("alternates", "odd-0.5s")),
            ):
                edit = _off_where(field, strength)
                yield Variant(kind, f"{condition}-{strength:g}", edit, condition)
        for axis, name in enumerate("xyz"):
            edit = _off_where(
                field,
                strength,
                lambda at, axis=axis: _place_of(at.part, at.scene)[axis] < 0.0,
            )
            yield Variant("place", f"{name}-negative-{strength:g}", edit)
        edit = _off_where(field, strength, lambda at: _is_late_name(at.part, at.scene))
        yield Variant("names", f"late-{strength:g}", edit)


SHAPES = (
    *("Box", "Sphere", "Cylinder", "ConvexUnion", "Compound", "Capsule", "Ellipsoid"),
)


def _sides(owner: str, *, is_vector: bool) -> dict[str, Callable[[Place], bool]]:
    """Return what halves of the parts of a type, or of their vectors, have in common."""

    def motions(at: Place) -> set[Motion | None]:
        return {_motion(at.part.first, at.scene), _motion(at.part.second, at.scene)}

    def is_hinged(at: Place) -> bool:
        seconds = {hinge.second for hinge in at.scene.body_hinges}
        return at.part.name in {*at.scene.hung, *seconds}

    if owner in SHAPES:
        return {
            motion.value: lambda at, motion=motion: (
                _motion_of_shape(at.part, at.scene) is motion
            )
            for motion in Motion
        }
    if owner == "Contact":
        still = (Motion.FIXED, Motion.KINEMATIC)
        return {
            "fixed-first": lambda at: _motion(at.part.first, at.scene) in still,
            "dynamic-pair": lambda at: motions(at) == {Motion.DYNAMIC},
            "driven": lambda at: Motion.KINEMATIC in motions(at),
            "deformable": lambda at: None in motions(at),
        }
    if is_vector:
        return {
            "negative": lambda at: min(at.value) < 0.0,
            "positive": lambda at: max(at.value) > 0.0 and min(at.value) >= 0.0,
        }
    if owner == "RigidBody":
        return {"hinged": is_hinged, "free": lambda at: not is_hinged(at)}
    return {}


def _name_of(part: Any) -> str:
    """Return the name of the body that a part belongs to; empty for a part of none."""
    for attribute in ("name", "body", "deformable", "first"):
        found = getattr(part, attribute, "")
        if isinstance(found, str) and found:
            return found
        if isinstance(found, tuple) and found:
            return str(found[0])
    return ""


def _place_of(part: Any, scene: Scene) -> Any:
    """Return the position of the body that a part belongs to [m]; the origin for a part of none."""
    if hasattr(part, "position_m"):
        return part.position_m
    named = _name_of(part)
    for one in (*scene.bodies, *scene.deformables):
        if one.name == named or getattr(one, "shape", None) is part:
            return one.pose.position_m
    return (0.0, 0.0, 0.0)


def _is_late_name(part: Any, scene: Scene) -> bool:
    """Return whether a part belongs to a body whose name is in the second half of the alphabetical order."""
    names = sorted(one.name for one in (*scene.bodies, *scene.deformables))
    named = _name_of(part)
    for one in (*scene.bodies, *scene.deformables):
        if one.pose is part or getattr(one, "shape", None) is part:
            named = one.name
    return named in names and names.index(named) >= len(names) / 2


def rounded(values: np.ndarray, bits: int) -> np.ndarray:
    """Return values with some binary digits behind the first."""
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.round(np.ldexp(mantissa, bits + 1)), exponent - bits - 1)


def _mixed(field: str, value: Any, every: list[Any]) -> Any:
    """Return the mean of a value and of the mean of all values of the field."""
    middle = np.mean(np.array(every, dtype=float), axis=0)
    mixed = 0.5 * (np.array(value, dtype=float) + middle)
    if _is_direction(field):
        return _unit(mixed)
    return tuple(mixed.tolist()) if isinstance(value, tuple) else float(mixed)


def _motion(group: tuple[str, ...], scene: Scene) -> Motion | None:
    """Return how the first body of a group moves; None for a deformable one."""
    return next((one.motion for one in scene.bodies if one.name == group[0]), None)


def _motion_of_shape(shape: Any, scene: Scene) -> Motion | None:
    for one in scene.bodies:
        parts = (part.shape for part in getattr(one.shape, "parts", ()))
        if one.shape is shape or any(part is shape for part in parts):
            return one.motion
    return None


@cache
def _typical(owner: str, field: str) -> float:
    """Return the median of a field in the suite's scenes, or of a plausible value where none has it."""
    from gauge_envs.experiments.resolve import load_experiment
    from gauge_envs.experiments.variants import variants

    values = [
        value
        for variant in variants()
        for _, value in leaves(load_experiment(variant.name).scene, owner, field)
        if value
    ]
    return float(np.median(np.abs(values))) if values else 0.02


# --- conditions ------------------------------------------------------------------------------------------------------


def _holds(condition: str, data: mujoco.MjData) -> bool:
    when, value = condition.split("-")
    number = float(re.match(r"[\d.]+", value).group())
    if value.endswith("rad/s"):
        return bool(np.abs(data.qvel).max(initial=0.0) > number)
    if when == "after":
        return data.time > number
    if when == "before":
        return data.time < number
    if when == "odd":
        return int(data.time / number) % 2 == 1
    speed = float(np.abs(data.qvel).max(initial=0.0))
    return speed > number if when == "above" else speed < number


def switched(  # noqa: C901
    condition: str, edit: Callable[[Scene], Scene]
) -> Callable[..., Simulation]:
    """Return a simulation of MuJoCo whose constants are those of an edited scene while a condition holds."""

    class Switched(Passed):
        def begin(self):
            model = self.inner.model
            changed = edit(self.scene)
            self._arrays = []
            if changed is self.scene or changed == self.scene:
                return
            try:
                faulty = _mujoco().build(changed, _asked(self.inner.settings)).model
            except (GaugeError, ValueError):
                return
            for name in dir(model):
                if name.startswith("_"):
                    continue
                here, there = getattr(model, name), getattr(faulty, name, None)
                are_arrays = isinstance(here, np.ndarray) and isinstance(
                    there, np.ndarray
                )
                if are_arrays and here.shape == there.shape and (here != there).any():
                    self._arrays.append((here, here.copy(), there.copy()))
            here, there = model.opt.gravity, faulty.opt.gravity
            if not np.array_equal(here, there):
                self._arrays.append((here, here.copy(), there.copy()))

        def advance(self, seconds):
            if self._arrays:
                is_on = _holds(condition, self.inner.data)
                for array, right, wrong in self._arrays:
                    array[...] = wrong if is_on else right
            super().advance(seconds)

    return Switched


def _asked(settings: Mapping[str, Any]) -> dict[str, Any]:
    return {"preset": settings["preset"]}


def _mujoco() -> Any:
    """Return MuJoCo's backend."""
    from gauge_envs.backends import backend

    return backend("mujoco")
