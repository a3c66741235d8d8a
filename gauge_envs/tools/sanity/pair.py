"""Pairs of geoms: which friction is in force and by which rule, what follows, and what other stacks make of it."""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from operator import mul
from typing import Any

import mujoco
import numpy as np

from gauge_envs.backends.mujoco.contact_table import COLUMNS, contact_pairs
from gauge_envs.backends.mujoco.messages import mujoco_warnings
from gauge_envs.backends.mujoco.options import overrides_contacts
from gauge_envs.errors import UnknownNameError
from gauge_envs.names import first_names
from gauge_envs.pages.document import Paragraph, Part, Tone
from gauge_envs.pages.table import Table, grid
from gauge_envs.pages.text import digits_text
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.sanity.fixes.candidates import candidates_of, keeps_recipe
from gauge_envs.tools.sanity.fixes.harm import changes_rebound, motion_harm
from gauge_envs.tools.sanity.fixes.text_change import attribute_text, paste_text
from gauge_envs.tools.sanity.pair_bench import (
    PAIR_FIELDS,
    Bench,
    Value,
    bench,
    set_pair,
    touch_of,
    touching,
)
from gauge_envs.tools.sanity.robot.robot import Robot, geom_name
from gauge_envs.tools.sanity.verdict import Settings, TrainingConfiguration

Rule = Callable[[float, float], float]


def _mean(first: float, second: float) -> float:
    return 0.5 * (first + second)


STACKS: tuple[tuple[str, str, str, Rule, Rule | None, str], ...] = (
    (
        "mujoco",
        "MuJoCo, MuJoCo Warp, mjlab",
        "greater, without priority or pair",
        max,
        None,
        "MuJoCo documentation, Contact parameters",
    ),
    (
        "newton",
        "Newton SolverMuJoCo",
        "greater, without priority",
        max,
        None,
        "Newton 1.8.0, solvers/mujoco/kernels.py, contact_params",
    ),
    (
        "newton",
        "Newton SolverXPBD",
        "mean",
        _mean,
        _mean,
        "Newton 1.8.0, solvers/xpbd/kernels.py",
    ),
    (
        "newton",
        "Newton SolverVBD",
        "sqrt(a b)",
        lambda a, b: math.sqrt(a * b),
        None,
        "Newton 1.8.0, solvers/vbd/rigid_vbd_kernels.py",
    ),
    (
        "genesis",
        "Genesis",
        "greater, at least 0.01",
        lambda a, b: max(a, b, 0.01),
        None,
        "Genesis 7bf5f6a7, rigid/collider/contact.py",
    ),
    (
        "isaac",
        "Isaac Lab, on its terrain for locomotion",
        "product: combine mode multiply",
        mul,
        mul,
        "Isaac Lab 032e26b7, velocity_env_cfg.py",
    ),
    (
        "isaac",
        "Isaac Sim, Isaac Lab by default",
        "mean: combine mode average",
        _mean,
        _mean,
        "Isaac Lab 046b71b8, physics_materials_cfg.py",
    ),
    (
        "physx",
        "PhysX, SAPIEN",
        "mean: combine mode average",
        _mean,
        _mean,
        "PhysX 5.6, PxCombineMode: the later of average, min, multiply, max counts",
    ),
    (
        "pybullet",
        "PyBullet",
        "product, at most 10",
        lambda a, b: min(a * b, 10.0),
        mul,
        "Bullet, btManifoldResult.cpp",
    ),
    (
        "rapier",
        "Rapier",
        "mean: the default rule",
        _mean,
        _mean,
        "Rapier 0.32, CoefficientCombineRule",
    ),
    (
        "drake",
        "Drake",
        "2 a b / (a + b)",
        lambda a, b: 2.0 * a * b / max(a + b, 1e-300),
        None,
        "Drake 0ffdade9, coulomb_friction.h",
    ),
)
"""Name for `--as`, stack, its rule for frictions a and b, the rule as functions for friction and restitution, source.

A stack without a rule for restitutions rebounds by constants of its contacts.
"""

MAX_PAIRS = 6
"""Largest number of groups of pairs that are measured without `--pair`."""

