"""Which setting is responsible: planted settings in MuJoCo, and the search itself on responses that are known."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from sanity_cases import CHEETAH

from gauge_envs.backends import backend
from gauge_envs.errors import ParameterError
from gauge_envs.scene import GRAVITY_M_PER_S2
from gauge_envs.tools.sanity import check
from gauge_envs.tools.sanity.cause import alternatives, find_cause
from gauge_envs.tools.sanity.measure import (
    CURVE_SAMPLES,
    Measured,
    Measurements,
    judged,
)
from gauge_envs.tools.sanity.model import TrainingConfiguration, Verdict
from gauge_envs.tools.sanity.phenomena import phenomena
from gauge_envs.tools.sanity.phenomena.rigid import FALLEN_M
from gauge_envs.tools.sanity.scenario import run_scenario

GOOD = {"timestep_s": 0.002, "cone": "elliptic", "impratio": 100.0}
"""A training configuration that leaves the constants of contacts to the backend."""

QUICK = (
    "creep-wood",
    "rest-height",
    "slide-wood",
    "rebound",
    "momentum",
    "carry-wood",
    "seam",
    "point",
)
"""All but a wall of bricks, a hundred seconds of a pendulum, and further materials."""

PLANTS = {
    "timestep_s": (0.01, "rebound"),
    "cone": ("pyramidal", "rebound"),
    "impratio": (0.01, "creep-wood"),
    "iterations": (1, "wall-sag"),
    "integrator": ("RK4", "rebound"),
    "contact_solref": ((0.2, 1.0), "rest-height"),
    "contact_solimp": ((0.0, 0.8, 0.01, 0.5, 2.0), "rest-height"),
    "contact_margin_m": (0.002, "rest-height"),
    "friction_scale": (0.9, "slide-wood"),
}
"""One bad setting each, and a phenomenon in which it must show."""


def report(settings, only=QUICK):
    return check(
        TrainingConfiguration(
            name="planted", source="test", backend="mujoco", settings=settings
        ),
        only=only,
    )


# --- planted in MuJoCo -----------------------------------------------------------------------------------------------


def test_settings_that_need_each_other_are_both_reported():
    # Without refsafe a time constant of 0.002 s is too short for a step of 0.002 s: either of them mends it.
    (row,) = report({**GOOD, "refsafe": False}, only=["creep-wood"]).rows
    assert row.verdict is Verdict.WRONG
    assert "refsafe" in row.cause.line and "timestep_s" in row.cause.line


def test_good_configuration_raises_no_flag():
    found = report(GOOD)
    assert found.flags == {}
    assert found.worst is Verdict.INSIDE
    assert all(row.cause is None for row in found.rows)
    assert {row.experiment for row in found.rows} >= {
        "GAUGE/SlopeSlider-1-wood",
        "GAUGE/NewtonsCradle-metal",
    }
    assert found.versions["mujoco"]


def test_half_cheetah_is_flagged_with_a_cause_each():
    seen = []
    found = check(
        TrainingConfiguration(
            name="HalfCheetah", source="test", backend="mujoco", settings=CHEETAH
        ),
        only=["creep-wood", "rest-height", "rebound", "slide-wood"],
        notify=seen.append,
    )
    assert seen == list(found.rows)
    bad = found.flags
    # Once it has sunk in, the cube slides by Coulomb's law.
    assert set(bad) == {"creep-wood", "rest-height"}
    # One solref without rebound serves all contacts, so that the model does not state what the row depends on.
    rebound = next(row for row in found.rows if row.phenomenon == "rebound")
    assert (
        rebound.advisory and rebound.verdict is Verdict.WRONG and rebound.cause is None
    )
    assert bad["rest-height"].cause is not None and bad[
        "rest-height"
    ].cause.settings == ("contact_solimp",)
    assert all(
        row.cause is not None and row.cause.settings and row.cause.tried
        for row in bad.values()
    )
    creep = bad["creep-wood"]
    assert creep.cause is not None and creep.curve is not None
    tried = {tuple(trial.changes): trial.value for trial in creep.cause.tried}
    assert tried[("cone",)] < 0.2 * creep.configured
    assert len(creep.curve.reality) == len(creep.curve.default) <= CURVE_SAMPLES


def test_a_preset_is_taken_apart_into_its_settings():
    scenario = phenomena(["rebound"])[0].scenario
    names = alternatives(
        Measurements(backend("mujoco")), scenario, {"preset": "out_of_box"}
    )
    assert set(names) >= {"timestep_s", "cone", "contact_solref"}
    assert not {"preset", "drive_interval_s"} & set(names)


def test_what_is_tried_is_documented_or_a_preset_and_can_be_pasted():
    model = {
        "timestep_s": 0.02,
        "cone": "pyramidal",
        "impratio": 1.0,
        "contact_solref": [0.2, 1.0],
        "iterations": 100,
    }
    wall = phenomena(["wall-sag"])[0].scenario
    tried = alternatives(Measurements(backend("mujoco")), wall, model)
    # The documented default and the preset for a wall have the pyramidal cone too; the one for a cube has not.
    assert [(one.value, one.source) for one in tried["cone"]] == [
        ("elliptic", "this package's preset contact")
    ]
    assert [one.value for one in tried["impratio"]] == [10.0]
    assert [(one.value, one.source) for one in tried["contact_solref"]] == [
        ((0.02, 1.0), "the engine's documented default"),
        ((0.04, 1.0), "this package's preset contact"),
    ]
    # No training affords the steps of presets for closed forms.
    assert [one.value for one in tried["timestep_s"]] == [0.002]
    halved = alternatives(Measurements(backend("mujoco")), wall, {"timestep_s": 0.002})
    assert [one.value for one in halved["timestep_s"]] == [0.001, 0.0005]
    assert "iterations" not in tried
    for one in (one for several in tried.values() for one in several):
        assert one.value is not None and one.value != one.was


def test_refused_settings_are_the_users_error():
    with pytest.raises(ParameterError, match="colour"):
        report({"colour": "red"}, only=["creep-wood", "rebound"])


def test_divergence_is_a_row():
    loose = {"timestep_s": 0.01, "contact_solref": (0.002, 1.0), "refsafe": False}
    loose["contact_solimp"] = CHEETAH["contact_solimp"]
    (row,) = report(loose, only=["creep-wood"]).rows
    assert (row.verdict, row.configured) == (Verdict.WRONG, None)
    assert row.remark.startswith("diverged")
    assert row.cause.settings
    assert row.curve.configured == ()


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANTS)
def test_planted_setting_is_found_in_every_flagged_row(name):
    """It is the cause, or is named among the settings that suffice, where it is not the default of the scene."""
    bad = report({**GOOD, name: PLANTS[name][0]}, only=()).flags
    assert PLANTS[name][1] in bad
    causes = {
        phenomenon: row.cause
        for phenomenon, row in bad.items()
        if row.cause is not None
    }
    assert set(causes) == set(bad)
    differs = {
        p: cause
        for p, cause in causes.items()
        if any(name in trial.changes for trial in cause.tried)
    }
    assert {
        p: cause.line for p, cause in differs.items() if name not in cause.line
    } == {}


@pytest.mark.slow
def test_good_configuration_raises_no_flag_anywhere():
    assert report(GOOD, only=()).flags == {}


def test_a_wall_that_has_fallen_is_simulated_no_longer():
    wall, drift = phenomena(["wall-sag", "wall-drift"])
    soft = {
        "timestep_s": 0.002,
        "contact_solref": (0.02, 1.0),
        "contact_solimp": (0.015, 1.0, 0.031, 0.5, 2.0),
    }
    found = Measurements(backend("mujoco")).measure(wall, soft)
    assert found.verdict is Verdict.WRONG and found.value > 1e3 * FALLEN_M
    # It sinks without leaving its plane, and has no place from which bricks could drift.
    drifted = judged(drift, found.rollout)
    assert drifted.verdict is Verdict.WRONG
    assert "the wall falls" in drifted.remark and "the run ends" in drifted.remark
    # No brick sinks faster than it falls.
    fall_s = math.sqrt(2.0 * FALLEN_M / GRAVITY_M_PER_S2)
    assert fall_s < found.rollout.times_s[-1] < 0.5 * wall.scenario.seconds


@pytest.mark.parametrize(
    ("name", "rests"), [("rest-height", True), ("slide-wood", False)]
)
def test_a_scene_in_which_nothing_moves_any_more_ends(name, rests):
    (scenario,) = (one.scenario for one in phenomena([name]))
    ending = replace(scenario, rest_m_per_s=1e-3)
    whole, ended = (
        run_scenario(backend("mujoco"), one, {}) for one in (scenario, ending)
    )
    count = len(ended.times_s)
    assert (count < len(whole.times_s)) is rests
    np.testing.assert_array_equal(
        ended.position("cube"), whole.position("cube")[:count]
    )
    left_m = ended.position("cube")[-1] - whole.position("cube")[-1]
    assert np.abs(left_m).max() < 1e-3 * whole.times_s[-1]


# --- the search ------------------------------------------------------------------------------------------------------


class Made(Measurements):
    """Measurements whose values follow a formula of five switches, 0 by default; reality is 0 +- 1."""

    def __init__(self, formula):
        super().__init__(backend("mujoco"))
        self._formula = formula

    def in_force(self, scenario, settings):
        return dict.fromkeys("abcde", 0) | dict(settings)

    def measure(self, phenomenon, settings):
        value = self._formula(**self.in_force(None, settings))
        if math.isinf(value):
            return Measured(
                value=None,
                deviation=math.inf,
                verdict=Verdict.WRONG,
                remark="diverged: far",
            )
        verdict = (
            Verdict.INSIDE
            if abs(value) <= 2.0
            else Verdict.VISIBLE
            if abs(value) <= 5.0
            else Verdict.WRONG
        )
        return Measured(value=value, deviation=0.5 * abs(value), verdict=verdict)


def cause_of(formula, *, row="creep-wood", **settings):
    made = Made(formula)
    (phenomenon,) = phenomena([row])
    both = made.measure(None, settings), made.measure(None, {})
    return find_cause(made, phenomenon, settings, *both)


@pytest.mark.parametrize(
    ("row", "tried"), [("creep-wood", "abcde"), ("wall-drift", "abc")]
)
def test_a_scene_of_many_bodies_is_run_until_a_setting_mends_it(row, tried):
    cause = cause_of(
        lambda a, b, c, d, e: 20.0 * c + d,
        row=row,
        **dict.fromkeys("abcde", 1),
    )
    assert cause.settings == ("c",)
    assert [*"".join(name for one in cause.tried for name in one.changes)] == [*tried]


@pytest.mark.slow
def test_a_change_that_mends_other_rows_explains_a_scene_of_many_bodies():
    """The wall runs as it is, with the preset, and with that change; no setting of it is put back."""
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="100"/>
        <default><geom solref="0.02 1" solimp="0 0.8 0.01 0.5 2"/></default>
        <worldbody><geom type="plane" size="1 1 1"/><body pos="0 0 0.1"><freejoint/><geom size="0.1"/></body>
        </worldbody></mujoco>"""
    )
    report = check(model, only=["point", "wall-sag"])
    point, wall = report.rows
    assert point.is_flag and point.cause.tried
    assert wall.is_flag and not wall.cause.tried
    assert wall.cause.line.startswith("the first line brings sag from 20.7 mm to ")
    assert set(wall.cause.settings) == set(report.cure.changes)


