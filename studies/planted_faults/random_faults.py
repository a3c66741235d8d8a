"""Rates of generated faults that the checks catch and name, on a random sample.

    python -m studies.planted_faults.random_faults draw --engine rapier --count 150
    python -m studies.planted_faults.random_faults checks --engine rapier      runs checks on faults without a result
    python -m studies.planted_faults.random_faults rates                       the table of the page

`random_faults.csv` has a row for each fault and engine. A class (`tests/mutations/generated.py`) is drawn first, then
one of its faults that changes a call, or MuJoCo's model of a scene of the suite. Ids that may show it run with and
without it in the engine; a fault counts where what the reference compares moves by more than its uncertainty. The set
is `held out` or `seen`, by the digest of the class. Rows without an id are those that checks were written for. The
first check that fails on the fault, but not on the healthy engine, is kept. A fault is *named* when the diagnosis has a
word that was stated for its quantity.
"""

from __future__ import annotations

import argparse
import csv
import multiprocessing
import re
import resource
import signal
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from gauge_envs.backends import Backend, backend
from gauge_envs.backends.base import scene_support
from gauge_envs.errors import GaugeError
from gauge_envs.evaluation.power import reference_power
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.experiments.variants import variants
from gauge_envs.scene import (
    Box,
    Capsule,
    Compound,
    Motion,
    Part,
    Pose,
    RigidBody,
    Scene,
)
from gauge_envs.scene.geometry import Ellipsoid
from gauge_envs.tools.conformance import checks, run_checks
from scripts import build_power

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from mutations import FAILS_ITSELF, Mutant
from mutations.episodes import PLACES, Again, OneOfMany
from mutations.generated import Generated, generated
from mutations.generated_fields import leaves

TABLE = Path(__file__).with_name("random_faults.csv")
COLUMNS = (
    "fault",
    "engine",
    "set",
    "part",
    "caught_by",
    "named",
    "diagnosis",
    "cpu_s",
    "change_u",
    "id",
)
SEED = 58
MOST_FRAMES = {"rigid": 120, "deformable": 45, "batches": 60}
"""Frames of an id that are run: a fault shows within 1.5 to 4 s, or is not counted."""
SOFT = re.compile(r"^(cloth|air|foam|rope|rod|soft)-")
"""Checks of scenes with deformable bodies."""
PARTS = ["rigid", "deformable", "batches"]
KINDS = {
    "Cloth": "cloth",
    "Air": "air",
    "SoftBody": "foam",
    "Rope": "rope",
    "Rod": "rod",
}
"""First word of the checks of the only scenes that have a part with the field that a fault changes."""


Rows = dict[tuple[str, str], dict[str, Any]]
"""Rows of the table by fault and engine."""


def _rows() -> Rows:
    with TABLE.open(encoding="utf-8") as text:
        return {(row["fault"], row["engine"]): row for row in csv.DictReader(text)}


def _write(rows: Rows) -> None:
    with TABLE.open("w", newline="", encoding="utf-8") as text:
        writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows.values())


def _compound() -> Scene:
    """Return a scene with the parts of the contract that no id of the suite has."""
    parts = (
        Part(
            shape=Box(size_m=(0.05, 0.03, 0.02)), pose=Pose(position_m=(0.03, 0.0, 0.0))
        ),
        Part(
            shape=Capsule(radius_m=0.01, length_m=0.04),
            pose=Pose(position_m=(0.0, 0.02, 0.01)),
        ),
        Part(
            shape=Ellipsoid(radii_m=(0.02, 0.01, 0.015)),
            pose=Pose(position_m=(0.0, 0.0, 0.03)),
        ),
    )
    one = RigidBody(
        name="one",
        shape=Compound(parts=parts),
        motion=Motion.DYNAMIC,
        pose=Pose(position_m=(0.0, 0.0, 1.0)),
        mass_kg=0.3,
    )
    return Scene(bodies=(one,), duration_s=0.5)