SHOWN = {
    "creep at 0.9 of the limit": "creep at 0.9 of the limit",
    "slide at 45 degrees over Coulomb": "diagonal slide",
    "hop at 4 m/s": "hop at 4 m/s",
    "rebound": "rebound",
    "grazing impact over Coulomb": "grazing impact",
}
"""Title of each value in the table of pairs that touch."""

LAW = "By Coulomb's law: no creep, no hop, and 1 for the diagonal slide and the grazing impact."
"""Note below that table."""

KILO, LARGER = 1000.0, {"um/s": ("mm/s", "m/s")}
"""Larger units of values, each a thousand times as large."""

HALVED = 0.5
"""Largest share of the worst deviation that a change may leave."""


@mujoco_warnings()
def pair_parts(
    configuration: TrainingConfiguration, names: tuple[str, str], stack: str = ""
) -> list[Part]:
    """Return the page of two geoms: friction in force, what follows from it, a change, and the same in other stacks.

    Args:
        configuration: The configuration of a model with these geoms, which can touch.
        names: Names of the two geoms.
        stack: Name of a stack of `STACKS`; all when empty.

    Raises:
        UnknownNameError: There is no such stack.
        TargetError: A geom cannot be measured alone.
    """
    known = dict.fromkeys(name for name, *_ in STACKS)
    if stack and stack not in known:
        raise UnknownNameError("stack", stack, known)
    robot = configuration.robot
    assert robot is not None, "a target with geoms has a robot"
    model = robot.model
    geoms = [geom_name(model, geom) for geom in range(model.ngeom)]
    pair = sorted_pair(geoms.index(names[0]), geoms.index(names[1]))
    forces_n = touching(robot).get(pair)
    measured, constants = _bench(robot, pair), _constants(robot, pair)
    values, time_s = measured.values(), constants[COLUMNS["solref"]][0]
    load = f"pressed with {digits_text(measured.touch.load_n)} N" + (
        " in the run" if forces_n is not None else ", its weight"
    )
    texts = [
        f"{names[0]} and {names[1]}: friction {digits_text(measured.friction)} is in force, {_rule(robot, pair)}",
        f"condim {constants[0]:.0f}",
        f"{digits_text(measured.touch.mass_kg)} kg {load}",
    ]
    if time_s > 0.0:
        steps = digits_text(float(time_s / model.opt.timestep))
        texts.insert(-1, f"time constant {steps} steps")
    rows = [
        (
            value.name,
            _value_text(value),
            ""
            if value.law is None
            else f"{value.law:g} +- {_text(value.width, value.unit)}",
        )
        for value in values
    ]
    rebound = next(value.value for value in values if value.name == "rebound")
    return [
        Paragraph(f"{', '.join(texts)}.", Tone.ANSWER),
        grid(("these two geoms alone", "here", "law"), rows),
        Paragraph(_fix_text(configuration, measured, names), Tone.ANSWER),
        _stack_table(model, pair, rebound, stack),
    ]


@mujoco_warnings()
def touching_table(configuration: TrainingConfiguration) -> list[Part]:
    """Return a table of the pairs that touch in a run from the keyframe, equal ones in a line; nothing without."""
    robot = configuration.robot
    if robot is None:
        return []
    groups: dict[tuple[object, ...], list[tuple[int, int]]] = {}
    forces_n = touching(robot)
    for pair in sorted(forces_n, key=lambda pair: -forces_n[pair][0]):
        sizes = robot.model.geom_size[list(pair)].tolist()
        key = (
            str(sizes),
            str(_constants(robot, pair).tolist()),
            _rule(robot, pair),
        )
        groups.setdefault(key, []).append(pair)
    rows = [_touching_row(robot, pairs) for pairs in [*groups.values()][:MAX_PAIRS]]
    titles = "pairs that touch", "friction", *SHOWN.values()
    law = Paragraph(LAW, Tone.NOTE)
    return [grid(titles, rows), law] if rows else []


