"""Newton: models and solvers in this process, as its solver runs them.

`SolverMuJoCo` compiles a `mujoco.MjModel` with the options and contact constants in force: arguments of the solver,
attributes of an imported file, and `ke` and `kd` of the shapes. That model is read, and judged on this package's Newton
backend, which runs the same solver. Changes are Python: `SolverMuJoCo(model, iterations=100)`,
`ShapeConfig(ke=2500, kd=100)`.
"""

import copy
import warnings
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any

import mujoco
import numpy as np

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity.gauge_probe import is_of
from gauge_envs.tools.sanity.model import (
    CapacityLimits,
    ContactCapacity,
    Settings,
    TrainingConfiguration,
)
from gauge_envs.tools.sanity.robot.contact_capacity import contact_capacity
from gauge_envs.tools.sanity.robot.mujoco_model import mujoco_configuration
from gauge_envs.tools.sanity.scenario import check_settings
from gauge_envs.tools.sanity.stacks.dialect import (
    Dialect,
    Kind,
    Place,
    Setting,
    python_text,
    rounded,
)
from gauge_envs.tools.sanity.stacks.reader import GeomPair, Reader

JUDGED = "SolverMuJoCo"
"""Solver of rigid bodies that this package's Newton backend runs."""

INTEGRATORS = ("euler", "rk4", "implicitfast")
"""Integrators that this package's Newton backend runs."""

CONTACT = ("contact_solref", "contact_solimp")
"""Contact constants of a MuJoCo model that the Newton backend has."""

FORCE_SPACE = 0
"""Newton's code for a shape whose stiffness is a force, so that its contacts depend on the masses."""


def stiffness_and_damping(solref: tuple[float, float]) -> tuple[float, float] | None:
    """Return `ke` and `kd` of shapes for which Newton computes a solref; None for a solref in the direct format.

    Newton computes the time constant 2 / kd and the damping ratio kd / (2 sqrt(ke)).
    """
    time_constant, ratio = solref
    if time_constant <= 0.0 or ratio <= 0.0:
        return None
    damping = 2.0 / time_constant
    return (0.5 * damping / ratio) ** 2, damping


def _shape_text(solref: Any) -> str:
    found = stiffness_and_damping(solref)
    return (
        f"solref={python_text(solref)}"
        if found is None
        else f"ke={found[0]:.6g}, kd={found[1]:.6g}"
    )


@dataclass(frozen=True, kw_only=True)
class Newton(Dialect):
    """Python, in which a solref in the direct format is an attribute of the model."""

    def setting(self, name: str, value: Any) -> Setting:
        """Return where a setting with a value stands."""
        known = super().setting(name, value)
        is_direct = (
            name == "contact_solref"
            and value is not None
            and stiffness_and_damping(value) is None
        )
        return replace(known, place="direct") if is_direct else known


NEWTON = Newton(
    name="newton",
    settings=(
        # Keys of these settings are also those of a MuJoCo model that the solver compiles.
        Setting("integrator", "solver", "integrator"),
        Setting("cone", "solver", "cone"),
        Setting("impratio", "solver", "impratio"),
        Setting("iterations", "solver", "iterations"),
        Setting("line_search_iterations", "solver", "ls_iterations"),
        Setting("tolerance", "solver", "tolerance"),
        Setting("mujoco_contacts", "solver", "use_mujoco_contacts"),
        Setting("njmax", "solver", "njmax"),
        Setting("naconmax", "solver", "nconmax"),
        Setting("contact_solref", "shape", "solref", Kind(text=_shape_text), "{value}"),
        Setting("contact_kf_n_s_per_m", "shape", "kf"),
        Setting("contact_solimp", "attribute", "geom_solimp"),
        Setting("timestep_s", "step", "dt"),
    ),
    places={
        "solver": Place(form="SolverMuJoCo(model, {})"),
        "shape": Place(form="ShapeConfig({})", has_geoms=True),
        "direct": Place(form="model.mujoco.{}", has_geoms=True),
        "attribute": Place(form="model.mujoco.{}", is_alone=True),
        "step": Place(form="solver.step(..., {})", is_alone=True),
    },
    gravity="model.set_gravity(({}))",
)


def is_newton(target: Any) -> bool:
    """Return whether an object is a model or a solver of Newton; newton is not imported."""
    return is_of(target, "newton", "Model") or is_of(target, "newton", "SolverBase")


def newton_configuration(
    target: Any,
    *,
    step_s: float | None = None,
    name: str = "",
    pair: GeomPair | None = None,
) -> TrainingConfiguration:
    """Return the configuration of a solver of Newton.

    Args:
        target: A `newton.solvers.SolverMuJoCo`, or a `newton.Model`, for which one is made with Newton's defaults.
        step_s: Time step that `solver.step` gets as `dt` [s]. Without it, the step of a solver that has run is read.
            Otherwise this package's step for each scene is used.
        name: Name of the configuration; the name of the class if empty.
        pair: Names of two shapes whose constants the experiments get, instead of all sets on ground.
    """
    solver = target if hasattr(target, "model") else _default_solver(target)
    kind = type(solver).__name__
    if not is_of(solver, "newton", JUDGED):
        raise TargetError(f"{kind}: rigid bodies are judged with {JUDGED} only")
    given = "" if solver is target else ", with the defaults of SolverMuJoCo"
    source = f"{type(target).__name__} of Newton {version('newton')}{given}"
    model = _compiled(solver)
    read = mujoco_configuration(
        model, name=name or kind, source=source, pair=pair, has_robot=False
    )
    contact = _contact(solver, read.settings)
    settings = _options(solver, read.settings, step_s) | contact
    check_settings("newton", settings)
    used = (group.geoms for group in read.contact_groups if group.is_used)
    origins = dict.fromkeys(settings, f"arguments of {kind}")
    origins |= dict.fromkeys(contact, next(used, "Newton's defaults: nothing collides"))
    if "timestep_s" in settings:
        origins["timestep_s"] = f"dt of {kind}.step"
    return replace(
        read,
        backend="newton",
        settings=settings,
        origins=origins,
        contact_groups=tuple(
            replace(one, settings=_contact(solver, one.settings))
            for one in read.contact_groups
        ),
        notes=(*_notes(solver, settings), *read.notes),
        is_model=False,
        language=NEWTON.name,
        capacity=_capacity(solver, model, settings),
    )


