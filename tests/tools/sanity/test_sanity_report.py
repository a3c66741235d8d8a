"""The sanity check as people and programs read it: a table, JSON lines, one HTML file, exit codes."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser
from io import StringIO
from xml.etree import ElementTree

import pytest
from places import ROOT
from rich.console import Console
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.errors import MissingExtraError
from gauge_envs.pages.document import Terminal, as_markdown, as_rows
from gauge_envs.tools import sanity
from gauge_envs.tools.sanity.model import (
    Cause,
    ContactGroup,
    Cure,
    Curve,
    GroupOutcome,
    PhenomenonResult,
    Reality,
    Report,
    SettingTrial,
    TrainingConfiguration,
    Verdict,
)
from gauge_envs.tools.sanity.words import sanity_document, sanity_page

RUNNER = CliRunner()

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


def report(*rows: PhenomenonResult) -> Report:
    return Report(
        configuration=CONFIGURATION,
        rows=rows,
        versions={"mujoco": "4.0.0"},
        wall_s=12.3,
    )


WHOLE = report(CREEP, SLIDE, PERIOD, WALL)


def shown(checked: Report, *, width: int = 200) -> str:
    stream = StringIO()
    Console(file=stream, width=width).print(Terminal(sanity_document(checked)))
    return stream.getvalue()


# --- table and JSON --------------------------------------------------------------------------------------------------


def test_the_table_shows_reality_values_verdict_and_what_is_responsible() -> None:
    lines = shown(WHOLE).splitlines()
    index = next(
        index for index, line in enumerate(lines) if line.startswith("creep-wood")
    )
    for part in ("0 +- 0.5 mm/s", "0.002", "-28", "wrong, -28 mm/s"):
        assert part in lines[index]
    assert "cone: elliptic instead of pyramidal brings" in lines[index + 1]
    text = "\n".join(lines)
    assert re.search(
        r"^wall .* - +- +declined\n +'brick' is too heavy", text, re.MULTILINE
    )
    assert "visible, +1.5 mm/s" in text
    assert "1 wrong, 1 visible, 1 inside, 1 declined; 12 s" in text


def test_what_was_read_is_shown_with_its_origin() -> None:
    text = shown(WHOLE)
    assert re.search(r"read from +a <model> of \[mine\]", text)
    assert re.search(r"one action +5 steps", text)
    assert re.search(
        r"option +timestep_s = 0.01, refsafe = off, cone = pyramidal", text
    )
    assert re.search(r"floor with foot +contact_solimp = 0 0.8 0.01 0.5 2", text)
    assert re.search(r"^floor with foot\n +used +8 +3 ", text, re.MULTILINE)
    assert "note: not used: arms with each other & more" in text


def test_verdicts_that_do_not_occur_are_not_explained() -> None:
    assert "declined" not in shown(report(PERIOD))
    assert "advisory" not in shown(WHOLE)
    assert "a real trial could have done this" in " ".join(
        shown(report(PERIOD)).split()
    )


def test_a_narrow_terminal_loses_no_verdict() -> None:
    text = shown(WHOLE, width=80)
    assert "wrong, -28 mm/s" in text
    assert max(map(len, text.splitlines())) <= 80
    row = next(line for line in text.splitlines() if line.startswith("creep-wood"))
    assert row.split()[-3:] == ["wrong,", "-28", "mm/s"]
    assert "declined" in text


def test_markdown_is_a_row_each() -> None:
    top, _, title, rule, *rows, _, tally = as_markdown(
        sanity_document(WHOLE)
    ).splitlines()
    assert top == "2 flags; no change that was tried mends one"
    assert title.split(" | ")[-1] == "responsible |"
    assert rule == "| --- | --- | --- | ---: | ---: | ---: | --- | --- |"
    assert [row.split(" | ")[6].split(",")[0] for row in rows] == [
        "wrong",
        "visible",
        "inside",
        "declined",
    ]
    assert tally.endswith("1 wrong, 1 visible, 1 inside, 1 declined; 12 s")


def test_json_is_the_configuration_and_then_a_row_each() -> None:
    first, *rows = [
        json.loads(json.dumps(row, allow_nan=False))
        for row in as_rows(sanity_document(WHOLE))
    ]
    assert first["configuration"]["settings"]["contact_solimp"] == [
        0.0,
        0.8,
        0.01,
        0.5,
        2.0,
    ]
    assert (first["worst"], first["versions"]) == ("wrong", {"mujoco": "4.0.0"})
    assert [row["phenomenon"] for row in rows] == [
        "creep-wood",
        "slide",
        "period",
        "wall",
    ]
    assert rows[0]["cause"]["settings"] == ["cone"]
    assert rows[0]["cause"]["tried"][1] == {
        "changes": {"timestep_s": 0.001},
        "value": None,
        "on_default": True,
    }
    assert not any("curve" in row for row in rows)


def test_the_top_line_is_the_change_that_mends_most() -> None:
    cure = Cure(
        changes={"cone": "elliptic"},
        line='<option cone="elliptic"/>: 2 of 2 flags go',
        flag_count=2,
        mended_count=2,
    )
    first = shown(replace(WHOLE, cure=cure)).splitlines()[0]
    assert first == 'Mends most: <option cone="elliptic"/>: 2 of 2 flags go'
    assert (
        shown(report(PERIOD)).splitlines()[0]
        == "No flags: 1 row measured, nothing to change"
    )
    assert (
        shown(report(PERIOD, WALL)).splitlines()[0]
        == "Incomplete: 1 of 2 rows were not measured: wall"
    )
    assert shown(report(NOTHING)).splitlines()[0] == "Nothing was measured"


def test_advice_is_shown_and_does_not_count() -> None:
    text = shown(report(ADVICE, PERIOD))
    assert "advisory, -28 mm/s" in text
    assert "no impact constant is stated" in text
    assert "1 inside, 1 advisory; 12 s" in text
    assert report(ADVICE, PERIOD).worst is Verdict.INSIDE


def test_the_geoms_that_decide_are_named() -> None:
    groups = (
        GroupOutcome(geoms="floor with trunk", value=0.1, verdict=Verdict.INSIDE),
        GroupOutcome(geoms="floor with foot", value=-28.0, verdict=Verdict.WRONG),
    )
    row = replace(CREEP, geoms="floor with foot", groups=groups)
    assert "worst: floor with foot" in shown(report(row))
    page = " ".join("".join(_Page(sanity_page(report(row))).text).split())
    assert "floor with trunk" in page


def test_regressions_are_those_that_are_worse_than_before(
    tmp_path, monkeypatch
) -> None:
    before = tmp_path / "before.json"
    before.write_text(
        "\n".join(
            json.dumps(row) for row in as_rows(sanity_document(report(CREEP, PERIOD)))
        )
    )
    known = ["sanity", "mujoco", "--baseline", str(before)]
    monkeypatch.setattr(sanity, "check", lambda *_, **__: report(CREEP, PERIOD))
    assert RUNNER.invoke(app, known).exit_code == 0
    worse = replace(PERIOD, configured=1.0, verdict=Verdict.VISIBLE)
    monkeypatch.setattr(sanity, "check", lambda *_, **__: report(CREEP, worse))
    outcome = RUNNER.invoke(app, known)
    assert outcome.exit_code == 1
    assert (
        "regression: period: visible, 2 half-widths; was 1 half-widths from reality at most"
        in outcome.stderr
    )
    assert RUNNER.invoke(app, [*known, "--fail-on", "wrong"]).exit_code == 0
    monkeypatch.setattr(sanity, "check", lambda *_, **__: report(SLIDE, PERIOD))
    assert RUNNER.invoke(app, known).exit_code == 1
    monkeypatch.setattr(sanity, "check", lambda *_, **__: report(ADVICE, PERIOD))
    assert RUNNER.invoke(app, known).exit_code == 0


def test_ids_titles_and_kinds_are_listed_without_a_target() -> None:
    outcome = RUNNER.invoke(
        app, ["list", "phenomena", "--json", "creep-*", "gravity", "rebound"]
    )
    rows = {row["id"]: row for row in map(json.loads, outcome.stdout.splitlines())}
    assert set(rows) == {
        "gravity",
        "creep-wood",
        "creep-plastic",
        "creep-metal",
        "rebound",
    }
    assert (rows["rebound"]["kind"], rows["rebound"]["trial_count"]) == ("measured", 22)
    assert (rows["creep-wood"]["kind"], rows["creep-wood"]["trial_count"]) == ("law", 0)
    assert rows["gravity"]["rationale"]
    assert "rope-length" in RUNNER.invoke(app, ["list", "phenomena", "*"]).stdout


def test_a_time_limit_leaves_rows_unmeasured() -> None:
    outcome = RUNNER.invoke(
        app,
        [
            "sanity",
            "HalfCheetah-v5",
            "--limits",
            "0s",
            "--only",
            "gravity,creep-wood",
            "--json",
        ],
    )
    first, gravity, creep = map(json.loads, outcome.stdout.splitlines())
    assert (gravity["verdict"], creep["verdict"]) == ("inside", "declined")
    assert creep["remark"] == "not measured within the time limit"
    assert "the time limit, 0.0 s, is reached" in first["notes"][0]


# --- page ------------------------------------------------------------------------------------------------------------


class _Page(HTMLParser):
    """Checks that elements are closed in order, and collects attributes and text."""

    VOID = ("meta", "br")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.text: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs) -> None:
        self.attributes += [(tag, key, value or "") for key, value in attrs]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs) -> None:
        self.attributes += [(tag, key, value or "") for key, value in attrs]

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        self.text.append(data)


def test_the_page_is_well_formed_and_needs_nothing_else() -> None:
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


def test_the_page_states_everything_in_words() -> None:
    text = " ".join("".join(_Page(sanity_page(WHOLE)).text).split())
    for part in (
        "Sanity check of Robot-v0",
        "creep of a <cube> [of wood]",
        "a <model> of [mine]",
        "0 +- 0.5 mm/s",
        "wrong, -28 mm/s",
        "visible, +1.5 mm/s",
        "cubes <rest>",
        "2 flags; no change that was tried mends one",
        "declined",
        "cone: elliptic instead of pyramidal brings creep from 28 to 0.02 mm/s",
        "timestep_s = 0.001",
        "diverged or declined",
        "paper, Table 5 & more",
        "not used: arms with each other & more",
        "4.0.0",
    ):
        assert part in text, part


def test_each_curve_is_a_picture_with_a_band_and_two_lines_of_different_style() -> None:
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


def test_ids_of_pictures_do_not_meet() -> None:
    ids = re.findall(r'<clipPath id="([^"]+)"', sanity_page(WHOLE))
    assert len(ids) == len(set(ids)) == 2


def test_a_page_that_cannot_be_drawn_says_why(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"gauge-envs\[plot\]"):
        sanity_page(WHOLE)


# --- command ---------------------------------------------------------------------------------------------------------


def test_the_command_on_a_real_configuration(tmp_path) -> None:
    page = tmp_path / "page.html"
    arguments = [
        "sanity",
        "HalfCheetah-v5",
        "--only",
        "rest-height",
        "--out",
        str(page),
    ]
    outcome = RUNNER.invoke(app, [*arguments, "--json", "--fail-on", "wrong"])
    first, row = (json.loads(line) for line in outcome.stdout.splitlines())
    assert outcome.exit_code == 1
    assert first["configuration"]["name"] == "HalfCheetah-v5"
    # solimp 0 0.8 0.01 lets a cube sink by millimetres; the backend's default holds it.
    assert row["verdict"] == "wrong"
    assert row["configured"] < -1.0
    assert abs(row["default"]) < 0.1
    assert page.read_text().count("<svg") <= 1
    assert RUNNER.invoke(app, [*arguments, "--fail-on", "never"]).exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["CartPole-v1"], "CartPole-v1 is .* which has no MuJoCo model"),
        (
            ["HalfCheetah-v5", "--pair", "floor"],
            "--pair 'floor': expected the names of two geoms",
        ),
        (
            ["HalfCheetah-v5", "--pair", "floor,nose"],
            "no geom 'nose'; it has floor, torso",
        ),
        (["mujoco", "--only", "gravity,nope"], "unknown phenomenon 'nope'"),
        ([], "no target is given"),
        (["mujoco", "--baseline", "nowhere.json"], "nowhere.json: cannot be read"),
        (
            ["mujoco", "--baseline", __file__],
            "is not the output of gauge sanity --json",
        ),
        (["mujoco:nope"], "unknown MuJoCo preset 'nope'"),
    ],
)
def test_requests_that_cannot_be_met(arguments: list[str], message: str) -> None:
    outcome = RUNNER.invoke(app, ["sanity", *arguments])
    assert outcome.exit_code == 2
    assert re.search(message, " ".join(outcome.output.split()))


@pytest.mark.slow
def test_the_good_example_raises_no_flag() -> None:
    file = ROOT / "examples" / "sanity" / "good.toml"
    outcome = RUNNER.invoke(app, ["sanity", str(file), "--fail-on", "visible"])
    assert outcome.exit_code == 0, outcome.output