def _touching_row(robot: Robot, pairs: list[tuple[int, int]]) -> list[str]:
    """Return the line of pairs with equal contacts, measured for the one with the largest load."""
    measured = _bench(robot, pairs[0])
    texts = {value.name: _value_text(value) for value in measured.values()}
    sides = [
        first_names([geom_name(robot.model, geom) for geom in dict.fromkeys(side)], 4)
        for side in zip(*pairs, strict=True)
    ]
    friction = f"{digits_text(measured.friction)}, {_rule(robot, pairs[0])}"
    return [" with ".join(sides), friction, *(texts.get(n, "-") for n in SHOWN)]


def sorted_pair(first: int, second: int) -> tuple[int, int]:
    """Return two geoms, the smaller first."""
    return min(first, second), max(first, second)


def _bench(robot: Robot, pair: tuple[int, int]) -> Bench:
    return bench(robot, touch_of(robot, pair), _constants(robot, pair))


def _constants(robot: Robot, pair: tuple[int, int]) -> FloatArray:
    """Return the effective constants of two geoms that can touch, shape [17]."""
    row = np.flatnonzero((robot.pairs.geoms == pair).all(axis=1))[0]
    return np.asarray(robot.pairs.constants[row])


def _value_text(value: Value) -> str:
    return "-" if math.isnan(value.value) else _text(value.value, value.unit)


def _text(number: float, unit: str) -> str:
    number = round(number, 6) + 0.0
    for larger in LARGER.get(unit, ()):
        if abs(number) >= KILO:
            number, unit = number / KILO, larger
    return f"{digits_text(number)} {unit}".rstrip()


# --- the contact -----------------------------------------------------------------------------------------------------


def _explicit(model: mujoco.MjModel, first: int, second: int) -> int | None:
    """Return the explicit pair of two geoms; None without one."""
    ends = np.sort(np.column_stack([model.pair_geom1, model.pair_geom2]), axis=1)
    found = np.flatnonzero((ends == [first, second]).all(axis=1))
    return int(found[0]) if found.size else None


def _rule(robot: Robot, pair: tuple[int, int]) -> str:
    """Return where the friction of two geoms comes from."""
    model, (first, second) = robot.model, pair
    condim = _constants(robot, pair)[0]
    if condim == 1:
        return "as condim is 1"
    if overrides_contacts(model):
        return "stated by o_friction of the option"
    if _explicit(model, first, second) is not None:
        return "stated by their pair"
    stated = [model.geom_friction[geom, 0] for geom in (first, second)]
    values = " and ".join(digits_text(float(value)) for value in stated)
    if model.geom_priority[first] != model.geom_priority[second]:
        return f"of the geom with the higher priority, of {values}"
    return f"the greater of {values}"


def _stack_table(
    model: mujoco.MjModel, pair: tuple[int, int], rebound: float, stack: str
) -> Table:
    """Return the friction of the same two materials in other stacks, and the restitution of both for this rebound."""
    stated = [float(model.geom_friction[geom, 0]) for geom in pair]
    explicit = _explicit(model, *pair)
    if explicit is not None:
        stated = 2 * [float(model.pair_friction[explicit, 0])]
    rows = []
    for name, title, words, rule, restitution, source in STACKS:
        if stack in ("", name):
            both, share = "contact constants", max(rebound, 0.0)
            if restitution is not None:
                both = digits_text(math.sqrt(share) if restitution is mul else share)
            row = [title, digits_text(rule(*stated)), words, both]
            rows.append([*row, source] if stack else row)
    materials = " and ".join(map(digits_text, stated))
    titles = [f"{materials} in", "friction", "rule", "restitution of both"]
    return grid([*titles, "source"] if stack else titles, rows)


# --- the change ------------------------------------------------------------------------------------------------------


