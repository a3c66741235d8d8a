"""One pair of geoms: which friction is in force, by which rule, and which the same materials have in other stacks."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from gauge_envs.backends.mujoco.contact_table import COLUMNS
from gauge_envs.errors import TargetError
from gauge_envs.pages.document import Paragraph, Part, Tone
from gauge_envs.pages.table import Table, grid
from gauge_envs.pages.text import digits_text
from gauge_envs.tools.sanity.robot.robot import Robot

Rule = Callable[[float, float], float]


def _mean(first: float, second: float) -> float:
    return 0.5 * (first + second)


def _product(first: float, second: float) -> float:
    return first * second


def _harmonic_mean(first: float, second: float) -> float:
    return 2.0 * first * second / max(first + second, np.finfo(float).tiny)


STACKS: tuple[tuple[str, str, Rule], ...] = (
    ("MuJoCo, MuJoCo Warp, mjlab", "greater, without priority or pair", max),
    ("Newton (SolverMuJoCo)", "greater", max),
    ("Newton (SolverXPBD)", "mean", _mean),
    ("Genesis", "greater, at least 0.01", max),
    ("PhysX, Isaac Sim, Isaac Lab", "mean: combine mode average, the default", _mean),
    ("the same", "product: combine mode multiply, as on many terrains", _product),
    ("PyBullet", "product", _product),
    ("Rapier", "mean: CoefficientCombineRule, the default", _mean),
    ("Drake", "2 a b / (a + b)", _harmonic_mean),
)
"""How each stack combines the frictions a and b of two materials.

MuJoCo: "Contact parameters" of its documentation. Newton: `solvers/xpbd/kernels.py`. Genesis:
`rigid/collider/contact.py`. PhysX: `PxCombineMode`, of which the later of average, min, multiply, max counts. Isaac
Lab: `RigidBodyMaterialCfg`. Bullet: `btManifoldResult`. Rapier: `CoefficientCombineRule`. Drake:
`CalcContactFrictionFromSurfaceProperties`.
"""


def pair_parts(robot: Robot, names: tuple[str, str]) -> list[Part]:
    """Return the friction in force between two geoms with its rule, and that of other stacks.

    Args:
        robot: The model.
        names: Names of the two geoms.

    Raises:
        TargetError: The geoms cannot touch.
    """
    model, pairs = robot.model, robot.pairs
    first, second = (model.geom(name).id for name in names)
    rows = np.flatnonzero((pairs.geoms == sorted((first, second))).all(axis=1))
    if not rows.size:
        raise TargetError(
            f"{names[0]} and {names[1]} cannot touch: their contype and conaffinity, their bodies or an exclude keep "
            "them apart"
        )
    constants = pairs.constants[rows[0]]
    frictions = [float(model.geom_friction[geom, 0]) for geom in (first, second)]
    condim, friction = int(constants[0]), float(constants[1])
    texts = [
        f"{names[0]} and {names[1]}: friction {digits_text(friction)} is in force, {_rule(model, first, second)}",
        f"condim {condim}",
        *_time_constant(constants[COLUMNS["solref"]], model.opt.timestep),
    ]
    masses_kg = [
        float(model.body_subtreemass[model.body_rootid[model.geom_bodyid[geom]]])
        for geom in (first, second)
        if model.geom_bodyid[geom]
    ]
    if len(masses_kg) == 2:
        ratio = max(masses_kg) / max(min(masses_kg), np.finfo(float).tiny)
        texts.append(f"masses {digits_text(ratio)} to 1")
    return [Paragraph(f"{', '.join(texts)}.", Tone.ANSWER), _stack_table(*frictions)]


def _rule(model: mujoco.MjModel, first: int, second: int) -> str:
    """Return where the friction of two geoms comes from."""
    explicit = np.column_stack([model.pair_geom1, model.pair_geom2])
    if any(set(row) == {first, second} for row in explicit.tolist()):
        return "stated by their pair"
    stated = [model.geom_friction[geom, 0] for geom in (first, second)]
    values = " and ".join(digits_text(float(value)) for value in stated)
    ranks = [int(model.geom_priority[geom]) for geom in (first, second)]
    if ranks[0] != ranks[1]:
        return f"of the geom with the higher priority, of {values}"
    return f"the greater of {values}"


def _time_constant(solref: np.ndarray, step_s: float) -> list[str]:
    """Return the time constant of the contact in steps; empty for stiffness and damping."""
    if solref[0] <= 0.0:
        return []
    return [f"time constant {digits_text(float(solref[0]) / step_s)} steps"]


def _stack_table(first: float, second: float) -> Table:
    """Return the friction of the same two materials in other stacks."""
    rows = [
        (stack, digits_text(rule(first, second)), words)
        for stack, words, rule in STACKS
    ]
    return grid(("the same materials in", "friction", "rule"), rows)
