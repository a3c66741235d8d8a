"""The sanity check as people and programs read it: a table, JSON lines, formats of CI, and one HTML file."""

import json
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser
from io import StringIO
from xml.etree import ElementTree

import pytest
from approval import refused_commands
from places import ROOT
from rich.console import Console

from gauge_envs.errors import MissingExtraError
from gauge_envs.pages.document import Terminal, as_markdown, as_rows
from gauge_envs.tools.sanity.formats import WRITERS
from gauge_envs.tools.sanity.model import (
    Cause,
    ContactGroup,
    Cure,
    Curve,
    PartOutcome,
    PhenomenonResult,
    Reality,
    Report,
    SettingTrial,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.page import sanity_page
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
TIMES = (0.0, 0.5, 1.0)
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
    cause=Cause(
        settings=("cone",),
        line="cone: elliptic instead of pyramidal brings creep from 28 to 0.02 mm/s",
        tried=(
            SettingTrial(changes={"cone": "elliptic"}, value=0.02),
            SettingTrial(changes={"timestep_s": 0.001}, value=None, on_default=True),
        ),
    ),
    curve=Curve(
        label="way downhill [mm]",
        times_s=TIMES,
        default=(0.0, 0.001, 0.002),
        configured_times_s=(0.0, 1.0),
        configured=(0.0, 28.0),
        reality=(0.0, 0.0, 0.0),
        tolerance=(0.0, 0.25, 0.5),
    ),
)
SLIDE = replace(
    CREEP,
    phenomenon="slide",
    title="slide",
    configured=1.5,
    verdict=Verdict.VISIBLE,
    cause=None,
)
PERIOD = replace(
    CREEP,
    phenomenon="period",
    title="period",
    configured=0.1,
    verdict=Verdict.INSIDE,
    cause=None,
    curve=None,
)
WALL = replace(
    CREEP,
    phenomenon="wall",
    title="wall",
    configured=None,
    default=None,
    verdict=Verdict.DECLINED,
    default_verdict=Verdict.DECLINED,
    cause=None,
    remark="'brick' is too heavy",
    curve=None,
)

