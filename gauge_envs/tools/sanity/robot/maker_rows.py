"""Judge a robot beside the same one as its maker or MuJoCo Menagerie published it: numbers of few parts that differ."""

import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import mujoco
import numpy as np

from gauge_envs.files import csv_text, data_folder, read_regular
from gauge_envs.tools.sanity.robot.finding import (
    Finding,
    NotApplicableError,
    body_name,
    joint_name,
    row,
)
from gauge_envs.tools.sanity.robot.joints import motors_of
from gauge_envs.tools.sanity.robot.mended_model import class_words
from gauge_envs.tools.sanity.robot.quantities import QUANTITIES, quantities, short_name
from gauge_envs.tools.sanity.robot.robot import Robot

FOLDER = data_folder("scoring") / "facts" / "robots"
"""Numbers of each published model (`<name>.csv`), and where they are from (`index.csv`); see studies/robots."""

MOST_TABLE_BYTES = 1_000_000

GEOMETRY = (
    *("mass", "inertia", "inertia-axes", "centre-of-mass", "link-place", "link-turn"),
    *("joint-place", "joint-axis", "joint-range"),
)
"""Quantities that tell whether two models are of one robot."""

HARDWARE = (*GEOMETRY, "joint-zero", "coupling", "tendon-coefficient")
"""Quantities that a robot has, whoever trains it; others, as gains and contacts, are choices."""

CONTACTS = (
    *("geoms", "contype", "conaffinity", "condim", "geom-friction", "geom-solref"),
    *("geom-margin", "geom-size", "geom-place", "geom-priority"),
)
"""Quantities of shapes, which are often modelled anew as a whole."""

OF_MOTORS = (
    *("kp", "kv", "motor-gain", "motor-limit", "control-range", "motor-gear"),
    *("motor-lag", "motor-delay", "motor-damping", "motor-armature"),
)
"""Quantities of a motor, which go by its joint: they are another motor's where a motor moves another joint."""

FREE = ("site-place", "site-turn", "option")
"""Quantities that are always a choice, as where a task reads an IMU."""

LEFT_OUT = ("motor-order", "delay", "action-scale")
"""Quantities of a task, or of what else its model has."""

FEW_LINKS = 2
"""Links up to which differences of their shapes are mistakes."""

SOME_PARTS = 6
"""Links and joints up to which differences of their geometry are mistakes; if more differ, it is another version."""

CONNECTIONS = ("sensor", "motor", "exclude", "coupling", "tendon-coefficient")
"""Quantities whose parts are connections: one that only the published model has is lost or leads elsewhere."""

FEW_JOINTS = 3
"""Joints from which on their names say which robot it is."""

SAME_JOINTS = 0.7
"""Share of the joints of the smaller of two models that the other one has too, from which on they may be one robot."""

SAME_ROBOT = 0.9
"""Share of the numbers of a quantity that are equal, in the middle one of `GEOMETRY`, from which on it is one robot."""

SAME_FILE = 0.98
"""Share of equal numbers from which on a robot is from this very file: other versions excuse nothing."""

STRENGTHS = ("motor-limit", "joint-force")
"""Quantities of the real motors, which whoever edits this very file has no reason to choose."""

OF_TASKS = ("pose", "option", "exclude", "contype", "conaffinity")
"""Quantities that those who train a robot of this very file change beside others."""

ALONE = (
    *(("armature",), ("damping",), ("frictionloss",), ("stiffness",), STRENGTHS),
    *(("mass", "inertia", "inertia-axes", "centre-of-mass"), ("gravcomp",)),
    *(("link-place", "link-turn"), ("joint-place",), ("joint-axis",)),
    *(("joint-range",), ("control-range",), ("motor-gear",)),
    *(("coupling",), ("coupling-solref",), ("tendon-coefficient",)),
    *(("geoms", "contype", "conaffinity"), ("geom-size", "geom-place")),
    *(("geom-priority",), ("exclude",), ("site-place", "site-turn")),
)
"""Quantities that are no choice where all else is of this very file: it was edited in this alone."""

LOST = frozenset({"armature", "damping", "frictionloss", "stiffness", "gravcomp"})
"""Quantities that a file loses together, as with the class of its joints, where all that differ are 0."""

MINORITY = 0.34
"""Share of the parts up to which those that differ are mistakes; if more differ, it is a choice or another version."""

WORD = re.compile(r"[A-Z](?=[A-Z]?_)|[A-Z]+(?![a-z])|[A-Za-z][a-z]*|\d+|\S")
"""Words of a part's name, as `F`, `L`, `_` and `calf` of `FL_calf`."""

