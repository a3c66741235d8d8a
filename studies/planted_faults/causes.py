"""Count the planted faults that the checks catch, and those whose cause the first line of the report names.

    python -m studies.planted_faults.causes faults.jsonl

runs the checks of rigid bodies on each fault, in some fifteen minutes, and appends the results to a file. Faults that
the file has already are not run again. Faults whose name has "cloth" also run the checks of cloth.
"""

import json
import re
import sys
from pathlib import Path
from typing import Any

from gauge_envs.backends import backend
from gauge_envs.tools.conformance import Level, checks, run_checks
from gauge_envs.tools.conformance.causes import likely_causes
from studies.planted_faults.contract_faults import FAULTS
from studies.planted_faults.fifth_set import FAULTS5
from studies.planted_faults.fourth_set import FAULTS4
from studies.planted_faults.sixth_set import FAULTS6
from studies.planted_faults.third_set import FAULTS3
from tests.faults import Fault

OWN = {"life", "second-process"}
"""Checks of this process, which no fault changes."""

MASS = "another mass"
INERTIA, SOLIDS = "free bodies have another inertia", "solids other than boxes"
WORDS = {
    "capsule falls through a box": "the pair has no contact",
    "first part of a compound": "check each part of a compound",
    "hinged pass the world": "hinged bar on a shelf",
    "press ignored by friction": "does not follow a force that presses",
    "small bodies hover": "margins, offsets",
    "sticky start": "friction at rest is larger",
    "gyroscopic drift": "gyroscopic",
    "warm start survives reset": "leaves something behind",
    "torque in link frame": "the torque and not the force",
    "reported friction reversed": "its friction has the other sign",
    "friction pyramid": "pyramid",
    "friction of bodies, not pairs": "of bodies, not of pairs",
    "restitution threshold": "threshold of speed",
    "rebound gains energy": "restitution is larger",
    "inertia of a compound": SOLIDS,
    "start velocity at the centre": "as that of the centre of mass",
    "spin limit": "spin has a limit",
    "falls asleep in motion": "fall asleep",
    "snags at seams": "at the inner edge",
    "contact buffer overflows": "beyond a limit of their number",
    "wrench of the first body": "acts on another body",
    "worlds collide": "worlds act on each other",
    "heavy sinks through light": "heavy bodies sink into light ones",
    "lying cylinder rocks": "bodies rock",
    "spinning friction needs rolling": "for torsion_m",
    "turns as it slides": "acts unevenly",
    "cloth drifts in free fall": "momentum is gained",
    "self-contact disables others": "passes through",
    "mass of small bodies": MASS,
    "hinge anchor from the centre": "another anchor",
    "default damping": "is damped",
    "friction of mass": "depends on a mass",
    "fast impacts lose": "fast impacts rebound too slowly",
    "half contact forces": "0.5 times that of the law",
    "force in first substep": "in a part of the steps",
    "force at origin": "beside the centre of mass",
    "no products of inertia": SOLIDS,
    "inertia of the bounding box": SOLIDS,
    "cylinder on plane": "cylinder on fixed plane",
    "spin of driven bodies": "the spin of driven bodies",
    "resting spheres absorb": "do not rebound from each other",
    "spin lost at start": "spin of free bodies differs from the start's",
    "no rolling friction": "for rolling_m",
    "capsules sink": "capsule on plane",
    "wrench of the first world": "the wrench of another world",
    "stale contact forces": "stays after the bodies part",
    "cylinder axis": "the cylinder's axis",
    "hinges damped": "hinges are damped",
    "friction is restitution": "that of another constant",
    "stacks rock": "stacks do not come to rest",
    "gravity x 1.02": "gravity is not",
    "gravity upward": "gravity is not",
    "speed damped": "the speed of free bodies is damped",
    "spin damped": "the spin of free bodies is damped",
    "speed limit": "speed has a limit",
    "no gyro": "gyroscopic",
    "inertia x 1.25": INERTIA,
    "inertia axes": INERTIA,
    "mass x 1.2": MASS,
    "centre at origin": "the centre of mass does not follow",
    "friction x 1.2": "friction is larger",
    "friction x 0.9": "friction is smaller",
    "restitution x 0.8": "restitution is smaller",
    "restitution 0": "restitution is smaller",
    "torsion x 2": "for torsion_m",
    "rolling x 2": "for rolling_m",
    "force in body frame": "the force and not the torque",
    "no torque": "the torque and not the force",
    "double wrench": "a multiple or a part",
    "hover": "bodies hover",
    "sink": "bodies sink in",
    "soft contacts": "contacts are soft",
    "few iterations": "before it converges",
    "regularized": "friction is regularized",
    "all pairs collide": "bodies without a contact are stopped",
    "dynamic pairs pass": "free bodies have no contact with each other",
    "tether long": "in length",
    "edges read as half edges": "another size",
    "the inertia of a sphere": INERTIA,
    "the first part of a compound": "parts of compounds are missing",
    "a leaning plane built level": "the plane is level",
    "hinge axis in the body frame": "another anchor or axis",
    "frictions of two bodies multiplied": "values of two bodies are combined",
    "friction 20 % low": "friction is smaller",
    "a driven body without velocity": "it reports 0 times its velocity",
    "a driven body without acceleration": "the acceleration that drive() gives",
    "a driven body an interval late": "one interval late",
    "hull offset": "convex solid",
    "uneven friction": "depends on the direction",
    "hinged inertia": "inertia",
    "rollers hop": "hops|rock or roll",
    "velocity of driven bodies": "driven bod",
    "stacks sink": "sink|free bodies",
    "fast bodies pass": "fast|it passes through|an impact is missed",
    "first run differs": "the same seed gives",
    "simulations share time": "simulations share",
    "deflected slides": "unevenly|deflect|direction",
    "centre of mass mirrored": "centre of mass",
    "rubbing hinges": "rub",
    "light bodies float": "gravity",
    "root of restitution": "restitution is larger",
    "root of friction": "friction is larger|each pair has another factor",
    "wrenches add": "a multiple or a part|replaces it",
    "torsion times friction": "for torsion_m",
    "shifted worlds": "course of start",
    "forces in contact frame": "frame",
    "tall boxes": "another size|a size differs",
    "strings taut": "in length",
    "cylinder as box": "inertia",
    "air drag": "damped",
    "last contact wins": "of bodies, not of pairs|another factor|combined",
    "small spheres": "size",
    "start spin in body frame": "start",
    "friction over points": "friction is smaller|shape",
    "cylinder inertia along y": "inertia",
    "spinning balls sink": "sink|off their heights",
    "wrench grows": "a multiple or a part",
    "free pairs collide": "without a contact are stopped",
    "velocity and spin swapped": "columns 7 to 12",
    "start velocities ignored": r"reset\(starts\)",
    "lifted at impacts": "gain energy|restitution is larger|rebound",
    "global friction": "another factor|combined",
    "gravity in a part of the steps": "gravity",
    "stale after reset": "after reset|reset restores",
    "shared gravity": "shares gravity|share their state",
    "anchor off": "anchor",
    "heavy compounds": "another mass",
    "no spin of drive": "turning block",
    "dead solids": "rebound",
    "tilted gravity": "gravity",
    "order of pairs": "order of the pair|reversed",
    "force limit": "the force and not the torque|a multiple or a part",
    "only the first world driven": "driven motion",
    "whole frames": "simulates the given time",
    "half friction reported": "the force on the sliding",
    "raised planes": "plane",
}
"""Patterns of words by which the first line names the cause of a fault."""


