"""A reference scores a scene only if all that differs from its own is what it allows: each field is changed once."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass, replace
from enum import Enum

import pytest
from places import first_of_each_kind

from gauge_envs import load_experiment, reference_band, variants
from gauge_envs.errors import ParameterError
from gauge_envs.experiments.variants import beyond_variants
from gauge_envs.files import data_folder
from gauge_envs.scene import Air, Motion, Scene
from gauge_envs.scene.diff import scene_changes
from gauge_envs.scene.states import nominal_states, scene_at
from gauge_envs.scoring.reference import REAL_ALLOWS, refusal

CONSTANTS = {
    "mass_kg",
    "inertia_kg_m2",
    "areal_density_kg_per_m2",
    "thickness_m",
    "stretch_stiffness_n_per_m",
    "shear_stiffness_n_per_m",
    "bend_stiffness_n_m_per_rad",
    "young_modulus_pa",
    "poisson_ratio",
    "friction",
    "restitution",
    "mode",
    "torsion_m",
    "rolling_m",
    "density_kg_per_m3",
    "normal_coefficient",
    "tangential_coefficient",
    "lift_coefficient",
}
"""Constants of materials, contacts and air, in which an engine's user may correct the published scene."""

WITHOUT_EFFECT = {"provenance", "residual_rate"}
"""Fields that move nothing while actions are zero."""

START = {"pose", "linear_velocity_m_per_s", "angular_velocity_rad_per_s"}

NAMES = [variant.name for variant in (*variants(), *beyond_variants())]


def other_values(value):
    """Yield values that differ from a value of a field; one of them may be impossible there."""
    if isinstance(value, bool):
        yield not value
    elif isinstance(value, Enum):
        yield from (member for member in type(value) if member is not value)
    elif isinstance(value, int):
        yield value + 1
    elif isinstance(value, float):
        yield value * 1.25 + 1e-3
        yield value * 0.9
    elif isinstance(value, str):
        yield f"{value}-other"
        yield from ("y", "low", "high", "rotate", "translate")
    elif value is None:
        yield 0.25
    elif isinstance(value, tuple):
        yield from other_tuples(value)


def other_tuples(values):
    """Yield a tuple with its last entry changed, without it, and, as an axis or a quaternion, turned by 0.01 rad."""
    if not values:
        return
    *first, last = values
    for other in other_values(last):
        yield (*first, other)
    yield tuple(first)
    if all(isinstance(value, float) for value in values):
        a, b = values[0], values[-1]
        sine, cosine = math.sin(0.01), math.cos(0.01)
        yield (cosine * a - sine * b, *values[1:-1], sine * a + cosine * b)


def changed_scenes(value, path=()):
    """Yield path and changed copy for each field below a dataclass, with the first possible other value."""
    for field in fields(value):
        if not field.compare or not field.init:
            continue
        inner, name = getattr(value, field.name), (*path, field.name)
        if is_dataclass(inner):
            candidates = changed_scenes(inner, name)
        elif isinstance(inner, tuple) and inner and is_dataclass(inner[0]):
            candidates = changed_entries(inner, name)
        elif field.name == "air":
            candidates = [(name, Air(density_kg_per_m3=1.2, normal_coefficient=1.0))]
        else:
            candidates = ((name, other) for other in other_values(inner))
        changed_paths = set()
        for changed_path, other in candidates:
            if changed_path in changed_paths:
                continue
            try:
                changed = replace(value, **{field.name: other})
            except (ValueError, KeyError, TypeError, AttributeError):
                continue
            changed_paths.add(changed_path)
            yield changed_path, changed


def changed_entries(entries, path):
    """Yield path and changed copy of a tuple of dataclasses: without its last entry, and with each field changed."""
    yield (*path, "removed"), entries[:-1]
    for number in {0, len(entries) - 1}:
        for changed_path, other in changed_scenes(entries[number], path):
            yield changed_path, (*entries[:number], other, *entries[number + 1 :])


