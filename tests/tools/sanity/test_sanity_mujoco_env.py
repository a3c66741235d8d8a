"""Environments of MuJoCo Playground and of mjlab: in this process, and from their probe files."""

import mujoco
import pytest
from mujoco_stacks import (
    DOG,
    CollisionCfg,
    MujocoCfg,
    SimulationCfg,
    install_mjlab,
    mjlab_task,
    playground_env,
)
from sanity_cases import read_text

from gauge_envs.errors import TargetError
from gauge_envs.tools.sanity import check, configuration, gauge_probe as program
from gauge_envs.tools.sanity.model import CapacityLimits
from gauge_envs.tools.sanity.robot.contact_capacity import contact_capacity


def probe_file(target, folder):
    path = folder / "target.gaugeprobe.json"
    program.save(target, str(path), "target")
    return path


def test_an_env_of_playground_is_read_with_its_limits(approved):
    """The floor has priority, so the solimp of the feet does not count."""
    read = configuration(
        playground_env(impl="warp", njmax=40, naconmax=2048, action_scale=0.5)
    )
    approved("sanity/read_playground", read_text(read))
    assert read.capacity.limits == CapacityLimits(njmax=40, naconmax=2048)
    assert (read.is_model, read.robot.action_rad) == (True, 0.5)


def test_the_probe_file_of_playground_has_the_same_rows_and_words(tmp_path):
    env = playground_env(impl="warp", njmax=40)
    direct, saved = configuration(env), configuration(probe_file(env, tmp_path))
    assert (saved.settings, saved.contact_groups) == (
        direct.settings,
        direct.contact_groups,
    )
    assert (saved.language, saved.trains_on, saved.frame_skip) == (
        direct.language,
        direct.trains_on,
        direct.frame_skip,
    )
    rows = [
        check(read, only=["slide-wood"], explain=False).rows[0]
        for read in (direct, saved)
    ]
    assert rows[0].to_dict() == rows[1].to_dict()
    assert rows[0].verdict.value == "wrong"


def test_too_few_constraint_rows_are_wrong_and_named():
    report = check(playground_env(impl="warp", njmax=12), only=["contact-capacity"])
    row = report.rows[0]
    # Four feet with four rows each.
    assert (row.configured, row.verdict.value, report.worst.value) == (
        4.0,
        "wrong",
        "wrong",
    )
    assert row.cause.settings == ("njmax",)
    assert row.cause.line.startswith(
        'config_overrides={"njmax": 20}: its model needs 16 constraint rows in a motion'
    )
    assert (
        report.cure is not None
        and report.cure.line == 'config_overrides={"njmax": 20}: the one flag goes'
    )
    fits = check(playground_env(impl="warp", njmax=40), only=["contact-capacity"]).rows[
        0
    ]
    assert (fits.configured, fits.verdict.value) == (0.0, "inside")
    assert "needs 16 constraint rows" in fits.remark and "njmax is 40" in fits.remark


def test_implementations_without_limits_have_no_such_row():
    read = configuration(playground_env(impl="jax"))
    assert (read.capacity, read.trains_on) == (None, "")
    assert (
        check(read, only=["contact-capacity", "gravity"]).rows[0].phenomenon
        == "gravity"
    )
    row = check("mujoco", only=["contact-capacity"]).rows[0]
    assert (row.verdict.value, row.remark) == (
        "declined",
        "the target states no limit of its memory for contacts",
    )


def test_contacts_of_all_worlds_are_judged_by_their_mean():
    model = mujoco.MjModel.from_xml_string(DOG.format(step=0.004))
    need = contact_capacity(model, CapacityLimits(njmax=None, naconmax=8, worlds=4))
    assert need.need.contacts == 4
    assert need.missing_rows == 0
    assert need.missing_contacts == pytest.approx(need.need.mean_contacts - 2.0)
    enough = contact_capacity(model, CapacityLimits(naconmax=16, worlds=4))
    assert enough.missing_contacts == 0.0
    assert contact_capacity(model, CapacityLimits()).need is None


def test_height_fields_are_not_counted():
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><asset><hfield name="h" nrow="2" ncol="2" size="1 1 1 1" elevation="0 0 0 0"/></asset>
        <worldbody><geom type="hfield" hfield="h"/><body pos="0 0 1"><freejoint/><geom size=".1"/></body></worldbody>
        </mujoco>"""
    )
    assert "height field" in contact_capacity(model, CapacityLimits(njmax=1)).reason


def test_an_env_without_a_model_is_refused():
    with pytest.raises(
        TargetError, match="Walk holds no compiled model: give the environment"
    ):
        configuration(playground_env(model=object()))


# --- mjlab -----------------------------------------------------------------------------------------------------------


def test_a_task_of_mjlab_is_compiled_and_read(monkeypatch, tmp_path, approved):
    install_mjlab(monkeypatch)
    options = MujocoCfg(
        timestep=0.005, iterations=10, cone="elliptic", integrator="implicitfast"
    )
    collision = CollisionCfg(condim=6, solref=(0.01, 1.0))
    task = mjlab_task(
        SimulationCfg(njmax=3, nconmax=35, mujoco=options),
        collision,
        observed=2,
        acted=3,
    )
    read = configuration(task)
    approved("sanity/read_mjlab", read_text(read))
    (used,) = (group for group in read.contact_groups if group.is_used)
    assert (used.constants["condim"], used.constants["solref"]) == (6, [0.01, 1.0])
    # Two steps of the environment, of 20 ms, and three of the engine.
    assert read.robot.delay_s == pytest.approx(2 * 0.02 + 3 * 0.005)
    row = check(read, only=["contact-capacity"]).rows[0]
    assert row.verdict.value == "wrong"
    assert row.cause.line.startswith("SimulationCfg(njmax=")
    saved = configuration(probe_file(task, tmp_path))
    assert (saved.settings, saved.contact_groups) == (
        read.settings,
        read.contact_groups,
    )
    names = ("language", "trains_on", "frame_skip")
    assert [getattr(saved, name) == getattr(read, name) for name in names] == [True] * 3


def test_no_delay_and_no_limit_are_not_stated(monkeypatch):
    install_mjlab(monkeypatch)
    read = configuration(mjlab_task())
    assert read.capacity is None
    assert read.robot.delay_s is None
