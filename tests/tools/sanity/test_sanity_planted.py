"""Models with one planted fault each: the recommended model passes, and each fault fails with its culprit named."""

import mujoco
import pytest
from places import ROOT
from planted import PLANTED, RECOMMENDED, Planted, attributes, model_xml

from gauge_envs.backends import backend
from gauge_envs.tools.sanity.candidates import RECOMMENDED_MUJOCO
from gauge_envs.tools.sanity.measure import Measurements, subject_of
from gauge_envs.tools.sanity.model import Verdict
from gauge_envs.tools.sanity.phenomena import phenomena
from gauge_envs.tools.sanity.run import check
from gauge_envs.tools.sanity.stacks import configuration

pytestmark = pytest.mark.usefixtures("shared_measurements")


def checked(planted, *only):
    return check(mujoco.MjModel.from_xml_string(model_xml(planted)), only=only)


def row_of(report, name):
    return next(row for row in report.rows if row.phenomenon == name)


def test_the_documents_recommend_what_is_tested():
    text = (ROOT / "docs" / "sanity.md").read_text()
    option = {
        name: value
        for name, value in RECOMMENDED["option"].items()
        if name != "gravity"
    }
    assert f"<option {attributes(option)}/>" in text
    assert f"<default><geom {attributes(RECOMMENDED['geom'])}/></default>" in text
    read = configuration(mujoco.MjModel.from_xml_string(model_xml())).settings
    for name, value in RECOMMENDED_MUJOCO.items():
        found = read.get(name, 0.0 if name == "contact_margin_m" else None)
        assert (tuple(found) if isinstance(found, list) else found) == value, name


@pytest.mark.slow
def test_the_recommended_model_passes(tmp_path, gauge):
    path = tmp_path / "recommended.xml"
    path.write_text(model_xml())
    outcome = gauge("sanity", path, "--fail-on", "wrong")
    assert outcome.exit_code == 0, outcome.output
    assert outcome.stdout.startswith("recommended.xml: No flags: ")
    assert gauge("sanity", path, "--fail-on", "visible").exit_code == 0


def test_the_recommended_model_passes_where_faults_show():
    report = checked(
        None, *{name for planted in PLANTED.values() for name in planted.rows.split()}
    )
    assert {
        row.phenomenon: row.verdict
        for row in report.rows
        if row.verdict is not Verdict.INSIDE
    } == {}
    assert report.cure is None


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_fault_fails_and_is_named(name):
    planted = PLANTED[name]
    culprits = {*planted.culprits.split()}
    report = checked(planted, *planted.rows.split())
    named = {
        setting
        for row in report.rows
        if row.cause is not None
        for setting in row.cause.settings
    }
    assert any(row.verdict is Verdict.WRONG for row in report.rows)
    assert named & culprits, [row.cause for row in report.rows]
    assert culprits & {*report.cure.changes}, report.cure


@pytest.mark.parametrize(
    "name", ["margin_1_cm", "soft_solref", "no_impratio", "gravity_tilted"]
)
def test_the_change_on_top_mends_the_model_when_it_is_pasted(name):
    planted = PLANTED[name]
    before = checked(planted, *planted.rows.split())
    head = before.cure.line.split(": ", 1)[0]
    spec = mujoco.MjSpec.from_string(
        model_xml(planted).replace("<worldbody>", f"{_merged(head)}<worldbody>", 1)
    )
    after = check(spec.compile(), only=planted.rows.split())
    assert [row.verdict for row in after.rows] == [Verdict.INSIDE] * len(
        planted.rows.split()
    )


def _merged(text):
    """Return pasted elements as a second section, which MuJoCo merges with the first."""
    return text.replace(" and ", "")


