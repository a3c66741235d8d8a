"""Write `gauge_envs/tools/conformance/causes.json`: the checks that fail with each planted fault.

    python -m studies.planted_faults.causes faults.jsonl

runs the checks of rigid bodies on each fault, in some ten minutes, and appends them to a file. Faults that the file has
already are not run again. The faults of cloth also run the checks of cloth. Without a file, it counts the causes that
the report names for each fault if the table lacks it.
"""

import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from gauge_envs.backends import backend
from gauge_envs.tools.conformance import Level, Status, causes, checks, run_checks
from gauge_envs.tools.conformance.results import read_columns
from studies.planted_faults.contract_faults import FAULTS
from studies.planted_faults.fourth_set import FAULTS4
from studies.planted_faults.third_set import FAULTS3
from tests.faults import Fault

ROOT = Path(__file__).parents[2]
TABLE = Path(causes.__file__).with_suffix(".json")
OWN = {"life", "second-process"}
"""Checks of this process, which no fault changes."""

CAUSES = {
    "capsule falls through a box": "some pairs of shapes have no contact",
    "first part of a compound": "only the first part of a compound collides",
    "hinged pass the world": "bodies on hinges have no contact with fixed bodies; free bodies have",
    "press ignored by friction": "friction does not follow forces that press: it is bounded by the weight",
    "small bodies hover": "small bodies hover: margins of contacts are lengths for large bodies",
    "sticky start": "friction at rest is larger than in sliding: bodies start to slide too late",
    "gyroscopic drift": "the gyroscopic term is missing or of first order in the step",
    "warm start survives reset": "reset() leaves forces, contacts or warm starts of the run before",
    "torque in link frame": "apply_wrench takes the torque in another frame, as that of the body",
    "reported friction reversed": "contact_forces are those on the other body, or a part has the other sign",
    "friction pyramid": "friction is a pyramid in place of a cone: it depends on the direction",
    "friction of bodies, not pairs": "friction is that of bodies, not of pairs, or two values are combined",
    "restitution threshold": "bodies do not rebound below a threshold of speed",
    "rebound gains energy": "restitution differs from Contact.restitution at every speed",
    "inertia of a compound": "bodies of several parts have another inertia or another frame of it",
    "start velocity at the centre": "reset takes the start velocity as that of the centre of mass, not of the origin",
    "spin limit": "the spin of bodies is limited",
    "falls asleep in motion": "slow bodies fall asleep although they move",
    "snags at seams": "sliding bodies lose speed at seams of flush boxes",
    "contact buffer overflows": "contacts beyond a limit of their number are dropped",
    "wrench of the first body": "apply_wrench acts on another body than the named one",
    "worlds collide": "worlds of a batch act on each other by contacts or forces",
    "heavy sinks through light": "heavy bodies sink into light ones",
    "lying cylinder rocks": "contact points of lying cylinders appear and disappear, so that they rock",
    "spinning friction needs rolling": "torsional friction is missing or has another unit",
    "turns as it slides": "friction acts unevenly on the contacts of a face, which turns sliding bodies",
    "cloth drifts in free fall": "cloth gains momentum",
    "self-contact disables others": "cloth that touches itself passes through other bodies",
    "mass of small bodies": "small bodies have another mass",
    "hinge anchor from the centre": "the anchor of a hinge is misplaced, as by the offset of the centre of mass",
    "default damping": "velocities and spins of free bodies are damped",
    "friction of mass": "friction differs between bodies: it scales with a mass, or belongs to bodies instead of pairs",
    "fast impacts lose": "fast impacts rebound too slowly",
    "half contact forces": "contact_forces are scaled, as by another step",
    "force in first substep": "apply_wrench applies a part of the wrench, or acts in a part of the steps",
    "force at origin": "the force of apply_wrench acts at the body's origin, not at its centre of mass",
    "no products of inertia": "products of inertia are lost: principal axes are those of the body frame",
    "inertia of the bounding box": "bodies of several parts have another inertia or another frame of it",
    "cylinder on plane": "cylinders collide at another distance or along another axis",
    "spin of driven bodies": "friction does not see the spin of driven bodies",
    "resting spheres absorb": "free bodies do not rebound from each other, as where one is at rest",
    "spin lost at start": "the start's spin is lost",
    "no rolling friction": "rolling friction is missing or has another unit",
    "wrench of the first world": "all worlds have the wrench of the first",
    "stale contact forces": "contact_forces stay after bodies part",
    "cylinder axis": "cylinders collide at another distance or along another axis",
    "hinges damped": "hinges are damped",
    "stacks rock": "stacked boxes rock: a face has too few contacts, or contacts appear and disappear",
    "gravity x 1.02": "gravity differs from the scene's",
    "gravity upward": "gravity has the other sign",
    "speed damped": "velocities of free bodies are damped",
    "spin damped": "spins of free bodies are damped",
    "speed limit": "the speed of bodies is limited",
    "no gyro": "the gyroscopic term is missing or of first order in the step",
    "inertia x 1.25": "free bodies have another inertia",
    "inertia axes": "the inertia of free bodies has another frame, or its principal axes are mixed",
    "mass x 1.2": "bodies have another mass",
    "centre at origin": "the centre of mass does not follow from the shape: it is at the origin",
    "friction x 1.2": "friction is larger than Contact.friction everywhere",
    "friction x 0.9": "friction is smaller than Contact.friction everywhere",
    "restitution x 0.8": "restitution is smaller than Contact.restitution at every speed",
    "restitution 0": "bodies do not rebound: restitution is ignored",
    "torsion x 2": "torsional friction is missing or has another unit",
    "rolling x 2": "rolling friction is missing or has another unit",
    "force in body frame": "apply_wrench takes the force in another frame, as that of the body",
    "no torque": "apply_wrench ignores the torque",
    "double wrench": "apply_wrench applies a multiple of the wrench",
    "hover": "bodies hover: contacts have a margin",
    "sink": "bodies sink in: contacts have an allowed depth",
    "soft contacts": "contacts are soft: they yield under loads",
    "few iterations": "the solver of contacts ends before it converges",
    "regularized": "friction creeps: it is regularized",
    "all pairs collide": "pairs collide that Scene.contacts does not list",
    "dynamic pairs pass": "free bodies collide with free bodies alone or with fixed ones alone",
    "tether long": "the string of a tether has another length",
    "edges read as half edges": "edges are read as half edges, or the reverse",
    "the inertia of a sphere": "the inertia of free bodies has another frame, or its principal axes are mixed",
    "the first part of a compound": "only the first part of a compound is built",
    "a leaning plane built level": "turned planes are built level",
    "hinge axis in the body frame": "the axis of a hinge is read in the body frame",
    "frictions of two bodies multiplied": "friction is that of bodies, not of pairs, or two values are combined",
    "friction 20 % low": "friction is smaller than Contact.friction everywhere",
    "a driven body without velocity": "driven bodies have no velocity: drive() teleports them",
    "a driven body without acceleration": "drive() ignores the acceleration",
    "a driven body an interval late": "driven bodies come an interval late",
}
"""Cause by the name of a fault. Faults that only one check shows keep its own diagnosis."""