def test_nothing_is_responsible_for_what_is_right():
    assert cause_of(lambda a, b, c, d, e: 1.5 * a, a=1, b=1) is None


def test_the_closest_single_setting_is_responsible_and_others_are_reported():
    cause = cause_of(
        lambda a, b, c, d, e: 20.0 * a * b + 0.5 * c - 0.4 * b, a=1, b=1, c=1
    )
    assert cause.settings == ("a",)
    assert cause.line == (
        "a = 0 instead of 1 brings creep from 20.1 mm/s to 0.1 mm/s (b = 0 alone to 0.5 mm/s); "
        "from the engine's documented default"
    )
    assert [trial.changes for trial in cause.tried if not trial.on_default] == [
        {"a": 0},
        {"b": 0},
        {"c": 0},
    ]


def test_within_the_scatter_what_harms_the_default_is_responsible():
    # With b put back it comes closest, as c takes back what a alone does; but a harms alone, and b does not.
    cause = cause_of(
        lambda a, b, c, d, e: 7.0 * a * b + a * (1 - b) * (1.5 - 1.4 * c) + c * (1 - a),
        a=1,
        b=1,
        c=1,
    )
    assert cause.settings == ("a",)
    assert "from 7 mm/s to 1 mm/s (b = 0 alone to 0.1 mm/s)" in cause.line


def test_half_the_error_is_enough():
    cause = cause_of(lambda a, b, c, d, e: 20.0 * a + 10.0 * b, a=1, b=1)
    assert cause.settings == ("a",)
    assert "from 30 mm/s to 10 mm/s;" in cause.line


def test_what_no_setting_alone_explains_is_left_to_the_cure():
    # Any two of three suffice, so that putting one back leaves the error, and none has it alone.
    cause = cause_of(lambda **on: 30.0 * (sum(on.values()) >= 2), a=1, b=1, c=1)
    assert cause.settings == ()
    assert cause.line == "no reset of one explains it: a, b, c"


def test_what_the_default_gets_wrong_too():
    cause = cause_of(lambda a, b, c, d, e: 10.0 + a, a=1)
    assert cause.settings == ()
    assert cause.line == "no setting alone explains it; this package's preset: 10 mm/s"


def test_what_ends_a_divergence_is_responsible():
    cause = cause_of(lambda a, b, c, d, e: math.inf if a else 1.0 + b, a=1, b=1)
    assert cause.settings == ("a",)
    assert "from diverged: far to 2 mm/s" in cause.line