def _scenes() -> dict[str, Scene]:
    return {one.name: load_experiment(one.name).scene for one in variants()} | {
        "": _compound()
    }


def _changes_a_model(one: Generated, scenes: dict[str, Scene]) -> bool:
    """Return whether a fault can have an effect: it changes a call, or a field of a scene that MuJoCo's model shows."""
    if one.quantity[0].islower() or one.fault.simulation.__name__ not in (
        "Passed",
        "Switched",
    ):
        return True
    if not _is_read(one.quantity):
        return False
    return one.kind == "threshold" or any(
        one.fault.scene(scene) != scene for scene in scenes.values()
    )


@cache
def _is_read(quantity: str) -> bool:
    """Return whether a wrong value of a field changes MuJoCo's model of any scene of the suite."""
    faults = _faults()
    wrong = faults.get(f"{quantity}:scale:0.5") or faults.get(f"{quantity}:offset:0.5")
    if wrong is None:
        return True
    for scene in _scenes_of_suite().values():
        changed = wrong.fault.scene(scene)
        if changed != scene and _model(changed) != _model(scene):
            return True
    return False


_faults = cache(generated)
_scenes_of_suite = cache(_scenes)


def _model(scene: Scene) -> dict[str, Any]:
    """Return the constants of MuJoCo's model of a scene as bytes; None where it builds none."""
    try:
        model = backend("mujoco").build(scene).model  # type: ignore[attr-defined]
    except (GaugeError, ValueError):
        return {}
    names = [name for name in dir(model) if not name.startswith("_")]
    values = {name: getattr(model, name) for name in names}
    arrays = {
        name: value.tobytes()
        for name, value in values.items()
        if isinstance(value, np.ndarray)
    }
    return arrays | {"gravity": model.opt.gravity.tobytes()}


def draw(engine: str, part: str, count: int) -> None:
    """Draw faults that an engine can have until a number of them counts, and write a row for each.

    Classes come in random order, each with one random fault; then classes have a second fault, and so on. No fault is
    drawn that any row has.

    Args:
        engine: Name of the backend.
        part: `rigid` or `deformable`.
        count: Faults that count, with those that have rows.
    """
    rows = _rows()
    drawn = {fault for fault, _ in rows}
    classes: dict[tuple[str, str], list[Generated]] = {}
    for one in _faults().values():
        if one.part == part and one.fault.engine in ("", engine):
            classes.setdefault((one.quantity, one.kind), []).append(one)
    draw = np.random.default_rng([SEED, len(rows)])
    orders = [draw.permutation(len(faults)) for faults in classes.values()]
    for turn in range(max(len(order) for order in orders)):
        for number in draw.permutation(len(classes)):
            if turn >= len(orders[number]):
                continue
            one = list(classes.values())[number][orders[number][turn]]
            if one.id in drawn or not _changes_a_model(one, _scenes_of_suite()):
                continue
            of_part = [row for row in rows.values() if row["part"] == part]
            if (
                sum(row["engine"] == engine and _counts(row) for row in of_part)
                >= count
            ):
                return
            change_u, id = _largest_change(one, engine)
            row = {"fault": one.id, "engine": engine, "part": part}
            row |= {"set": "held out" if one.is_held_out else "seen"}
            row |= {"change_u": f"{change_u:.3g}", "id": id}
            rows[one.id, engine] = row
            _write(rows)
            print(one.id, row["change_u"], id, flush=True)


def _counts(row: dict[str, Any]) -> bool:
    """Return whether a fault changes an id by more than its uncertainty."""
    return float(row["change_u"] or 0.0) > 1.0


def _wanted(one: Generated, name: str) -> bool:
    """Return whether a check can show a fault: scenes without the parts that it changes are left out."""
    if one.part == "batches":
        return name.startswith("worlds-")
    kind = KINDS.get(one.quantity.split(".")[0])
    if kind is not None:
        return name.startswith(f"{kind}-") or (kind == "cloth" and name[:4] == "air-")
    return bool(SOFT.search(name)) == one.is_deformable