def edited(experiment, scene):
    return replace(experiment, scene=scene, parameters="custom")


def is_allowed(band, path):
    """Whether a reference allows a change of a field, as docs/scores.md says."""
    if WITHOUT_EFFECT & set(path):
        return True
    return not band.kind.is_solution and (path[-1] in CONSTANTS or path == ("air",))


@pytest.fixture(scope="module", params=first_of_each_kind(NAMES))
def scored(request):
    """An experiment and its reference."""
    experiment = load_experiment(request.param)
    band = reference_band(experiment)
    if band is None:
        pytest.skip("no reference")
    return experiment, band


def test_a_changed_field_is_a_constant_that_the_reference_allows_or_refuses_the_score(
    scored,
):
    experiment, band = scored
    seen = set()
    for path, scene in changed_scenes(experiment.scene):
        if not START & set(path) and list(scene_changes(experiment.scene, scene)):
            reason = refusal(edited(experiment, scene), band)
            assert (reason is None) == is_allowed(band, path), (path, reason)
            seen.add(path[0])
    groups = {
        field.name for field in fields(Scene) if getattr(experiment.scene, field.name)
    }
    assert groups <= seen


def test_real_trials_allow_a_start_within_30_mm_and_a_solution_allows_none(scored):
    experiment, band = scored
    nominal = nominal_states(experiment.scene)
    for row, body in enumerate(experiment.scene.bodies):
        if body.motion is Motion.KINEMATIC:
            continue
        for shift_m, speed_m_per_s in ((0.02, 0.0), (0.04, 0.0), (0.0, 0.1)):
            states = nominal.copy()
            states[row, 0] += shift_m
            states[row, 7] += speed_m_per_s
            try:
                moved = scene_at(experiment.scene, states)
            except ParameterError:
                # The velocity of a hinged body rotates it about its hinge.
                continue
            if moved == experiment.scene:
                # A fixed body stays.
                continue
            is_near = not band.kind.is_solution and shift_m < 0.03 and not speed_m_per_s
            reason = refusal(edited(experiment, moved), band)
            assert (reason is None) == is_near, (body.name, shift_m, reason)


@pytest.mark.parametrize(
    ("gravity_m_per_s2", "is_scored"),
    [(9.81, True), (1.01 * 9.80665, False), (0.99 * 9.80665, False), (1.62, False)],
)
def test_every_reference_allows_a_rounded_gravity_and_no_other(
    scored, gravity_m_per_s2, is_scored
):
    experiment, band = scored
    scene = replace(experiment.scene, gravity_m_per_s2=gravity_m_per_s2)
    reason = refusal(edited(experiment, scene), band)
    assert (reason is None) == is_scored, reason


def test_the_default_gravity_of_mujoco_in_a_model_file_is_scored(tmp_path):
    text = (data_folder("assets") / "mjcf" / "Pendulum-metal.xml").read_text()
    standard = "0 0 -9.80665"
    assert standard in text
    reasons = []
    for gravity in ("0 0 -9.81", "0 0 -9.7", "1 0 -9.81"):
        file = tmp_path / "model.xml"
        file.write_text(text.replace(standard, gravity))
        experiment = load_experiment("Pendulum-metal", asset=file)
        reasons.append(refusal(experiment, reference_band(experiment)))
    assert reasons[0] is None
    assert all("gravity" in reason for reason in reasons[1:])


def test_real_trials_allow_still_air_and_no_wind():
    cloth = load_experiment("TextileFlinging-satin", "air").scene
    for wind_m_per_s, is_scored in (((0.0, 0.0, 0.0), True), ((0.0, 1.0, 0.0), False)):
        air = replace(cloth.air, wind_m_per_s=wind_m_per_s)
        changes = [*scene_changes(replace(cloth, air=None), replace(cloth, air=air))]
        assert all(change.kind in REAL_ALLOWS for change in changes) == is_scored