def test_a_soft_foot_with_priority_decides_and_is_named():
    report = checked(PLANTED["soft_foot"], "rest-height")
    row = row_of(report, "rest-height")
    assert row.verdict is Verdict.WRONG
    assert row.geoms == "floor with foot"
    verdicts = {one.name: one.verdict for one in row.parts}
    assert verdicts == {
        "floor with trunk, left_shin and right_shin": Verdict.INSIDE,
        "floor with foot": Verdict.WRONG,
    }
    assert (
        report.cure is not None
        and " in foot, which the default does not reach" in report.cure.line
    )
    # Contacts do not matter to a pendulum.
    read = configuration(
        mujoco.MjModel.from_xml_string(model_xml(PLANTED["soft_foot"]))
    )
    known = Measurements(backend("mujoco"))
    sets = {
        one.id: len(subject_of(known, read, one).sets)
        for one in phenomena(["period", "seam"])
    }
    assert sets == {"period": 1, "seam": 2}
    other = check(
        configuration(
            mujoco.MjModel.from_xml_string(model_xml(PLANTED["soft_foot"])),
            pair=("floor", "trunk"),
        ),
        only=["rest-height"],
    )
    assert other.worst is Verdict.INSIDE


@pytest.mark.parametrize(
    ("name", "declined", "reason"),
    [
        (
            "InvertedPendulum-v5",
            {"creep-wood", "slide-wood", "rest-height", "rebound"},
            "no two geoms of the model can collide",
        ),
        (
            "Pusher-v5",
            {"gravity", "creep-wood", "slide-wood", "rest-height", "rebound", "period"},
            "the model has no gravity",
        ),
    ],
)
def test_what_does_not_apply_is_declined_with_the_reason(name, declined, reason):
    report = check(name, only=sorted({"gravity", *declined}))
    found = {
        row.phenomenon: row for row in report.rows if row.verdict is Verdict.DECLINED
    }
    assert set(found) == declined
    assert {row.remark for row in found.values()} == {reason}
    assert not any(row.is_flag or row.applies for row in found.values())
    assert report.worst is (
        Verdict.INSIDE if len(declined) < len(report.rows) else Verdict.DECLINED
    )


def test_contacts_without_friction_on_purpose_are_not_judged_by_friction():
    report = checked(Planted(geom={"condim": "1"}), "creep-wood", "point")
    assert row_of(report, "creep-wood").remark.startswith(
        "condim 1: contacts of floor with trunk"
    )
    assert row_of(report, "point").verdict is Verdict.INSIDE


@pytest.mark.parametrize(
    ("solref", "is_advice"),
    [("0.004 1", True), ("-1000 -100", True), ("-1000 -1", False), ("0.02 0.1", False)],
)
def test_impacts_count_where_the_model_states_a_rebound(solref, is_advice):
    row = row_of(checked(Planted(geom={"solref": solref}), "rebound"), "rebound")
    assert row.verdict is Verdict.WRONG
    assert bool(row.advisory) is is_advice


@pytest.mark.parametrize(
    ("option", "geom", "up", "verdict"),
    [
        ("0 0 -9.81", "", (0.0, 0.0, 1.0), Verdict.INSIDE),
        ("0 0 -9.78", "", (0.0, 0.0, 1.0), Verdict.INSIDE),
        ("0 0 -9.7", "", (0.0, 0.0, 1.0), Verdict.VISIBLE),
        ("0 -9.81 0", 'zaxis="0 1 0"', (0.0, 1.0, 0.0), Verdict.INSIDE),
        ("0 0 -9.81", 'euler="10 0 0"', (0.0, 0.0, 1.0), Verdict.INSIDE),
        ("0 0 9.81", "", (0.0, 0.0, 1.0), Verdict.WRONG),
        ("0 0 -1.62", "", (0.0, 0.0, 1.0), Verdict.WRONG),
    ],
)
def test_gravity_is_judged_against_the_ground(option, geom, up, verdict):
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option gravity="{option}"/><worldbody><geom type="plane" size="1 1 1" {geom}/>
        <body pos="0 0 1"><freejoint/><geom size=".1"/></body></worldbody></mujoco>"""
    )
    read = configuration(model)
    assert read.up == pytest.approx(up)
    (row,) = check(read, only=["gravity"]).rows
    assert row.verdict is verdict