def _first_failure(
    one: Generated, engine: str, names: list[str], healthy: dict[str, Any]
) -> tuple[str, str]:
    """Return the first check that fails on a fault and its diagnosis; empty without one.

    It runs in another process, since some faults let the engine crash.
    """

    def run(found: Any) -> None:
        mutant = Mutant(backend(engine), one.fault)
        for result in run_checks(mutant, only=names, eliminates=True):
            if result.is_bad and not _explains(healthy.get(result.check), result):
                found.put((result.check, " ".join(result.diagnosis.split())))
                return
        found.put(("", ""))

    context = multiprocessing.get_context("fork")
    found = context.SimpleQueue()
    process = context.Process(target=run, args=(found,))
    process.start()
    process.join()
    return ("crash", "") if process.exitcode else found.get()


def _explains(value: float | None, result: Any) -> bool:
    """Return whether the healthy engine fails as a result does."""
    if value is None or result.measured is None:
        return False
    return abs(result.measured - value) <= (result.width or 0.0)


def _children_s() -> float:
    """Return the CPU time of all processes that ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run_sample(engine: str) -> None:
    """Run the checks on each fault that counts, that an engine can have, and that has no result."""
    rows = _rows()
    healthy = {
        one.check: one.measured
        for one in run_checks(engine, only=[*FAILS_ITSELF[engine]])
    }
    every = [one.id for one in checks()]
    for mine in rows.values():
        if mine["engine"] != engine or mine.get("cpu_s") or not _counts(mine):
            continue
        one = _faults()[mine["fault"]]
        names = [name for name in every if _wanted(one, name)]
        before_s = _children_s()
        check, diagnosis = _first_failure(one, engine, names, healthy)
        is_named = re.search(one.fault.says, diagnosis, re.IGNORECASE) is not None
        mine |= {"caught_by": check, "named": int(is_named) if check else ""}
        mine |= {
            "diagnosis": diagnosis[:600],
            "cpu_s": f"{_children_s() - before_s:.1f}",
        }
        _write({key: found for key, found in rows.items() if found.get("set")})
        print(one.id, "|", check or "-", "|", diagnosis[:80], flush=True)


# --- what a fault changes in the suite ---


def _ids_of(one: Generated, engine: str, most: int) -> Iterator[str]:
    """Yield ids that may show a fault, one for each experiment, those of few bodies first."""
    chosen = backend(engine)
    seen = set()
    for name, scene in sorted(
        _scenes().items(),
        key=lambda item: (bool(item[1].deformables), len(item[1].bodies)),
    ):
        if (
            not name
            or name.split("-")[0] in seen
            or reference_band(load_experiment(name)) is None
            or not scene_support(chosen, scene)
        ):
            continue
        calls = {"drive": scene.drivers, "command": scene.motors, "wrench": ()}
        quantity = one.quantity.removeprefix("batch.")
        owner, _, field = quantity.partition(".")
        if owner in calls:
            shows = bool(calls[owner])
        elif one.part == "batches":
            is_small = not scene.deformables and len(scene.bodies) < 6
            shows = is_small and (not field or any(leaves(scene, owner, field)))
        elif one.quantity[0].islower():
            shows = bool(scene.deformables) == one.is_deformable
        elif one.kind == "threshold":
            shows = owner in repr(scene) or owner == "Scene"
        else:
            shows = one.fault.scene(scene) != scene
        if shows:
            seen.add(name.split("-")[0])
            yield name
        if len(seen) >= most:
            return


def _change_u(one: Generated, name: str, engine: str) -> float:
    """Return how far a fault moves what the reference of an id compares, over the reference's uncertainty."""
    experiment = load_experiment(name)
    band = reference_band(experiment)
    assert band is not None, name
    is_aligned = (
        band.grade.is_real and experiment.trial is None and not experiment.scene.drivers
    )
    found = reference_power(experiment, band)
    assert found is not None, name
    last_frame = min(experiment.frame_count, MOST_FRAMES[one.part])
    nominal = _nominal(name, engine, last_frame)
    mutant: Backend = Mutant(backend(engine), one.fault)
    engines = [mutant]
    if one.part == "batches":
        engines = [OneOfMany(mutant, number) for number in PLACES]
    elif one.quantity.split(".")[0] in ("reset", "restore"):
        engines = [Again(mutant, is_restored=one.quantity.startswith("restore"))]
    most = 0.0
    for each in engines:
        try:
            changed = _motion(name, each, last_frame)
        except (GaugeError, IndexError, ValueError):
            # No episode can be made of nodes that are missing or elsewhere.
            return np.inf
        off = build_power.distance(band, nominal, changed, is_aligned=is_aligned)
        most = max(most, off / found.scale)
        if most > 1.0:
            break
    return most


