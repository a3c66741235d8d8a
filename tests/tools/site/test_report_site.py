"""The static site: its numbers are those of the results, its texts are escaped, and it replaces a site as a whole."""

import re
from base64 import b64decode
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from gauge_envs.errors import ResultFileError
from gauge_envs.experiments.resolve import load_experiment
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result
from gauge_envs.scene.jitter import Jitter
from gauge_envs.scoring.reference import reference_band
from gauge_envs.tools.site import save_site
from gauge_envs.tools.site.replay import replay
from gauge_envs.tools.site.replay_data import quantized, replay_data
from gauge_envs.tools.site.reproduce import run_command

SETTINGS = {"timestep_s": 1 / 900}


class Page(HTMLParser):
    """Elements and texts of a page."""

    def __init__(self, file):
        super().__init__()
        self.elements = []
        self.texts = []
        self.feed(file.read_text())

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.texts.append(data)

    @property
    def text(self):
        return " ".join(self.texts)

    @property
    def links(self):
        return [
            value
            for _, attributes in self.elements
            for key, value in attributes.items()
            if key in ("href", "src") and value
        ]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    # The cube of another friction has no reference.
    other = {"SlopeSlider-3-wood": {"cube.friction": 0.2}}
    requests = [
        RunRequest(name, settings=settings, parameters=other.get(name, "calibrated"))
        for name in (
            "SlopeSlider-2-wood",
            "NonsmoothContact-3-wood",
            "SlopeSlider-3-wood",
        )
        for settings in (None, SETTINGS)
    ]
    list(run_many(requests, out=folder))
    # A page shows the time that a run took.
    files = sorted(folder.glob("*.json"))
    return {file: replace(load_result(file), wall_s=1.0) for file in files}


@pytest.fixture(scope="module")
def site(results, tmp_path_factory):
    out = tmp_path_factory.mktemp("site") / "site"
    assert save_site(results, out) == ()
    return out


def pages(site):
    return sorted(site.glob("*.html"))


@pytest.mark.parametrize(
    "name",
    ["index", "experiment-SlopeSlider-2-wood"],
)
def test_the_text_of_a_page_is_the_approved_one(site, approved, name):
    lines = [line.strip() for line in Page(site / f"{name}.html").texts]
    # How far a coarse step leads from a fine one depends on the processor.
    stable = [line for line in lines if line and not re.fullmatch(r"[\d.]+ mm", line)]
    approved(f"site/{name}", "\n".join(stable))


def test_an_experiment_without_a_reference_shows_distances(site):
    text = Page(site / "experiment-SlopeSlider-3-wood.html").text
    assert "Distances between engines" in text


def test_every_link_leads_to_a_file_of_the_site(site):
    assert len(pages(site)) == 2 + 3 + 1
    for file in pages(site):
        links = [link for link in Page(file).links if not link.startswith("data:")]
        assert links
        for link in links:
            assert (site / link).is_file(), f"{file.name}: {link}"


def test_nothing_is_loaded_from_elsewhere(site):
    for file in (
        *pages(site),
        site / "assets" / "site.css",
        site / "assets" / "replay.js",
    ):
        assert not re.search(
            r"https?://|//[a-z]+\.[a-z]|@import|url\(",
            re.sub(r"base64,[^\"]*", "", file.read_text()),
        ), file.name


@pytest.mark.parametrize("is_same", [True, False], ids=["same run", "other friction"])
def test_the_first_page_says_whether_two_configurations_differ(is_same, tmp_path):
    # The default step given as a setting is another configuration of the same run.
    default = next(run_many([RunRequest("SlopeSlider-2-wood")], out=tmp_path))
    other = (
        {"settings": {"timestep_s": default.settings["timestep_s"]}}
        if is_same
        else {"parameters": {"cube.friction": 0.05}}
    )
    list(run_many([RunRequest("SlopeSlider-2-wood", **other)], out=tmp_path))
    save_site(
        {file: load_result(file) for file in tmp_path.glob("*.json")},
        tmp_path / "site",
        replays=False,
    )
    overview = Page(tmp_path / "site" / "index.html").text
    # Configurations with other constants are not ranked against each other.
    assert ("1.5 [1.0, 2.0] of 2" in overview) == is_same