def _fix_text(
    configuration: TrainingConfiguration, measured: Bench, names: tuple[str, str]
) -> str:
    """Return the cheapest line that mends the worst value without harm to the others, with its price, after a trial."""
    before = measured.values()
    worst = max(before, key=lambda value: value.deviation)
    if worst.deviation <= 1.0:
        return "All values are within the widths of their laws."
    robot = configuration.robot
    assert robot is not None
    if keeps_recipe(robot.model):
        return f"Worst: {worst.name}. The lines of the recipe stay; gauge recipe prints what others would cost."
    step_s, solref = robot.model.opt.timestep, measured.model.pair_solref[0].tolist()
    tangential = {"contact_solreffriction": (0.0, -0.95 / step_s)}
    candidates = [*candidates_of(configuration), {"cone": "elliptic", **tangential}]
    best: tuple[float, Settings, list[Value]] | None = None
    for changes in candidates:
        after = measured.changed(changes).values()
        left = max(v.deviation for v in after if v.name == worst.name)
        if _harms(before, after, worst.name, solref) or left > HALVED * worst.deviation:
            continue
        if best is None or left < best[0]:
            changed = _with_line(robot, measured, changes)
            if changed is None or motion_harm(robot, changed):
                continue
            best = left, changes, after
        if left <= 1.0:
            break
    if best is None:
        return f"Worst: {worst.name}. None of {len(candidates)} tried changes halves its error without harm."
    return _line_text(measured, names, before, *best[1:], worst.name)


def _harms(
    before: list[Value], after: list[Value], worst: str, solref: Sequence[float]
) -> bool:
    """Return whether a value other than the worst leaves its law, or a rebound changes."""
    if len(before) != len(after):
        return True
    for old, new in zip(before, after, strict=True):
        if new.law is None and changes_rebound(old.value, new.value, solref):
            return True
        if old.name != worst and new.deviation > max(1.0, 1.2 * old.deviation):
            return True
    return False


def _line_text(
    measured: Bench,
    names: tuple[str, str],
    before: list[Value],
    changes: Settings,
    after: list[Value],
    worst: str,
) -> str:
    """Return a change as it is pasted, the first and the worst value that it mends, and what it costs."""
    mended, price = list[str](), list[str]()
    for old, new in zip(before, after, strict=True):
        text = f"{new.name} {_value_text(old)} -> {_value_text(new)}"
        if old.deviation > max(1.0, new.deviation):
            mended += [text] if not mended or old.name == worst else []
        elif new.deviation > old.deviation + 0.1:
            price.append(text)
    if "timestep_s" in changes:
        times = measured.model.opt.timestep / changes["timestep_s"]
        price.append(f"{times:g} times as many steps")
    options = {k: v for k, v in changes.items() if k not in PAIR_FIELDS}
    lines = [paste_text(options)] if options else []
    if len(options) < len(changes):
        lines.append(_pair_line(measured.changed(changes).model, names))
    line = f"Best line: {' and '.join(lines)}: {', '.join(mended)}"
    return f"{line}; price: {', '.join(price) or 'none of these values'}."


def _pair_values(model: mujoco.MjModel) -> dict[str, Any]:
    """Return the attributes of the explicit pair of a bench."""
    keys = ["friction", "solref", "solreffriction", "solimp", "margin", "gap"]
    values = {key: getattr(model, f"pair_{key}")[0] for key in keys}
    return {"condim": int(model.pair_dim[0]), **values}


def _pair_line(model: mujoco.MjModel, names: tuple[str, str]) -> str:
    """Return the explicit pair of a bench in MJCF."""
    texts = (
        f' {key}="{attribute_text(value)}"'
        for key, value in _pair_values(model).items()
        if np.any(value)
    )
    return f'<contact><pair geom1="{names[0]}" geom2="{names[1]}"{"".join(texts)}/></contact>'


def _with_line(robot: Robot, measured: Bench, changes: Settings) -> Robot | None:
    """Return the robot with a change of a pair; None where its file cannot have it."""
    model = copy.copy(robot.model)
    pair = sorted_pair(measured.touch.fixed, measured.touch.moving)
    if any(name in PAIR_FIELDS for name in changes) and _explicit(model, *pair) is None:
        if robot.spec is None or not all(model.geom(geom).name for geom in pair):
            return None
        spec = robot.spec.copy()
        added = spec.add_pair(
            geomname1=model.geom(pair[0]).name, geomname2=model.geom(pair[1]).name
        )
        for key, value in _pair_values(measured.model).items():
            setattr(added, key, value)
        model = spec.compile()
    set_pair(model, changes, _explicit(model, *pair))
    return replace(robot, model=model, pairs=contact_pairs(model))