@cache
def _nominal(name: str, engine: str, last_frame: int) -> Any:
    """Return the episode of an id on the healthy engine."""
    return _motion(name, backend(engine), last_frame)


def _motion(name: str, engine: Any, last_frame: int) -> Any:
    """Return the episode of an id on a backend."""
    experiment = load_experiment(name)
    usual = build_power.backend_for
    build_power.backend_for = lambda *_: engine
    try:
        return build_power.motion(experiment, experiment.scene, last_frame=last_frame)
    finally:
        build_power.backend_for = usual


MOST_IDS, MOST_CPU_S = 2, 15.0
"""Ids that are tried, and processor time of each; what takes longer is not counted."""


def _stop(*_: object) -> None:
    raise TimeoutError


signal.signal(signal.SIGPROF, _stop)


def _largest_change(one: Generated, engine: str) -> tuple[float, str]:
    """Return what a fault changes in the suite over the uncertainty, and in which id; the first that is more than 1."""
    best, where = 0.0, "none"
    for id in _ids_of(one, engine, MOST_IDS):
        signal.setitimer(signal.ITIMER_PROF, MOST_CPU_S)
        try:
            size = _change_u(one, id, engine)
        except TimeoutError:
            continue
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
        if size > best or where == "none":
            best, where = size, id
        if best > 1.0:
            break
    return best, where


# --- rates ---


def wilson(found: int, count: int) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a rate."""
    z, p = 1.96, found / count
    middle = (p + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z / (1 + z**2 / count) * np.sqrt(p * (1 - p) / count + z**2 / (4 * count**2))
    return middle - half, middle + half


def _share(found: int, count: int) -> str:
    low, high = wilson(found, count)
    return f"{found} of {count}, {100 * found / count:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def rates() -> Iterator[list[str]]:
    """Yield a row for each engine, part and set: faults that count, caught, named."""
    counted = [row for row in _rows().values() if _counts(row) and row["cpu_s"]]
    for engine in ("mujoco", "rapier"):
        for part in PARTS:
            for which in ("held out", "seen"):
                wanted = (engine, part, which)
                rows = []
                for row in counted:
                    if (row["engine"], row["part"], row["set"]) == wanted:
                        rows.append(row)
                if rows:
                    caught = sum(bool(row["caught_by"]) for row in rows)
                    named = sum(row["named"] == "1" for row in rows)
                    shares = _share(caught, len(rows)), _share(named, len(rows))
                    yield [*wanted, str(len(rows)), *shares]


def main() -> None:
    """Run a part of the study."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("what", choices=("draw", "checks", "rates"))
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--part", choices=PARTS, default=PARTS[0])
    parser.add_argument("--engine", default="mujoco")
    arguments = parser.parse_args()
    if arguments.what == "draw":
        draw(arguments.engine, arguments.part, arguments.count)
    elif arguments.what == "checks":
        run_sample(arguments.engine)
    else:
        for row in rates():
            print(" | ".join(row))


if __name__ == "__main__":
    main()
