"""The static site shows the numbers of the results, escapes texts, and replaces an old site completely."""

import re
from base64 import b64decode
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from gauge_envs.errors import GaugeError, ResultFileError
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.motion import load_motion, motion_file
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result_file import load_result, recorded_experiment, write_result
from gauge_envs.scoring.reference import reference_band
from gauge_envs.tools.site import save_site
from gauge_envs.tools.site.motion_view import motion_view_data

SLIDE = "SlopeSlider-2-wood"
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
        links = [
            attributes.get("href") or attributes.get("src")
            for _, attributes in self.elements
        ]
        return [link for link in links if link and not link.startswith("data:")]


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    # A cube with a changed friction has no reference.
    parameters_of = {"SlopeSlider-3-wood": {"cube.friction": 0.2}}
    requests = [
        RunRequest(
            name, settings=settings, parameters=parameters_of.get(name, "published")
        )
        for name in (SLIDE, "NonsmoothContact-3-wood", "SlopeSlider-3-wood")
        for settings in (None, SETTINGS)
    ]
    list(run_many(requests, out=folder))
    return {file: load_result(file) for file in sorted(folder.glob("*.json"))}


@pytest.fixture(scope="module")
def slide(results):
    file, result = next(
        (file, result) for file, result in results.items() if result.id.endswith(SLIDE)
    )
    return replace(result, motion=load_motion(motion_file(file)))


@pytest.fixture(scope="module")
def site(results, tmp_path_factory):
    out = tmp_path_factory.mktemp("site") / "site"
    assert save_site(results, out) == ()
    return out


def test_pages_show_the_scores_of_the_results(site, results):
    assert len(list(site.glob("*.html"))) == 1 + 3
    for result in results.values():
        page = Page(site / f"experiment-{result.id.removeprefix('GAUGE/')}.html")
        assert result.score.summary() in page.text
        assert f"timestep_s = {result.settings['timestep_s']}" in page.texts
        if result.score.primary_normalized is not None:
            value = f"{result.score.primary_normalized:.2f}"
            assert value in page.text
            assert value in Page(site / "index.html").text
    assert "Distances between engines" in page.text


def test_links_lead_to_files_of_the_site_and_pages_load_nothing_else(site):
    pages = list(site.glob("*.html"))
    for page in pages:
        assert Page(page).links
        for link in Page(page).links:
            assert (site / link).is_file(), f"{page.name}: {link}"
    for file in (*pages, site / "assets" / "motion_view.js"):
        text = re.sub(r"base64,[^\"]*", "", file.read_text())
        assert not re.search(r"https?://|//[a-z]+\.[a-z]|@import|url\(", text)


def test_texts_of_a_result_file_are_escaped(slide, tmp_path):
    script = '"><script>alert(1)</script>'
    hostile = replace(
        slide,
        backend=script,
        settings_given={script: script},
        versions={**slide.versions, script: script},
        score=replace(slide.score, unit=script),
    )
    out = tmp_path / "site"
    save_site({tmp_path / "a.json": hostile}, out, motion_views=False, command=script)
    for file in out.glob("*.html"):
        assert "script" not in dict(Page(file).elements)
    assert script in Page(out / "index.html").text


# --- the folder ---


def test_a_folder_with_other_content_is_rejected(results, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(ResultFileError, match="not a site of gauge report"):
        save_site(results, tmp_path, motion_views=False)
    assert (tmp_path / "thesis.txt").read_text() == "mine"


def test_only_a_complete_site_replaces_the_old_site(results, tmp_path):
    out = tmp_path / "site"
    save_site(results, out, motion_views=False)
    file = next(iter(results))
    save_site({file: results[file]}, out, motion_views=False)
    pages = sorted(out.rglob("*"))
    assert len(list(out.glob("experiment-*.html"))) == 1

    def interrupt(name):
        if name == "SlopeSlider-3-wood":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save_site(results, out, motion_views=False, progress=interrupt)
    assert sorted(out.rglob("*")) == pages
    assert [path.name for path in tmp_path.iterdir()] == ["site"]


# --- 3D views ---


def test_a_scene_in_the_model_file_of_an_engine_has_no_3d_view(slide):
    asset = {"file": "slide.xml", "kind": "model"}
    with pytest.raises(GaugeError, match=r"slide\.xml"):
        motion_view_data(replace(slide, asset=asset), slide.motion)


@pytest.mark.parametrize("content", [None, b"", b"PK of another archive"])
def test_a_page_names_the_missing_or_damaged_motion(content, slide, tmp_path):
    file = tmp_path / "a.json"
    write_result(slide, file)
    motion_file(file).unlink()
    if content is not None:
        motion_file(file).write_bytes(content)
    (note,) = save_site({file: load_result(file)}, tmp_path / "site")
    assert str(motion_file(file)) in note
    assert "gauge run" in note


def unpacked(packed):
    return np.frombuffer(b64decode(packed["data"]), "<i2") * packed["step"]


def test_the_data_have_the_slope_of_the_cube_and_real_values_as_ghost(slide):
    data = motion_view_data(slide, slide.motion)
    cosine = unpacked(data["turns"])[3]
    assert np.degrees(2.0 * np.arccos(abs(cosine))) == pytest.approx(30.0, abs=0.1)
    places_mm = 1e3 * unpacked(data["positions"]).reshape(-1, 3)
    # The result has 180 samples per second, and the 3D view has 60 views per second.
    assert data["rate"] == 60.0
    _, values = slide.trajectory.arrays()
    np.testing.assert_allclose(places_mm, values[::3], atol=0.02)
    band, ghost = reference_band(recorded_experiment(slide)), data["ghost"]
    places_mm = 1e3 * np.array(ghost["places"])[:, 0]
    np.testing.assert_allclose(band.project(places_mm), band.mean, atol=1e-6)
    # Motion across the slope was not measured, so the ghost stays in its initial plane.
    across = np.linalg.svd(band.projection)[2][1:]
    np.testing.assert_allclose((places_mm - places_mm[0]) @ across.T, 0.0, atol=1e-6)