SETS = {
    "": {"healthy": Fault()},
    "contract": FAULTS,
    **{
        str(number): {name: entry.fault for name, entry in entries.items()}
        for number, entries in enumerate((FAULTS3, FAULTS4, FAULTS5, FAULTS6), 3)
    },
}
"""Faults by name, of each set."""


def run(engine: Any, has_cloth: bool) -> tuple[dict[str, float | None], list[str]]:
    """Return the failed checks of an engine with their values, and the causes that the report names."""
    levels = {Level.RIGID, Level.CONTACT} | ({Level.CLOTH} if has_cloth else set())
    only = [check.id for check in checks() if check.level in levels]
    results = list(run_checks(engine, only=[name for name in only if name not in OWN]))
    failed = {result.check: result.measured for result in results if result.is_bad}
    return failed, likely_causes(results)


def _is_caught(failed: dict[str, float | None], own: dict[str, float | None]) -> bool:
    """Return whether a check fails that passes in the healthy engine, or by 5 % more."""
    return any(
        name not in own or abs((value or 0.0) - own[name]) > 0.05 * abs(own[name])
        for name, value in failed.items()
    )


def main(file: Path) -> None:
    """Run the faults that a file lacks, and print counts and the faults that are not named."""
    known: dict[str, Any] = {}
    if file.exists():
        known = dict(map(json.loads, file.read_text().splitlines()))
    healthy = backend("mujoco")
    for title, faults in SETS.items():
        for name in faults.keys() - known.keys():
            engine = faults[name].engine(healthy, faults[name])
            known[name] = run(engine, "cloth" in name)
            with file.open("a") as stream:
                stream.write(json.dumps([name, known[name]]) + "\n")
        if not title:
            continue
        caught = [n for n in faults if _is_caught(known[n][0], known["healthy"][0])]
        named = [n for n in caught if re.search(WORDS[n], known[n][1][0])]
        print(f"set {title}: {len(caught)} of {len(faults)} caught, {len(named)} named")
        for name in caught:
            if name not in named:
                print(f"  {name}: {known[name][1][0]}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