Row = tuple[str, float | None]
"""Sign of the error of a failed check, and the measured value."""


def failures(engine: Any, has_cloth: bool) -> dict[str, Row]:
    """Return the failed checks of an engine."""
    levels = {Level.RIGID, Level.CONTACT} | ({Level.CLOTH} if has_cloth else set())
    only = [check.id for check in checks() if check.level in levels]
    results = run_checks(engine, only=[name for name in only if name not in OWN])
    return {
        result.check: (causes.sign_of(result), result.measured)
        for result in results
        if result.is_bad
    }


def run(file: Path) -> dict[str, dict[str, Row]]:
    """Return the failed checks of all faults by name, of a file and of runs that it lacks."""
    known = {}
    if file.exists():
        known = dict(map(json.loads, file.read_text().splitlines()))
    sets = (FAULTS3 | FAULTS4).items()
    faults = {"healthy": Fault(), **{name: entry.fault for name, entry in sets}}
    healthy = backend("mujoco")
    for name, fault in (faults | FAULTS).items():
        if name not in known:
            known[name] = failures(fault.engine(healthy, fault), "cloth" in name)
            with file.open("a") as stream:
                stream.write(json.dumps([name, known[name]]) + "\n")
    return known


def released() -> dict[str, float]:
    """Return the share of released engines with their own presets that fail each check, if it is above 0.02."""
    columns = read_columns(ROOT / "scoring" / "conformance.json")
    shares = {}
    for check in checks():
        results = [
            column.results[check.id]
            for column in columns
            if column.name == "default" and check.id in column.results
        ]
        ran = [each for each in results if each.status is not Status.UNSUPPORTED]
        share = (sum(each.is_bad for each in ran) + 0.25) / (len(ran) + 1)
        if share > 0.04:
            shares[check.id] = round(share, 2)
    return shares


def _is_new(row: Row, own: Row | None) -> bool:
    """Return whether a failure is not that of the healthy engine, with the same value within 5 %."""
    if own is None or own[0] != row[0] or own[1] is None or row[1] is None:
        return own is None or own[0] != row[0]
    return abs(row[1] - own[1]) > 0.05 * abs(own[1])


def table(known: dict[str, dict[str, Row]]) -> dict[str, Any]:
    """Return the table of causes; faults that fewer than two checks show are left out."""
    own = known["healthy"]
    faults: dict[str, list[dict[str, str]]] = {}
    for name, cause in CAUSES.items():
        rows = known.get(name, {}).items()
        new = {check: row[0] for check, row in rows if _is_new(row, own.get(check))}
        members = faults.setdefault(cause, [])
        if len(new) > 1 and new not in members:
            members.append(dict(sorted(new.items())))
    return {
        "faults": {cause: members for cause, members in faults.items() if members},
        "released": released(),
    }


def left_out() -> Counter[str]:
    """Return how many faults get no cause, the true one or another one if the table lacks the fault."""
    faults, shares = json.loads(TABLE.read_text()).values()
    ran = {check.id for check in checks()}
    counts: Counter[str] = Counter()
    for cause, members in faults.items():
        for member in members:
            others = faults | {cause: [each for each in members if each != member]}
            named = causes.nearest(causes.ranked(member, ran, (others, shares)))
            is_true = cause in (fit.cause for fit in named)
            counts["no cause" if not named else "true" if is_true else "another"] += 1
    return counts


if __name__ == "__main__":
    if len(sys.argv) == 1:
        sys.exit(f"{dict(left_out())}")
    TABLE.write_text(json.dumps(table(run(Path(sys.argv[1]))), indent=1) + "\n")
