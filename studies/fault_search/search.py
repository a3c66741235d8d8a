"""Change each number that an engine reads from a scene, or reports, and see which check notices.

    python studies/fault_search/search.py --backend mujoco --out studies/fault_search/mujoco.csv

A mutant multiplies one quantity by 1.05, reverses its sign, drops it, swaps its first two axes, limits it, or takes the
value of the object before. It is *caught* by the first check that fails on it and not on the engine, and *named* if the
title or the diagnosis of that check has a word for the quantity. Rows that the file has are not run again.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends import Backend, Simulation, backend
from gauge_envs.scene import Motion, Pose, RigidBody, Scene
from gauge_envs.tools.conformance import checks, run_checks

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from mutations import Fault, Mutant, Passed

Array = NDArray[np.float64]
Key = tuple[str, str]
"""Kind of an object of a scene, as `RigidBody dynamic`, and a field of it."""

FACTOR, LIMIT_SHARE = 1.05, 0.7
MUTATORS = ("x 1.05", "reversed", "dropped", "swapped", "limited", "of another")
SKIPPED = ("duration_s", "drivers", "markers")
"""Fields of a scene that the environment reads, and not the engine."""
WORDS: Mapping[str, Sequence[str]] = {
    "mass": ("mass", "inertia"),
    "inertia": ("inertia",),
    "friction": ("friction",),
    "restitution": ("restitution", "rebound"),
    "velocity": ("velocity", "speed"),
    "velocities": ("velocity", "speed"),
    "position": ("position", "place", "pose", "jump", "stay", "move"),
    "quaternion": (
        "orientation",
        "quaternion",
        "turn",
        "rotat",
        "spin",
        "leans",
        "frame",
    ),
    "size": ("size", "edge", "thick", "inertia", "radius"),
    "radius": ("radius", "size"),
    "length": ("length", "long", "short"),
    "pieces": ("solid", "union", "convex", "centre", "size"),
    "parts": ("compound", "part"),
    "anchor": ("anchor", "hinge", "radius"),
    "axis": ("axis", "plane of rotation"),
    "gravity": ("gravity",),
    "acceleration": ("acceleration",),
    "force": ("force", "wrench"),
    "torque": ("torque", "wrench", "inertia"),
    "seconds": ("time", "step"),
    "stiffness": ("stiff", "stretch", "shear", "bend"),
    "modulus": ("stiff", "modulus", "young"),
    "poisson": ("poisson", "widen", "thinner"),
    "density": ("density", "mass", "weight"),
    "thickness": ("thick",),
    "coefficient": ("air", "drag", "lift"),
    "wind": ("wind", "air"),
    "depth": ("region", "attach", "clamp", "pinned"),
    "nodes": ("node",),
}


# --- numbers of scenes -----------------------------------------------------------------------------------------------


def kind_of(owner: Any) -> str:
    """Return the kind of an object of a scene; rigid bodies differ by how they move."""
    name = type(owner).__name__
    return f"{name} {owner.motion.value}" if isinstance(owner, RigidBody) else name


def mapped(value: Any, change: Callable[[Key, Any], Any], *, within: str = "") -> Any:
    """Return a scene, or a part of it, with each number or vector of its objects changed."""
    if isinstance(value, tuple) and value and not is_number(value):
        return tuple(mapped(one, change, within=within) for one in value)
    if not is_dataclass(value) or isinstance(value, type):
        return value
    kind = kind_of(value)
    # A pose or a shape belongs to the body that has it.
    kind = (
        f"{within} {kind}"
        if within and kind in ("Pose", "Box", "Sphere", "Cylinder", "ConvexUnion")
        else kind
    )
    changed = {}
    for one in fields(value):
        if not one.init or one.name in SKIPPED:
            continue
        old = getattr(value, one.name)
        new = (
            change((kind, one.name), old)
            if is_number(old)
            else mapped(old, change, within=kind)
        )
        if new is not old:
            changed[one.name] = new
    return replace(value, **changed) if changed else value


def is_number(value: Any) -> bool:
    """Return whether a value is a number, or a tuple of numbers or of points."""
    if isinstance(value, tuple) and value:
        return all(is_number(one) for one in value)
    return isinstance(value, float | int) and not isinstance(value, bool)


class Recorder(Mutant):
    """A healthy engine that keeps the scenes which it is asked to build."""

    def __init__(self, engine: Backend) -> None:
        super().__init__(engine, Fault(what="", caught_by="", says=""))
        self.scenes: list[Scene] = []

    def build(
        self, scene: Scene, settings: Mapping[str, Any] | None = None
    ) -> Simulation:
        """Keep and build a scene."""
        self.scenes.append(scene)
        return super().build(scene, settings)


def scenes_of_checks(engine: Backend) -> tuple[dict[str, list[Scene]], set[str]]:
    """Return the scenes that each check builds, by its id, and the checks that the engine itself fails."""
    scenes, own = {}, set()
    for one in checks():
        recorder = Recorder(engine)
        (result,) = run_checks(recorder, only=[one.id])
        scenes[one.id] = recorder.scenes
        own |= {one.id} if result.is_bad else set()
    return scenes, own


def known_numbers(scenes: Iterable[Scene]) -> dict[Key, float]:
    """Return the quantities of scenes, with their largest size."""
    largest: dict[Key, float] = {}

    def note(key: Key, value: Any) -> Any:
        flat = np.abs(np.array(list(flattened(value)), dtype=float))
        largest[key] = max(largest.get(key, 0.0), float(flat.max(initial=0.0)))
        return value

    for scene in scenes:
        mapped(scene, note)
    return largest


def flattened(value: Any) -> Iterator[float]:
    """Yield the numbers of a value."""
    if isinstance(value, tuple):
        for one in value:
            yield from flattened(one)
    else:
        yield float(value)


def each(value: Any, change: Callable[[float], float]) -> Any:
    """Return a value with each of its numbers changed."""
    return (
        tuple(each(one, change) for one in value)
        if isinstance(value, tuple)
        else change(value)
    )


def mutation(key: Key, how: str, largest: float) -> Callable[[Scene], Scene]:
    """Return the change of a scene that a mutant makes."""

    def change(scene: Scene) -> Scene:
        before: list[Any] = []

        def changed(found: Key, value: Any) -> Any:
            if found != key:
                return value
            before.append(value)
            if how == "of another":
                return (
                    before[-2]
                    if len(before) > 1 and np.shape(before[-2]) == np.shape(value)
                    else value
                )
            if how == "swapped":
                return (
                    (value[1], value[0], *value[2:])
                    if np.ndim(value) == 1 and len(value) > 1
                    else value
                )
            limit = LIMIT_SHARE * largest
            numbers: dict[str, Callable[[float], float]] = {
                "x 1.05": lambda one: FACTOR * one,
                "reversed": lambda one: -one,
                "dropped": lambda one: 0.0,
                "limited": lambda one: float(np.clip(one, -limit, limit)),
            }
            if how == "dropped" and key[1] == "quaternion":
                return (1.0, 0.0, 0.0, 0.0)
            return each(value, numbers[how])

        return mapped(scene, changed)  # type: ignore[no-any-return]

    return change


# --- numbers of calls ------------------------------------------------------------------------------------------------


def altered(how: str, value: Array, before: Array) -> Array:
    """Return what a mutant makes of a vector of a call or a report."""
    if how == "swapped":
        return np.concatenate([value[1::-1], value[2:]])
    changes = {
        "x 1.05": FACTOR * value,
        "reversed": -value,
        "dropped": 0.0 * value,
        "of another": before,
    }
    return changes[how]


PARTS = {
    "drive position_m": ("drive", slice(0, 3)),
    "drive velocity": ("drive", slice(7, 10)),
    "drive angular_velocity": ("drive", slice(10, 13)),
    "drive acceleration": ("drive", slice(13, 16)),
    "drive angular_acceleration": ("drive", slice(16, 19)),
    "wrench force": ("wrench", slice(0, 3)),
    "wrench torque": ("wrench", slice(3, 6)),
    "state position_m": ("state", slice(0, 3)),
    "state velocity": ("state", slice(7, 10)),
    "state angular_velocity": ("state", slice(10, 13)),
}


def calling(part: str, how: str) -> type[Passed]:
    """Return a simulation that changes one vector of its calls or reports."""
    of, columns = PARTS[part]

    class Changed(Passed):
        def __init__(self, inner: Simulation, scene: Scene) -> None:
            super().__init__(inner, scene)
            self._before: dict[str, Array] = {}

        def _change(self, name: str, values: Array) -> Array:
            now = values[columns].copy()
            values[columns] = altered(how, now, self._before.get(name, now))
            self._before[name] = now
            return values

        def drive(
            self, body: str, pose: Pose, velocity: Array, acceleration: Array
        ) -> None:
            if of == "drive":
                row = np.concatenate(
                    [pose.position_m, pose.quaternion, velocity, acceleration]
                )
                row = self._change(body, row)
                x, y, z = (float(one) for one in row[:3])
                pose, velocity, acceleration = (
                    replace(pose, position_m=(x, y, z)),
                    row[7:13],
                    row[13:],
                )
            super().drive(body, pose, velocity, acceleration)

        def apply_wrench(self, body: str, wrench: Array) -> None:
            changed = (
                self._change(body, np.array(wrench, dtype=float))
                if of == "wrench"
                else wrench
            )
            super().apply_wrench(body, changed)

        def body_states(self, names: Sequence[str]) -> Array:
            states = super().body_states(names)
            if of == "state":
                for row, name in zip(states, names, strict=True):
                    if self.scene.body(name).motion is Motion.DYNAMIC:
                        self._change(name, row)
            return states

    return Changed


# --- the search ------------------------------------------------------------------------------------------------------


def mutants(scenes: Sequence[Scene]) -> Iterator[tuple[str, str, Fault]]:
    """Yield quantity, change and fault of each mutant that is no equivalent."""
    for key, largest in known_numbers(scenes).items():
        for how in MUTATORS:
            if not is_equivalent(key, how):
                change = mutation(key, how, largest)
                yield (
                    " ".join(key),
                    how,
                    Fault(what="", caught_by="", says="", scene=change),
                )
    for part in PARTS:
        for how in MUTATORS:
            if how != "limited":
                yield (
                    part,
                    how,
                    Fault(
                        what="", caught_by="", says="", simulation=calling(part, how)
                    ),
                )


def is_equivalent(key: Key, how: str) -> bool:
    """Return whether a mutant is the engine itself, by the definition of a scene.

    Fixed and driven bodies have no use for a mass, and a multiple of a quaternion is the same rotation.
    """
    kind, name = key
    is_placed = kind.startswith(("RigidBody fixed", "RigidBody kinematic"))
    return (is_placed and name in ("mass_kg", "inertia_kg_m2")) or (
        name == "quaternion" and how in ("x 1.05", "reversed")
    )


def is_named(quantity: str, text: str) -> bool:
    """Return whether a text has a word for a quantity."""
    words = [
        word
        for part, found in WORDS.items()
        if part in quantity.lower()
        for word in found
    ]
    return any(word in text.lower() for word in words)


def seen_by(fault: Fault, scenes: Mapping[str, Sequence[Scene]]) -> list[str]:
    """Return the checks whose scenes a mutant changes, in their order; the others do what the engine does."""
    if fault.simulation is not Passed:
        return list(scenes)
    return [
        name
        for name, built in scenes.items()
        if any(differs(fault, scene) for scene in built)
    ]


def first(mutant: Mutant, ids: Iterable[str], own: set[str]) -> tuple[str, str]:
    """Return the first check that fails on a mutant alone, and its words; empty texts if none does."""
    for result in run_checks(mutant, only=list(ids)):
        if result.is_bad and result.check not in own:
            return result.check, f"{result.of.title}; {result.diagnosis}"
    return "", ""


def main() -> int:
    """Run the mutants that the file lacks."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--backend", default="mujoco")
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    engine = backend(arguments.backend)
    known: set[tuple[str, str]] = set()
    if arguments.out.exists():
        with arguments.out.open(encoding="utf-8", newline="") as stream:
            known = {(row["quantity"], row["change"]) for row in csv.DictReader(stream)}
    scenes, own = scenes_of_checks(engine)
    print(f"{engine.name} itself fails {', '.join(sorted(own)) or 'none'}", flush=True)
    with arguments.out.open("a", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        if not known:
            writer.writerow(("quantity", "change", "caught by", "named", "words"))
        for quantity, how, fault in mutants(
            [scene for built in scenes.values() for scene in built]
        ):
            if (quantity, how) in known or not (ids := seen_by(fault, scenes)):
                continue
            check, text = first(Mutant(engine, fault), ids, own)
            writer.writerow(
                (
                    quantity,
                    how,
                    check,
                    "yes" if check and is_named(quantity, text) else "no",
                    text[:160],
                )
            )
            stream.flush()
            print(f"{quantity}, {how}: {check or 'SURVIVES'}", flush=True)
    return 0


def differs(fault: Fault, scene: Scene) -> bool:
    """Return whether a fault changes a scene; a scene that cannot be is a change."""
    try:
        return bool(fault.scene(scene) != scene)
    except Exception:  # Scenes check their numbers.
        return True


if __name__ == "__main__":
    sys.exit(main())