# --- strangers' files ---

EVIL = '"><img src=x onerror=alert(1)><script>alert(2)</script></style>'


def tags(file):
    page = Page(file)
    assert not [
        key
        for _, attributes in page.elements
        for key in attributes
        if key.startswith("on")
    ], file.name
    return [tag for tag, _ in page.elements]


def test_hostile_texts_are_escaped(results, tmp_path):
    file, result = next(
        (file, one)
        for file, one in results.items()
        if one.id == "GAUGE/SlopeSlider-2-wood"
    )
    hostile = replace(
        result,
        backend=EVIL,
        parameters={EVIL: EVIL},
        settings={EVIL: EVIL},
        settings_given={EVIL: EVIL},
        versions={**result.versions, EVIL: EVIL},
        created=EVIL,
        score=replace(result.score, unit=EVIL),
        trajectory=replace(result.trajectory, unit=EVIL) if result.trajectory else None,
    )
    diverged = replace(hostile, seed=1, diverged_reason=EVIL + "\x1b[31m\ud800")
    out = tmp_path / "site"
    other = tmp_path / EVIL.replace("/", "")
    other.write_text("{}")
    save_site({file: hostile, other: diverged}, out, replays=False, command=EVIL)
    for page in pages(out):
        tags(page)
        sources = [a["src"] for tag, a in Page(page).elements if tag == "img"]
        assert all(one.startswith("data:image/svg+xml") for one in sources), page.name
        assert "script" not in tags(page), page.name
        assert "\x1b" not in page.read_text()
    assert EVIL in Page(out / "reproduce.html").text


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda text: text[:-40], "not a result file"),
        (
            lambda text: re.sub(r'"revision": \d+', '"revision": 99', text),
            "it has revision 99, and the installed package",
        ),
    ],
    ids=["damaged", "other revision"],
)
def test_a_wrong_file_is_named_and_left_out(change, reason, results, tmp_path, gauge):
    source = tmp_path / "results"
    source.mkdir()
    good = next(
        file
        for file, result in results.items()
        if result.id == "GAUGE/SlopeSlider-2-wood"
    )
    (source / good.name).write_bytes(good.read_bytes())
    (source / "wrong.json").write_text(change(good.read_text()))
    run = gauge("report", source, "--out", tmp_path / "site", "--no-replay")
    assert run.exit_code == 1
    assert f"wrong.json: {reason}" in " ".join(run.stderr.split()).replace(
        "GAUGE/SlopeSlider-2-wood: ", ""
    )
    assert "wrong.json" not in Page(tmp_path / "site" / "reproduce.html").text


def test_each_of_many_configurations_has_a_line_of_its_own(results, tmp_path):
    result = next(
        result for result in results.values() if result.id == "GAUGE/SlopeSlider-2-wood"
    )
    many = {
        tmp_path / f"{engine}{preset}.json": replace(
            result, backend=engine, settings_given=preset
        )
        for engine in ("drake", "mujoco", "newton", "rapier")
        for preset in ({}, {"preset": "out_of_box"})
    }
    save_site(many, tmp_path / "site", replays=False)
    assert "gauge-envs[drake,newton,rapier]'" in Page(
        tmp_path / "site" / "reproduce.html"
    ).text.replace(" ", "")
    page = Page(tmp_path / "site" / "experiment-SlopeSlider-2-wood.html")
    swatches = {
        attributes["style"]
        for _, attributes in page.elements
        if attributes.get("class") == "swatch"
    }
    # From the seventh on, colours come again with dashes.
    assert len(swatches) == 8
    assert sum("repeating" in style for style in swatches) == 2