ADVICE = replace(
    CREEP,
    phenomenon="rebound",
    title="rebound",
    advisory="no impact constant is stated",
    cause=None,
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


def test_wrong_rows_of_the_robot_that_no_change_mends_stand_first():
    size = replace(CREEP, phenomenon="robot-size", title="size", cause=None)
    cure = replace(CURE, line="a change")
    left = replace(report(CREEP, size), cure=cure)
    text = "Wrong in the robot itself, mend by hand: robot-size. Mends most: a change"
    assert CREEP.verdict is Verdict.WRONG
    assert top_line(left) == text
    mended = replace(cure, mended={"robot-size": 1.0})
    assert top_line(replace(left, cure=mended)) == "Mends most: a change"


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


def test_reports_as_json_and_for_ci(approved):
    rows = as_rows(sanity_document(WHOLE))
    texts = [json.dumps(row, indent=1, allow_nan=False) for row in rows]
    odd = report(replace(CREEP, title="50 % creep\nof a cube"), PERIOD, WALL, NOTHING)
    texts += [writer(odd) for writer in WRITERS.values()]
    ElementTree.fromstring(WRITERS["junit"](odd))
    approved("sanity/formats", "\n".join(texts))


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


# --- page ------------------------------------------------------------------------------------------------------------


class _Page(HTMLParser):
    """Checks that elements are closed in order, and collects attributes and text."""

    VOID = ("meta", "br")

    def __init__(self, text):
        super().__init__()
        self.open = []
        self.attributes = []
        self.text = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.attributes += [(tag, key, value or "") for key, value in attrs]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.attributes += [(tag, key, value or "") for key, value in attrs]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def test_the_page_is_well_formed_and_needs_nothing_else():
    page = _Page(sanity_page(WHOLE))
    assert page.open == []
    tags = {tag for tag, _, _ in page.attributes}
    assert not tags & {"script", "link", "img", "iframe", "object"}
    for tag, key, value in page.attributes:
        if key in ("src", "href", "xlink:href"):
            assert value.startswith("#"), (tag, key, value)
        assert not re.search(r"url\((?!#)", value), (tag, key, value)
    targets = {value for _, key, value in page.attributes if key == "id"}
    links = {
        value[1:] for tag, key, value in page.attributes if tag == "a" and key == "href"
    }
    assert links == {"creep-wood", "slide", "period", "wall"}
    assert links <= targets
    clips = re.findall(r'<clipPath id="([^"]+)"', sanity_page(WHOLE))
    assert len(clips) == len(set(clips)) == 2


def test_the_page_in_words(approved):
    page = re.sub(r"<(svg|style).*?</\1>", "", sanity_page(WHOLE), flags=re.DOTALL)
    words = (text.strip() for text in _Page(page).text)
    approved("sanity/page", "\n".join(filter(None, words)))


def test_each_curve_is_a_picture_with_a_band_and_two_lines_of_different_style():
    text = sanity_page(WHOLE)
    pictures = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    assert len(pictures) == 2
    for picture in pictures:
        ElementTree.fromstring(picture)
        for label in (
            "reality",
            "preset",
            "this configuration",
            "way downhill [mm]",
            "time [s]",
        ):
            assert f">{label}<" in picture
        assert "stroke-dasharray" in picture
    without = replace(
        CREEP,
        curve=replace(
            CREEP.curve, reality=(), tolerance=(), configured=(), configured_times_s=()
        ),
    )
    picture = re.search(
        r"<svg.*?</svg>", sanity_page(report(without)), re.DOTALL
    ).group()
    assert ">reality<" not in picture
    assert "this configuration" not in picture


def test_a_page_that_cannot_be_drawn_says_why(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"gauge-envs\[plot\]"):
        sanity_page(WHOLE)


# --- command ---------------------------------------------------------------------------------------------------------


def test_the_command_on_a_real_configuration(tmp_path, gauge):
    page = tmp_path / "page.html"
    arguments = [
        "sanity",
        "HalfCheetah-v5",
        "--only",
        "rest-height",
        "--out",
        str(page),
    ]
    outcome = gauge(*arguments, "--json", "--fail-on", "wrong")
    first, row = (json.loads(line) for line in outcome.stdout.splitlines())
    assert outcome.exit_code == 1
    assert first["configuration"]["name"] == "HalfCheetah-v5"
    # solimp 0 0.8 0.01 lets a cube sink by millimetres; the backend's default holds it.
    assert row["verdict"] == "wrong"
    assert row["configured"] < -1.0
    assert abs(row["default"]) < 0.1
    assert page.read_text().count("<svg") <= 1
    assert gauge(*arguments, "--fail-on", "never").exit_code == 0


def test_requests_that_cannot_be_met(gauge, approved):
    refusals = refused_commands(
        gauge,
        "sanity",
        "sanity CartPole-v1",
        "sanity HalfCheetah-v5 --pair floor",
        "sanity HalfCheetah-v5 --pair floor,nose",
        "sanity mujoco --pair a,b",
        "sanity mujoco --only gravity,nope",
        "sanity mujoco --baseline nowhere.json",
        "sanity mujoco --against mujoco --baseline nowhere.json",
        "sanity mujoco --against mujoco --out page.html",
        "sanity mujoco --against mujoco --format junit",
        "sanity mujoco --limits 60s",
        "sanity mujoco:nope",
        "sanity absent/env.yaml",
        "sanity nowhere.xml",
        "sanity nowhere.toml",
    )
    approved("sanity/refusals", refusals)


@pytest.mark.slow
def test_the_good_example_raises_no_flag(gauge):
    file = ROOT / "examples" / "sanity" / "good.toml"
    outcome = gauge("sanity", file, "--fail-on", "visible")
    assert outcome.exit_code == 0, outcome.output
