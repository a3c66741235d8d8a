"""The page of a sanity check on a laptop and on a phone: widths, sizes of text, and what comes first."""

import html
import json
import re
import shutil
import subprocess
from dataclasses import replace

import pytest
from test_sanity_report import (
    ADVICE,
    CONFIGURATION,
    CONSTANTS,
    CREEP,
    PERIOD,
    SLIDE,
    WALL,
    report,
)

from gauge_envs.tools.sanity.model import ContactGroup, Cure, PartOutcome, Verdict
from gauge_envs.tools.sanity.page import sanity_page
from gauge_envs.tools.sanity.robot.foot import REFERENCE_FOOT

CHROMIUM = (
    shutil.which("chromium")
    or shutil.which("chromium-browser")
    or shutil.which("google-chrome")
)

LEAST_TEXT_PX = 14.0

LONG = "front_left_" + "foot_collision_geom_" * 4
"""A name without a place to break a line, longer than a phone is wide."""

MEASURE = """
<script>window.onload = () => {
  document.querySelectorAll("details").forEach(one => one.open = true);
  document.querySelectorAll(".card").forEach(one => one.style.contentVisibility = "visible");
  const width = document.documentElement.clientWidth, wide = [], sizes = [];
  for (const one of document.querySelectorAll("body *")) {
    if (one.closest("svg") || one.tagName === "SCRIPT") continue;
    if (one.getBoundingClientRect().right > width + 1) wide.push(one.tagName);
    const words = [...one.childNodes].some(node => node.nodeType === 3 && node.textContent.trim());
    if (words) sizes.push(parseFloat(getComputedStyle(one).fontSize));
  }
  const texts = [...document.querySelectorAll("svg text")].map(one => {
    const matrix = one.getScreenCTM();
    return parseFloat(getComputedStyle(one).fontSize) * Math.hypot(matrix.a, matrix.b);
  });
  parent.document.title = JSON.stringify({width, scroll: document.documentElement.scrollWidth, wide,
    text: Math.min(...sizes), figure: Math.min(...texts)});
}</script>
"""
"""Script that opens everything and reports what is wider than the screen, and the smallest text [px]."""


def page_report():
    groups = (
        PartOutcome(
            name=f"floor with {LONG}",
            value=-28.0,
            verdict=Verdict.WRONG,
            deviation=56.0,
        ),
        PartOutcome(
            name="floor with trunk", value=0.1, verdict=Verdict.INSIDE, deviation=0.2
        ),
    )
    worst = replace(CREEP, geoms=f"floor with {LONG}", parts=groups)
    known = tuple(
        ContactGroup(
            geoms=f"floor with {name}", pair_count=4, constants=CONSTANTS, is_used=True
        )
        for name in (LONG, "trunk")
    )
    checked = replace(
        CONFIGURATION,
        source=f"model file /home/user/{'robots/' * 12}{LONG}.xml",
        contact_groups=known,
        foot_geometry=REFERENCE_FOOT,
        notes=(f"not used: {LONG}",),
    )
    cure = Cure(
        changes={},
        line=f'<geom solref="0.004 1"/> for {LONG}: 2 of 2 flags go',
        flag_count=2,
        mended={"creep-wood": 0.5, "wall-drift": 0.1},
    )
    return replace(
        report(worst, SLIDE, PERIOD, WALL, ADVICE), configuration=checked, cure=cure
    )


def test_the_cure_comes_first_then_the_table_then_the_pictures():
    text = sanity_page(page_report())
    places = [
        text.index(part)
        for part in (
            "<h1>",
            "Mends most",
            '<table class="stack phenomena',
            "<svg",
            "read from",
        )
    ]
    assert places == sorted(places)
    assert len(text) < 3_000_000


def test_details_are_open_where_something_is_flagged():
    cards = re.findall(
        r'<details class="card" id="([^"]+)"( open)?>', sanity_page(page_report())
    )
    assert {name: bool(is_open) for name, is_open in cards} == {
        "creep-wood": True,
        "slide": True,
        "period": False,
        "wall": False,
        "rebound": False,
    }
    assert [name for name, _ in cards][:2] == ["creep-wood", "slide"]


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
@pytest.mark.parametrize(
    ("width", "height"), [pytest.param(1200, 800, marks=pytest.mark.slow), (390, 844)]
)
def test_nothing_is_wider_than_the_screen_and_text_is_readable(width, height, tmp_path):
    page = sanity_page(page_report()).replace("</body>", f"{MEASURE}</body>")
    # A window is at least 500 pixels wide, so the page is shown in a frame.
    frame = f'<iframe style="border:0" width="{width}" height="{height}" srcdoc="{html.escape(page)}"></iframe>'
    path = tmp_path / "frame.html"
    path.write_text(f"<!DOCTYPE html><title></title><body>{frame}</body>")
    assert CHROMIUM is not None
    arguments = [
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--hide-scrollbars",
        "--window-size=1300,900",
    ]
    shown = subprocess.run(
        [
            CHROMIUM,
            *arguments,
            f"--user-data-dir={tmp_path / 'profile'}",
            "--dump-dom",
            path.as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    ).stdout
    title = re.search(r"<title>(.*?)</title>", shown)
    measured = json.loads(html.unescape(title.group(1)))
    assert measured["width"] == width
    assert measured["scroll"] <= width and measured["wide"] == []
    assert measured["text"] >= LEAST_TEXT_PX
    assert measured["figure"] >= LEAST_TEXT_PX