def test_an_empty_folder_is_an_error(tmp_path, gauge):
    run = gauge("report", tmp_path, "--out", tmp_path / "site")
    assert run.exit_code == 2
    assert "holds no result files" in run.stderr
    with pytest.raises(ResultFileError, match="no result"):
        save_site({}, tmp_path / "site")


# --- the folder ---


def test_a_folder_with_something_else_is_refused(results, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(ResultFileError, match="something else than a site"):
        save_site(results, tmp_path, replays=False)
    assert (tmp_path / "thesis.txt").read_text() == "mine"


def test_a_new_site_replaces_the_whole_old_one(results, tmp_path):
    out = tmp_path / "site"
    save_site(results, out, replays=False)
    first = dict(list(results.items())[:1])
    save_site(first, out, replays=False)
    assert len(list(out.glob("experiment-*.html"))) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["site"]


def test_an_interrupted_site_leaves_the_old_one(results, tmp_path):
    out = tmp_path / "site"
    save_site(dict(list(results.items())[:1]), out, replays=False)
    before = sorted(path.name for path in out.rglob("*"))

    def interrupt(name):
        if name == "SlopeSlider-3-wood":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save_site(results, out, replays=False, progress=interrupt)
    assert sorted(path.name for path in out.rglob("*")) == before
    assert [path.name for path in tmp_path.iterdir()] == ["site"]


# --- numbers ---


def test_a_quantized_position_is_within_half_a_step():
    positions = np.random.default_rng(0).normal(size=(50, 3, 3)) * (1.0, 0.01, 0.0)
    one = quantized(positions)
    step, counts = (
        np.array(one["step"]),
        np.frombuffer(b64decode(one["data"]), "<i2").reshape(positions.shape),
    )
    assert (
        np.abs(one["centre"] + counts * step - positions) <= 0.5000001 * step + 1e-12
    ).all()
    np.testing.assert_allclose(step[:2], np.ptp(positions, axis=(0, 1))[:2] / 65534)


def test_the_ghost_has_the_real_values_along_the_measured_directions(results):
    result = next(
        one for one in results.values() if one.id == "GAUGE/SlopeSlider-2-wood"
    )
    experiment = load_experiment("SlopeSlider-2-wood")
    band = reference_band(experiment)
    ghost = replay_data(experiment, replay(result), band, label="", color="")["ghost"]
    places_mm = 1e3 * np.array(ghost["places"])[:, 0]
    # Rounded to 10 micrometres.
    np.testing.assert_allclose(band.project(places_mm), band.mean, atol=0.02)
    # Across the slope nothing was measured, so that the ghost stays in the plane of the start.
    across = np.linalg.svd(band.projection)[2][1:]
    np.testing.assert_allclose((places_mm - places_mm[0]) @ across.T, 0.0, atol=0.02)


def requests():
    return (
        RunRequest("SlopeSlider-2-wood", settings=SETTINGS, seed=3),
        RunRequest("SlopeSlider-2-wood", parameters={"cube.friction": 0.21}),
        RunRequest("BouncingBall-rubber", parameters="effective"),
        RunRequest(
            "SlopeSlider-2-wood",
            repeats=2,
            seed=1,
            jitter=Jitter(position_m=0.0015, angle_rad=0.01),
        ),
    )


@pytest.mark.parametrize(
    "request_", requests(), ids=["settings", "overrides", "set", "repeats"]
)
def test_the_command_of_a_page_makes_the_same_results(request_, tmp_path, gauge):
    made = list(run_many([request_]))
    command = run_command(made)
    words = [word.strip("'") for word in command.split()]
    run = gauge(*words[1:], "--out", tmp_path)
    assert run.exit_code == 0, run.output
    again = sorted(
        (load_result(file) for file in tmp_path.glob("*.json")),
        key=lambda one: one.seed or 0,
    )
    assert [one.seed for one in again] == [one.seed for one in made]
    for one, other in zip(made, again, strict=True):
        assert one.trajectory == other.trajectory
        assert one.settings == other.settings
