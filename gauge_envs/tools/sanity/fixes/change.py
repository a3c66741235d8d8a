"""Apply changes of settings to a configuration as a user would paste them."""

import copy

import mujoco
import numpy as np

from gauge_envs.backends.mujoco.options import set_option
from gauge_envs.errors import ParameterError
from gauge_envs.tools.sanity.model_checks.at_rest import constraints
from gauge_envs.tools.sanity.readers.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.robot.robot import Place, Robot, free_balls, grasping_pairs
from gauge_envs.tools.sanity.verdict import Settings, TrainingConfiguration

GEOM_FIELDS = {
    "contact_solref": "solref",
    "contact_solimp": "solimp",
    "contact_margin_m": "margin",
    "contact_gap_m": "gap",
    "condim": "condim",
}
"""Attributes of a geom by the names of settings."""

EQUALITY_FIELDS = {"equality_solref": "solref", "equality_solimp": "solimp"}
"""Attributes of an equality by the names of settings."""

ELEMENT_FIELDS = GEOM_FIELDS | EQUALITY_FIELDS
"""Attributes of elements by the names of settings; all other settings are options."""

PAIRED = ("contact_solref", "contact_solimp")
"""Settings that explicit pairs give instead of their geoms, in the same form."""

SHARED = ("contact_margin_m", "contact_gap_m")
"""Settings of which each of two geoms gives a half: they add up."""


Places = dict[str, list[Place]]
"""Elements that change, for each setting of elements."""


def applied(
    configuration: TrainingConfiguration, changes: Settings
) -> TrainingConfiguration:
    """Return the configuration of a model with changes.

    Args:
        configuration: The configuration.
        changes: New values by the names of settings, as `changed_model` takes them.

    Raises:
        ParameterError: MuJoCo rejects the changed model.
    """
    robot = configuration.robot
    assert robot is not None, "only the settings of a model change"
    model = changed_model(robot, changes)[0]
    try:
        mujoco.mj_forward(model, mujoco.MjData(model))
    except mujoco.FatalError as error:
        raise ParameterError(str(error)) from None
    return mujoco_configuration(
        model,
        name=configuration.name,
        source=configuration.source,
        spec=robot.spec,
        pair=robot.pair,
        file=robot.file,
    )


def changed_model(robot: Robot, changes: Settings) -> tuple[mujoco.MjModel, Places]:
    """Return a copy of a robot's model with changes, and the elements that change.

    Options are set. Attributes of geoms change on geoms that can touch the ground, and on all geoms of their
    default class. Attributes of equalities change on those with the constants of the equality that opens.
    """
    model = copy.copy(robot.model)
    places: Places = {}
    for name, value in changes.items():
        field = ELEMENT_FIELDS.get(name)
        if name == "jacobian":
            model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
            continue
        if field is None:
            set_option(model.opt, name, value)
            continue
        new = 0.5 * value if name in SHARED else value
        places[name] = []
        for kind, numbers in _elements(robot, name).items():
            prefix = "eq" if kind == "equality" else kind
            array = getattr(model, f"{prefix}_{field}")
            for number in numbers:
                if not np.array_equal(array[number], new):
                    places[name].append((kind, number))
                    array[number] = new
        reached = reached_by_default(robot, name)
        if any(("geom", number) in places[name] for number in reached):
            getattr(model, f"geom_{field}")[reached] = new
    return model, places


def reached_by_default(robot: Robot, name: str) -> list[int]:
    """Return geoms that take an attribute from the model's default class; none without a spec."""
    field, spec = GEOM_FIELDS.get(name), robot.spec
    if field is None or spec is None:
        return []
    default = getattr(spec.default.geom, field)
    return [
        geom.id
        for geom in spec.geoms
        if geom.id >= 0
        and np.array_equal(getattr(geom, field), default)
        and np.array_equal(getattr(geom.classname.geom, field), default)
    ]


def _elements(robot: Robot, name: str) -> dict[str, list[int]]:
    """Return the elements whose attribute changes, by their kind."""
    model = robot.model
    if name in EQUALITY_FIELDS:
        return {"equality": _equalities(robot)}
    geoms = {"geom": _grounded_geoms(robot)}
    if name not in PAIRED:
        return geoms
    ground = robot.pairs.geoms[robot.ground_rows]
    pairs = np.sort(np.column_stack([model.pair_geom1, model.pair_geom2]))
    is_ground = (pairs[:, None] == ground).all(axis=2).any(axis=1)
    return geoms | {"pair": np.flatnonzero(is_ground).tolist()}


def _grounded_geoms(robot: Robot) -> list[int]:
    """Return geoms that can touch the ground, of the ground, of a hand and of its objects, without free balls."""
    is_met = grasping_pairs(robot.model, robot.pairs)
    is_met[robot.ground_rows] = True
    geoms = np.unique(robot.pairs.geoms[is_met])
    grounded: list[int] = geoms[~free_balls(robot.model)[geoms]].tolist()
    return grounded


def _equalities(robot: Robot) -> list[int]:
    """Return equalities with the constants of the one that opens most at rest."""
    place = constraints.finding(robot).place
    if place is None or place[0] != "equality":
        return []
    model = robot.model
    constants = np.column_stack([model.eq_solref, model.eq_solimp])
    alike = (constants == constants[place[1]]).all(axis=1)
    numbers: list[int] = np.flatnonzero(alike).tolist()
    return numbers