def _default_solver(model: Any) -> Any:
    """Return the solver that Newton makes of a model without further arguments."""
    from newton.solvers import SolverMuJoCo

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return SolverMuJoCo(model)
        # Newton raises errors of several kinds for models that this solver cannot run.
        except Exception as error:
            reason = " ".join(str(error).split())
            raise TargetError(
                f"newton.Model: {JUDGED} cannot be made of it: {reason}; give a solver instead"
            ) from error


def _compiled(solver: Any) -> mujoco.MjModel:
    """Return a copy of the solver's model with the constants of shapes that it runs with."""
    model = copy.copy(solver.mj_model)
    batched = getattr(solver, "mjw_model", None)
    if batched is not None:
        for name in ("geom_solref", "geom_solimp", "geom_friction"):
            getattr(model, name)[:] = getattr(batched, name).numpy()[0]
    # A gap is only the distance at which contacts are found.
    model.geom_gap[:] = 0.0
    return model


def _options(solver: Any, read: Settings, step_s: float | None) -> dict[str, Any]:
    """Return the settings of the Newton backend for the options of a solver."""
    kind = type(solver).__name__
    known = (
        one for one in NEWTON.settings if one.place == "solver" and one.key in read
    )
    settings = {one.name: rounded(read[one.key]) for one in known}
    settings["integrator"] = settings["integrator"].lower()
    # MuJoCo Warp raises smaller ones.
    settings["tolerance"] = max(settings["tolerance"], 1e-6)
    settings["mujoco_contacts"] = bool(getattr(solver, "_use_mujoco_contacts", True))
    if step_s is not None:
        settings["timestep_s"] = step_s
    elif getattr(solver, "_step", 0) and getattr(solver, "mjw_model", None) is not None:
        settings["timestep_s"] = rounded(
            float(solver.mjw_model.opt.timestep.numpy()[0])
        )
    if read["solver"] != "Newton":
        raise TargetError(
            f"{kind}: solver {read['solver']} is not run, use solver='newton'"
        )
    if settings["integrator"] not in INTEGRATORS:
        raise TargetError(
            f"{kind}: integrator {settings['integrator']} is not run, use 'implicitfast' or 'euler'"
        )
    return settings


def _contact(solver: Any, read: Settings) -> dict[str, Any]:
    """Return the contact constants of the Newton backend for those of a pair of shapes."""
    settings = {
        name: tuple(map(rounded, read[name]))
        for name in CONTACT
        if read.get(name) is not None
    }
    # Newton applies the gain to its own contacts, with the elliptic cone.
    if not getattr(solver, "_use_mujoco_contacts", True) and solver.model.shape_count:
        settings["contact_kf_n_s_per_m"] = rounded(
            float(solver.model.shape_material_kf.numpy().max())
        )
    return settings


def _capacity(
    solver: Any, model: mujoco.MjModel, settings: Settings
) -> ContactCapacity | None:
    """Return the limits of the solver's memory for the contacts of a world; None for MuJoCo's C engine."""
    data = getattr(solver, "mjw_data", None)
    if getattr(solver, "use_mujoco_cpu", False) or data is None:
        return None
    limits = CapacityLimits(
        njmax=int(data.njmax),
        naconmax=int(data.naconmax) // max(1, int(data.nworld)),
        worlds=1,
    )
    if not settings["mujoco_contacts"]:
        reason = "Newton finds other contacts than MuJoCo, by which they are counted; see ObservableKind.OVERFLOW"
        return ContactCapacity(limits=limits, reason=reason)
    model.opt.timestep = settings.get("timestep_s", model.opt.timestep)
    return contact_capacity(model, limits)


def _notes(solver: Any, settings: Settings) -> list[str]:
    model, notes = solver.model, []
    if "timestep_s" not in settings:
        notes.append(
            "the step is not known before the solver runs: each scene has this package's step; give step_s"
        )
    if getattr(solver, "use_mujoco_cpu", False):
        notes.append(
            "the solver runs MuJoCo's C engine; the check runs MuJoCo Warp with the same options"
        )
    modes = getattr(getattr(model, "mujoco", None), "solref_mode", None)
    in_force = 0 if modes is None else int((modes.numpy() == FORCE_SPACE).sum())
    if in_force:
        notes.append(
            f"ke and kd of {in_force} shapes are forces, and depend on the masses; they are judged as if not"
        )
    if (
        "contact_kf_n_s_per_m" in settings
        and len(np.unique(model.shape_material_kf.numpy())) > 1
    ):
        notes.append("shapes have several friction gains kf; the largest is judged")
    if model.shape_count and model.shape_margin.numpy().any():
        notes.append("margins of shapes are not carried over")
    return notes


DIALECTS = (NEWTON,)

READERS = (
    Reader(
        "a newton.Model or a SolverMuJoCo of Newton",
        is_newton,
        lambda target, pair: newton_configuration(target, pair=pair),
    ),
)
