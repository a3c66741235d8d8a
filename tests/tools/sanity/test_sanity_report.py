"""The sanity check as people and programs read it: a table and JSON lines."""

import json
from dataclasses import replace
from io import StringIO

import pytest
from places import ROOT
from rich.console import Console

from gauge_envs.pages.markdown import as_markdown
from gauge_envs.pages.terminal import Terminal
from gauge_envs.tools.sanity.model import (
    ContactGroup,
    Cure,
    PartOutcome,
    PhenomenonResult,
    Reality,
    Report,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.phenomena.base import facts
from gauge_envs.tools.sanity.words import sanity_document, top_line

CONSTANTS = {
    "condim": 3,
    "friction": [0.4, 0.4, 0.1, 0.1, 0.1],
    "solref": [0.02, 1.0],
    "solreffriction": [0.0, 0.0],
    "solimp": [0.0, 0.8, 0.01, 0.5, 2.0],
    "margin": 0.0,
    "gap": 0.0,
}
CONFIGURATION = TrainingConfiguration(
    name="Robot-v0",
    source="a <model> of [mine]",
    backend="mujoco",
    settings={
        "timestep_s": 0.01,
        "refsafe": False,
        "contact_solimp": [0.0, 0.8, 0.01, 0.5, 2.0],
        "cone": "pyramidal",
    },
    origins={
        "timestep_s": "option",
        "refsafe": "option",
        "cone": "option",
        "contact_solimp": "floor with foot",
    },
    frame_skip=5,
    contact_groups=(
        ContactGroup(
            geoms="floor with foot", pair_count=8, constants=CONSTANTS, is_used=True
        ),
        ContactGroup(
            geoms="arms with each other",
            pair_count=2,
            constants=CONSTANTS | {"condim": 1},
        ),
    ),
    notes=("not used: arms with each other & more",),
)
CREEP = PhenomenonResult(
    phenomenon="creep-wood",
    title="creep of a <cube> [of wood]",
    experiment="GAUGE/SlopeSlider-1-wood",
    unit="mm/s",
    reality=Reality.law(
        0.0, tolerance=0.5, source="paper, Table 5 & more", rationale="cubes <rest>"
    ),
    default=0.002,
    configured=-28.0,
    verdict=Verdict.WRONG,
    default_verdict=Verdict.INSIDE,
)
SLIDE = replace(
    CREEP,
    phenomenon="slide",
    title="slide",
    configured=1.5,
    verdict=Verdict.VISIBLE,
)
PERIOD = replace(
    CREEP,
    phenomenon="period",
    title="period",
    configured=0.1,
    verdict=Verdict.INSIDE,
)
WALL = replace(
    CREEP,
    phenomenon="wall",
    title="wall",
    configured=None,
    default=None,
    verdict=Verdict.DECLINED,
    default_verdict=Verdict.DECLINED,
    remark="'brick' is too heavy",
)

ADVICE = replace(
    CREEP,
    phenomenon="rebound",
    title="rebound",
    advisory="no impact constant is stated",
)
NOTHING = replace(
    WALL,
    phenomenon="slip",
    title="slip",
    remark="the model has no gravity",
    applies=False,
)


def report(*rows):
    return Report(
        configuration=CONFIGURATION,
        rows=rows,
        versions={"mujoco": "4.0.0"},
        wall_s=12.3,
    )


WHOLE = report(CREEP, SLIDE, PERIOD, WALL)
CURE = Cure(
    changes={"cone": "elliptic"},
    line='<option cone="elliptic"/>: 2 of 2 flags go',
    flag_count=2,
    mended={"creep-wood": 0.5, "wall-drift": 0.1},
)
GROUPS = (
    PartOutcome(
        name="floor with trunk", value=0.1, verdict=Verdict.INSIDE, deviation=0.2
    ),
    PartOutcome(
        name="floor with foot", value=-28.0, verdict=Verdict.WRONG, deviation=56.0
    ),
)
REPORTS = {
    "whole": WHOLE,
    "with a cure": replace(WHOLE, cure=CURE),
    "nothing flagged": report(PERIOD),
    "not all measured": report(PERIOD, WALL),
    "nothing measured": report(NOTHING),
    "advice": report(ADVICE, PERIOD),
    "several sets": report(replace(CREEP, geoms="floor with foot", parts=GROUPS)),
}
"""Reports of each kind, by what they show."""


def test_wrong_rows_of_the_robot_that_no_change_corrects_stand_first():
    density = replace(CREEP, phenomenon="robot-density", title="density")
    left = replace(report(CREEP, density), cure=replace(CURE, line="a change"))
    text = "Wrong in the robot itself: robot-density. Mends most: a change"
    assert top_line(left) == text


def shown(checked, *, width=120, wide=False):
    stream = StringIO()
    document = Terminal(sanity_document(checked), wide=wide)
    Console(file=stream, width=width).print(document)
    text = stream.getvalue()
    assert max(map(len, text.splitlines())) <= width
    return text


# --- words -----------------------------------------------------------------------------------------------------------


def test_reports_in_a_terminal(approved):
    texts = {name: shown(one) for name, one in REPORTS.items()}
    texts |= {
        "narrow": shown(WHOLE, width=80),
        "wide": shown(REPORTS["several sets"], width=200, wide=True),
        "markdown": as_markdown(sanity_document(WHOLE)),
    }
    sections = (f"=== {name} ===\n{text}" for name, text in texts.items())
    approved("sanity/reports", "\n".join(sections))


def test_advice_does_not_count():
    assert report(ADVICE, PERIOD).worst is Verdict.INSIDE
    assert WHOLE.worst is Verdict.WRONG


def test_phenomena_are_listed_without_a_target(gauge):
    outcome = gauge(*["list", "phenomena", "--json", "creep-*", "gravity", "rebound"])
    rows = {row["id"]: row for row in map(json.loads, outcome.stdout.splitlines())}
    creeps = {f"creep-{material}" for material in ("wood", "plastic", "metal")}
    assert set(rows) == {"gravity", "rebound", *creeps}
    trials = facts("bouncing_ball_summary")["trial_count"]
    assert (rows["rebound"]["kind"], rows["rebound"]["trial_count"]) == (
        "measured",
        trials,
    )
    assert "rope-length" in gauge("list", "phenomena", "*").stdout


# --- command ---------------------------------------------------------------------------------------------------------


def test_the_command_on_a_real_configuration(gauge):
    arguments = ["sanity", "HalfCheetah-v5", "--only", "rest-height"]
    outcome = gauge(*arguments, "--json", "--fail-on", "wrong")
    first, row = (json.loads(line) for line in outcome.stdout.splitlines())
    assert outcome.exit_code == 1
    assert first["configuration"]["name"] == "HalfCheetah-v5"
    # solimp 0 0.8 0.01 lets a cube sink by millimetres; the backend's default holds it.
    assert row["verdict"] == "wrong"
    assert row["configured"] < -1.0
    assert abs(row["default"]) < 0.1
    assert gauge(*arguments, "--fail-on", "never").exit_code == 0


@pytest.mark.slow
def test_the_good_example_raises_no_flag(gauge):
    file = ROOT / "examples" / "sanity" / "good.toml"
    outcome = gauge("sanity", file, "--fail-on", "visible")
    assert outcome.exit_code == 0, outcome.output
