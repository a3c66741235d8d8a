"""Uncertain inputs of an experiment as parameters: constants, masses and starts, each with its source."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from gauge_envs.experiments.experiment import TaskExperiment
from gauge_envs.experiments.scene_builder import SceneBuilder
from gauge_envs.experiments.variants import task_path
from gauge_envs.references.sensitivities import ConstantUncertainty, input_uncertainties
from gauge_envs.scene import ContactMode, Motion, RigidBody, Sphere, Vector
from gauge_envs.scene.geometry import FloatArray

MASS_STEP_KG = 1e-4
"""Masses are published to 0.1 g."""

AXES = "xyz"


@dataclass(frozen=True, kw_only=True)
class UncertainParameter:
    """One constant of an experiment, or one coordinate of a start, that is known up to a standard uncertainty.

    Attributes:
        name: Name for tables, as `cube.friction` or `cube.position_m along its x axis`.
        key: Key of the override, as `cube.friction`.
        value: Calibrated value; for a start the position [m].
        std: Standard uncertainty.
        unit: Unit of `value` and `std`; `1` for a ratio.
        source: Origin of `std`.
        direction: Unit vector in the world along which a start moves; None for a constant.
        low: Smallest physical value.
        high: Largest physical value.
    """

    name: str
    key: str
    value: float | Vector
    std: float
    unit: str
    source: str
    direction: Vector | None = None
    low: float = 0.0
    high: float = math.inf

    def at(self, sigmas: float) -> float:
        """Return the value that many standard uncertainties from the calibrated one; for a start the displacement [m].

        It is clipped to the physical values.
        """
        if isinstance(self.value, tuple):
            return sigmas * self.std
        return min(max(self.value + sigmas * self.std, self.low), self.high)


def overrides_at(
    parameters: Sequence[UncertainParameter], sigmas: Sequence[float]
) -> dict[str, Any]:
    """Return overrides that move parameters by so many standard uncertainties.

    Args:
        parameters: The parameters.
        sigmas: Number of standard uncertainties for each.
    """
    overrides: dict[str, Any] = {}
    for parameter, number in zip(parameters, sigmas, strict=True):
        if parameter.direction is None:
            overrides[parameter.key] = parameter.at(number)
        else:
            start = np.asarray(overrides.get(parameter.key, parameter.value))
            overrides[parameter.key] = tuple(
                (
                    start + parameter.at(number) * np.asarray(parameter.direction)
                ).tolist()
            )
    return overrides


def uncertain_parameters(experiment: TaskExperiment) -> tuple[UncertainParameter, ...]:
    """Return the uncertain inputs of an experiment that overrides can state.

    They are friction, restitution where bodies collide, and constants of joints, from `scoring/uncertainties.toml`; the
    masses of rigid dynamic bodies, as published to 0.1 g; and the start of recorded bodies without joints, unless it is
    that of a trial, from the same file. A cube moves in the plane of the face that it rests on, a ball in all
    coordinates.

    Args:
        experiment: The experiment; a variant of the package, with the scene of its task file.
    """
    builder = SceneBuilder(
        task_path(experiment.variant.family),
        experiment.spec,
        experiment.variant,
        experiment.overrides,
    )
    return (
        *_contacts(builder, experiment.variant.material),
        *_joints(builder, experiment.variant.material),
        *_masses(builder, experiment),
        *_starts(builder, experiment),
    )


def _constant(
    owner: str,
    constant: str,
    value: float,
    entry: ConstantUncertainty,
    material: str | None,
    high: float = math.inf,
) -> UncertainParameter:
    return UncertainParameter(
        name=f"{owner}.{constant}",
        key=f"{owner}.{constant}",
        value=value,
        std=entry.std(value, material),
        unit=entry.unit,
        source=f"scoring/uncertainties.toml: {entry.source}",
        high=high,
    )


def _joints(
    builder: SceneBuilder, material: str | None
) -> Iterator[UncertainParameter]:
    for owner, constants in builder.constants.items():
        for constant, entry in input_uncertainties().joint.items():
            if value := constants.get(constant):
                entry_name = f"{material} {owner}"
                yield _constant(
                    owner,
                    constant,
                    float(value),
                    entry,
                    entry_name if entry_name in entry.relative else material,
                )


def _contacts(
    builder: SceneBuilder, material: str | None
) -> Iterator[UncertainParameter]:
    for constant in ("friction", "restitution"):
        entry = getattr(input_uncertainties(), constant)
        owners = dict.fromkeys(
            contact.constants_of
            for contact in builder.contacts
            if contact.constants_of
            and getattr(contact, constant) is None
            and (constant == "friction" or contact.mode is ContactMode.IMPACT)
        )
        for owner in owners:
            value = builder.constants.get(owner, {}).get(constant)
            if value:
                high = 1.0 if constant == "restitution" else math.inf
                yield _constant(owner, constant, float(value), entry, material, high)


def _masses(
    builder: SceneBuilder, experiment: TaskExperiment
) -> Iterator[UncertainParameter]:
    movable = {
        builder.spec_name(body.name)
        for body in experiment.scene.bodies
        if body.motion is Motion.DYNAMIC
    }
    for name in (name for name in builder.present if name in movable):
        mass_kg = float(builder.constants.get(name, {}).get("mass_kg") or 0.0)
        # A mass that is not a multiple of the published step is an override, whose uncertainty is unknown.
        if mass_kg > 0.0 and math.isclose(
            mass_kg, MASS_STEP_KG * round(mass_kg / MASS_STEP_KG), rel_tol=1e-9
        ):
            yield UncertainParameter(
                name=f"{name}.mass_kg",
                key=f"{name}.mass_kg",
                value=mass_kg,
                std=MASS_STEP_KG / math.sqrt(12.0),
                unit="kg",
                source="rounding: the mass is published to 0.1 g (tasks/*.toml, constants)",
                low=MASS_STEP_KG,
            )


def _starts(
    builder: SceneBuilder, experiment: TaskExperiment
) -> Iterator[UncertainParameter]:
    entry = input_uncertainties().start
    # A recorded start has a velocity too.
    if experiment.scene.joints or experiment.trial is not None:
        return
    for name in experiment.recorded:
        body = experiment.scene.body(name)
        placement = builder.placements.get(name)
        if (
            body.motion is not Motion.DYNAMIC
            or placement is None
            or placement.position_m is None
        ):
            continue
        for axis, direction in free_directions([body]):
            x, y, z = direction.tolist()
            yield UncertainParameter(
                name=f"{name}.position_m along {axis}",
                key=f"{name}.position_m",
                value=placement.position_m,
                std=entry.std,
                unit=entry.unit,
                source=f"scoring/uncertainties.toml: {entry.source}",
                direction=(x, y, z),
            )


def free_directions(bodies: Sequence[RigidBody]) -> Iterator[tuple[str, FloatArray]]:
    """Yield directions in which bodies may start elsewhere together, so that none starts inside another."""
    if all(isinstance(body.shape, Sphere) for body in bodies):
        yield from zip(AXES, np.eye(3), strict=True)
        return
    axes = bodies[0].pose.matrix.T
    normal = int(np.abs(axes[:, 2]).argmax())
    for number, axis in enumerate(axes):
        if number != normal:
            yield f"its {AXES[number]} axis", axis