SAME_FACTOR = 0.01
"""Difference of the factors of all parts up to which they are one factor."""

UNIT_FACTORS = (180.0 / math.pi, 1000.0, 9.80665, 0.45359237, 0.0254, 100.0, 10.0)
"""Factors between units, also inverse: degrees, grams, kp by weight, pounds, inches, centimetres; a decimal place."""

CHOICES = "all parts of a kind differ, as if they were chosen"
"""Why differences do not count."""

OTHER_END = {"low": "high", "high": "low"}
"""Ends of a range, with the other ones."""

SHOWN = 4
"""Differences that a remark has in full."""


Numbers = Mapping[str, Mapping[str, float]]
"""Value of each part of a robot, by quantity, as `quantities` returns it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Published:
    """A published model of a robot.

    Attributes:
        name: Its name in the table.
        robot: Maker and model of the robot.
        source: Repository and version of the file.
    """

    name: str
    robot: str
    source: str

    @cached_property
    def numbers(self) -> Numbers:
        """Value of each part, by quantity."""
        found: dict[str, dict[str, float]] = {}
        for quantity, *cells in _table(self.name):
            pairs = (cell.rpartition("=") for cell in cells)
            found[quantity] = {part: float(value) for part, _, value in pairs}
        return found


@dataclass(frozen=True, kw_only=True)
class Difference:
    """A number of a robot that is not that of the published model.

    Attributes:
        quantity: Id of the quantity.
        part: Name of the part.
        value: Value of the robot; NaN where it has no such part.
        published: Value of the published model.
    """

    quantity: str
    part: str
    value: float
    published: float

    @property
    def factor(self) -> float:
        """Factor on the published value; NaN where that is 0 or not finite."""
        is_usual = self.published != 0.0 and math.isfinite(self.published)
        return self.value / self.published if is_usual else math.nan


def _table(name: str) -> Iterator[list[str]]:
    """Yield the lines of a table."""
    content = read_regular(FOLDER / f"{name}.csv", MOST_TABLE_BYTES)
    yield from csv.reader(csv_text(content))


@cache
def published_models() -> tuple[Published, ...]:
    """Return all published models."""
    _, *lines = _table("index")
    return tuple(
        Published(name=name, robot=robot, source=source)
        for name, robot, source, _ in lines
    )


def likeness(known: Numbers, model: Published) -> float:
    """Return which share of a published model's geometry a robot has: that of the middle one of `GEOMETRY`.

    Args:
        known: Value of each part of the robot, by quantity.
        model: The published model.
    """
    joints, others = known["joint-zero"], model.numbers.get("joint-zero", {})
    shared = len(joints.keys() & others)
    if shared < max(FEW_JOINTS, SAME_JOINTS * min(len(joints), len(others))):
        return 0.0
    shares = []
    for name in GEOMETRY:
        parts = known[name].keys() & model.numbers.get(name, {})
        if parts:
            shares.append(1.0 - len(differing(name, known, model)) / len(parts))
    has_links = 2 * len(known["mass"].keys() & model.numbers["mass"]) > shared
    return float(np.median(shares)) if has_links else 0.0


def same_robots(known: Numbers) -> list[list[Published]]:
    """Return the versions of each published robot that is in a model, as an arm and a gripper, the likeliest first."""
    likely = {model: likeness(known, model) for model in published_models()}
    order = sorted(
        (model for model, share in likely.items() if share >= SAME_ROBOT),
        key=lambda model: (-equal_count(known, model), number_count(model)),
    )
    robots: list[list[Published]] = []
    for model in order:
        joints = model.numbers["joint-zero"].keys() & known["joint-zero"]
        for versions in robots:
            if joints & versions[0].numbers["joint-zero"].keys():
                versions.append(model)
                break
        else:
            robots.append([model])
    return robots


def number_count(model: Published) -> int:
    """Return how many numbers a published model has; of versions with as many equal ones, the smallest lacks least."""
    return sum(map(len, model.numbers.values()))


def equal_count(known: Numbers, model: Published) -> int:
    """Return how many numbers of a robot are those of a published model."""
    count = 0
    for name, parts in model.numbers.items():
        count += len(parts.keys() & known[name].keys())
        count -= len(
            [one for one in differing(name, known, model) if one.part in known[name]]
        )
    return count


def is_stated(one: Difference, known: Numbers, version: Published) -> bool:
    """Return whether another version of the published model states what differs as the robot does.

    Args:
        one: The difference.
        known: Value of each part of the robot, by quantity.
        version: The other version.
    """
    stated = version.numbers.get(one.quantity, {})
    if not math.isnan(one.value):
        differences = differing(one.quantity, known, version)
        return one.part in stated and one.part not in {d.part for d in differences}
    same_end = [part for part in known[one.quantity] if _end(part) == _end(one.part)]
    if same_end:
        return any(part in stated for part in same_end)
    return _end(one.part) not in map(_end, stated)


def _end(connection: str) -> str:
    """Return the name of the motor, sensor or tendon of a connection; of others the whole."""
    return re.split(" moves | reads | of ", connection)[0]


def is_left_out(one: Difference, known: Numbers) -> bool:
    """Return whether a missing connection may be left out on purpose.

    That is with its motor, sensor or tendon, with what that moves or reads, or with all its like.
    """
    stated = known[one.quantity]
    if not math.isnan(one.value):
        return False
    end, target = _end(one.part), one.part.split(" ")[-1]
    if end == one.part:
        return not stated
    has_target = any(
        part.split(" ")[0] == target
        for name in ("joint-zero", "tendon-length", "site-place", "mass")
        for part in known[name]
    )
    return not has_target or all(_end(part) != end for part in stated)


def differing(name: str, known: Numbers, model: Published) -> list[Difference]:
    """Return the parts of a quantity whose values differ; of connections also those that are missing."""
    quantity, parts = QUANTITIES[name], known[name]
    found = []
    for part, published in model.numbers.get(name, {}).items():
        if part not in parts and name not in CONNECTIONS:
            continue
        value = parts.get(part, math.nan)
        tolerance = max(quantity.least, quantity.ratio * abs(published))
        is_same = value == published or abs(value - published) <= tolerance
        if not is_same:
            found.append(
                Difference(quantity=name, part=part, value=value, published=published)
            )
    return found


def is_version(differences: Sequence[Difference], count: int) -> bool:
    """Return whether so many parts of a quantity differ that it is another version of the robot, or a choice.

    Not if all of the hardware differ by one factor, or by that of a unit.

    Args:
        differences: Parts of one quantity that differ.
        count: Number of all its parts.
    """
    if len(differences) <= MINORITY * count:
        return False
    factors = np.array([one.factor for one in differences])
    factors = factors[np.isfinite(factors)]
    if not len(factors) or np.ptp(factors) > SAME_FACTOR * abs(factors[0]):
        return True
    units = [*UNIT_FACTORS, *(1.0 / one for one in UNIT_FACTORS)]
    is_unit = bool(np.isclose(abs(factors[0]), units, rtol=SAME_FACTOR).any())
    return not is_unit and differences[0].quantity not in HARDWARE


def families(parts: Iterable[str]) -> dict[str, list[frozenset[str]]]:
    """Return the families of each part: like parts, whose names differ in one word, as of all legs or both sides."""
    found: dict[tuple[str, ...], set[str]] = {}
    for part in parts:
        words = WORD.findall(part)
        for place in range(len(words)):
            pattern = (*words[:place], "*", *words[place + 1 :])
            found.setdefault(pattern, set()).add(part)
    several: dict[str, list[frozenset[str]]] = {}
    for family in found.values():
        for part in family if len(family) > 1 else ():
            several.setdefault(part, []).append(frozenset(family))
    return several


def chosen(
    differences: Sequence[Difference], parts: Iterable[str]
) -> Iterator[Difference]:
    """Yield differences that a whole family shares, or its mirror images: someone chose the gains of all knees."""
    values = {one.part: one for one in differences}
    like = families(parts)
    for one in differences:
        for family in like.get(one.part, ()):
            if all(
                any(
                    np.isclose(abs(values[end].value), abs(one.value))
                    for end in (part, _other_end(part))
                    if end in values
                )
                for part in family
            ):
                yield one
                break


def _other_end(part: str) -> str:
    """Return the other end of a range, which is that of its mirror image; of other parts the part itself."""
    name, _, end = part.rpartition(" ")
    return f"{name} {OTHER_END[end]}" if end in OTHER_END else part


@dataclass(frozen=True, kw_only=True)
class Compared:
    """A robot beside the published model that it is most alike.

    Attributes:
        model: The published model.
        mistakes: Numbers of single parts that differ, or all of the hardware by one factor.
        choices: Other numbers that differ.
    """

    model: Published
    mistakes: Sequence[Difference]
    choices: Sequence[Difference]


def compared(known: Numbers, versions: Sequence[Published]) -> Compared:
    """Return a robot beside its published model; a number that another version states is no difference.

    Args:
        known: Value of each part of the robot, by quantity.
        versions: Versions of the published model, the likeliest first.
    """
    # A link whose shapes touch nothing has no numbers of contacts.
    total = sum(
        len(parts.keys() & known[name] if name in CONTACTS else parts)
        for name, parts in versions[0].numbers.items()
    )
    is_same_file = equal_count(known, versions[0]) >= SAME_FILE * total
    versions = versions[:1] if is_same_file else versions
    hardware = (*HARDWARE, *(STRENGTHS if is_same_file else ()))
    scaled: list[Difference] = []
    mistakes: list[Difference] = []
    choices: list[Difference] = []
    for name in (one for one in QUANTITIES if one not in LEFT_OUT):
        off = [
            one
            for one in differing(name, known, versions[0])
            if not any(is_stated(one, known, model) for model in versions[1:])
        ]
        parts = versions[0].numbers.get(name, {}).keys() & known[name].keys()
        is_chosen = name in FREE or (name == "pose" and len(off) > 1)
        if name in CONNECTIONS:
            lost = [one for one in off if is_left_out(one, known)]
            choices += lost
            off = [one for one in off if one not in lost]
            is_chosen = len(off) > FEW_LINKS and is_version(off, len(parts))
        elif not is_chosen:
            is_chosen = is_version(off, len(parts))
        if is_chosen:
            choices += off
            continue
        if len(off) > MINORITY * len(parts):
            scaled += off
            continue
        shared = [] if name in hardware else list(chosen(off, parts))
        choices += shared
        mistakes += [one for one in off if one not in shared]
    for group, most_parts, dropped in (
        (CONTACTS, FEW_LINKS, CONTACTS),
        (GEOMETRY, SOME_PARTS, tuple(QUANTITIES)),
    ):
        off = [one for one in (*mistakes, *choices) if one.quantity in group]
        if len({one.part.split(" ")[0] for one in off}) > most_parts:
            choices += [one for one in mistakes if one.quantity in dropped]
            mistakes = [one for one in mistakes if one.quantity not in dropped]
    every = [*scaled, *mistakes, *choices]
    off = [one for one in every if one.quantity not in OF_TASKS] or every
    names = {one.quantity for one in off}
    is_rest_equal = equal_count(known, versions[0]) + len(every) >= SAME_FILE * total
    is_lost = names <= LOST and not any(one.value for one in off)
    if "motor-gear" in names:
        # All else of a motor goes by its gear.
        names -= {*OF_MOTORS} - {"motor-gear", "control-range"}
    if is_rest_equal and (is_lost or any(names <= {*group} for group in ALONE)):
        mistakes += [one for one in choices if one.quantity in names]
        choices = [one for one in choices if one.quantity not in names]
    moved = [one for one in mistakes if one.quantity == "motor"]
    ends = {_end(one.part) for one in moved}
    parts_moved = [part for part in known["motor"] if _end(part) in ends]
    joints = {
        part.split(" moves ")[-1] for part in (*(m.part for m in moved), *parts_moved)
    }
    mistakes = [
        one
        for one in (*scaled, *mistakes)
        if one.quantity not in OF_MOTORS or one.part.split(" ")[0] not in joints
    ]
    return Compared(model=versions[0], mistakes=mistakes, choices=choices)


@row("robot-maker")
def _maker(robot: Robot) -> Finding:
    known = quantities(robot)
    several = [compared(known, versions) for versions in same_robots(known)]
    if not several:
        raise NotApplicableError("no published model of this robot is in the table")
    beside = max(several, key=lambda one: (len(one.mistakes) > 0, len(one.choices) > 0))
    model, shown = beside.model, beside.mistakes or beside.choices
    changes = published_changes(robot, beside.mistakes)
    meant = f"the numbers of {model.robot}, where yours are not meant"
    words = list(_words(shown))
    more = f"; {len(words) - SHOWN} more" if len(words) > SHOWN else ""
    return Finding(
        value=float(bool(shown)),
        parts={f"{one.quantity} of {one.part}": 1.0 for one in shown},
        remark=f"{'; '.join(words[:SHOWN])}{more} ({model.robot}: {model.source})",
        advice=class_words(robot, changes) or meant,
        changes=changes,
        advisory="" if beside.mistakes else CHOICES,
    )


OF_BODIES = {"mass": "body_mass", "gravcomp": "body_gravcomp"}
OF_DOFS = {
    "damping": "dof_damping",
    "frictionloss": "dof_frictionloss",
    "armature": "dof_armature",
}
"""Arrays of the model with one number for each link and each degree of freedom, by quantity."""


def published_changes(
    robot: Robot, differences: Sequence[Difference]
) -> dict[str, Any]:
    """Return the published numbers as changes of the model, by names that `Robot.changed` knows; empty unless of all.

    Args:
        robot: The robot.
        differences: Its numbers that are not those of the published model.
    """
    model = robot.model
    changes: dict[str, Any] = {}
    bodies = {short_name(body_name(robot, body)): body for body in robot.bodies}
    dofs = {short_name(joint_name(robot, dof)): dof for dof in range(model.nv)}
    motors = {int(model.actuator_trnid[a, 0]): a for a in motors_of(robot)}
    for one in differences:
        part, _, end = one.part.partition(" ")
        if not math.isfinite(one.published):
            return {}
        if one.quantity in OF_BODIES and part in bodies:
            changes[f"{OF_BODIES[one.quantity]}[{bodies[part]}]"] = one.published
        elif one.quantity == "inertia" and part in bodies:
            body, scale = bodies[part], _one_factor(differences, part)
            if not scale:
                return {}
            changes[f"body_inertia[{body}]"] = model.body_inertia[body] / scale
        elif one.quantity in OF_DOFS and part in dofs:
            changes[f"{OF_DOFS[one.quantity]}[{dofs[part]}]"] = one.published
        elif one.quantity == "joint-range" and part in dofs:
            joint = int(model.dof_jntid[dofs[part]])
            name = f"jnt_range[{joint}]"
            limits = changes.setdefault(name, model.jnt_range[joint].copy())
            limits[("low", "high").index(end)] = one.published
        elif one.quantity in ("kp", "kv", "motor-limit") and part in dofs:
            actuator = motors.get(int(model.dof_jntid[dofs[part]]), -1)
            gear = abs(float(model.actuator_gear[actuator, 0]))
            if actuator < 0 or not gear:
                return {}
            changes |= _of_servo(model, actuator, one, gear, changes)
        else:
            return {}
    return changes


def _one_factor(differences: Sequence[Difference], link: str) -> float:
    """Return the factor of all moments of inertia of a link; 0 where they differ in several."""
    factors = [
        one.factor
        for one in differences
        if one.quantity == "inertia" and one.part.split(" ")[0] == link
    ]
    is_one = len(factors) == 3 and np.allclose(factors, factors[0], rtol=SAME_FACTOR)
    return factors[0] if is_one else 0.0


def _of_servo(
    model: mujoco.MjModel,
    actuator: int,
    one: Difference,
    gear: float,
    changes: Mapping[str, Any],
) -> dict[str, Any]:
    """Return a published gain or largest force as changes of an actuator, beside changes before."""
    if one.quantity == "motor-limit":
        limit = one.published / gear
        return {f"actuator_forcerange[{actuator}]": np.array([-limit, limit])}
    names = [f"actuator_{kind}prm[{actuator}]" for kind in ("gain", "bias")]
    gain, bias = (
        changes.get(name, getattr(model, name.partition("[")[0])[actuator]).copy()
        for name in names
    )
    value = one.published / gear**2
    if one.quantity == "kp":
        gain[0], bias[1] = value, -value
    else:
        bias[2] = -value
    return dict(zip(names, (gain, bias), strict=True))


def _words(found: Sequence[Difference]) -> Iterator[str]:
    """Yield what differs, a text for each part of a quantity: of several components the first one."""
    several: dict[tuple[str, str], list[Difference]] = {}
    for one in found:
        several.setdefault((one.quantity, one.part.split(" ")[0]), []).append(one)
    # The pose is that of a task; what few parts have says most.
    counts = Counter(name for name, _ in several)
    order = sorted(several, key=lambda key: (key[0] == "pose", counts[key[0]]))
    for (name, _), (first, *others) in ((key, several[key]) for key in order):
        unit = QUANTITIES[name].unit
        unit = "" if unit == "1" or " or " in unit else f" {unit}"
        value = "missing" if math.isnan(first.value) else f"{first.value:.4g}"
        more = f" (and {len(others)} more)" if others else ""
        yield f"{name} of {first.part}: {value} instead of {first.published:.4g}{unit}{more}"
