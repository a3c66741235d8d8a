"""Films of results, decoded again: frames, clock, ghost and panels are those of the episodes."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from approval import refused_calls
from opengl import needs_opengl
from PIL import Image

from gauge_envs.errors import (
    GaugeError,
    MissingExtraError,
    RenderError,
    VideoError,
)
from gauge_envs.evaluation.reference_path import reference_words
from gauge_envs.references.grades import BandGrade
from gauge_envs.rendering import renderer
from gauge_envs.rendering.camera import FIELD_OF_VIEW_DEG, experiment_view
from gauge_envs.runs import replay as replay_module
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.replay import ReplayError
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome
from gauge_envs.runs.result_file import load_result
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.film.film import (
    FilmOptions,
    film_times,
    results_of_one_experiment,
    save_film,
)
from gauge_envs.tools.film.layout import _Scale
from gauge_envs.tools.film.panel import SimulatedPanel, score_line, take_of

BALL = "BouncingBall-rubber"
SIZE = {"width": 160, "height": 120}
GHOST_FRAME = 9
"""Frame in which the mean of the real balls is well above the simulated one."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Results of the ball on two engines, with different restitutions."""
    pytest.importorskip("rapier3d", reason="extra 'rapier' is not installed")
    path = tmp_path_factory.mktemp("results")
    requests = [
        RunRequest(BALL),
        RunRequest(BALL, backend="rapier", parameters="effective"),
    ]
    list(run_many(requests, out=path))
    return path


@pytest.fixture(scope="module")
def results(folder):
    return {file: load_result(file) for file in sorted(folder.glob("*.json"))}


@pytest.fixture(scope="module")
def take(results):
    file, result = next(iter(results.items()))
    return take_of(result, file)


def picture_place():
    """Rows and columns of the first picture in a frame."""
    scale = _Scale(SIZE["height"])
    top = scale.gap + 2 * scale.large_line + scale.small_line
    return slice(top, top + SIZE["height"]), slice(scale.gap, scale.gap + SIZE["width"])


def decoded(file):
    """Frames of an MP4 and its rate."""
    imageio_ffmpeg = pytest.importorskip(
        "imageio_ffmpeg", reason="extra 'video' is not installed"
    )
    stream = imageio_ffmpeg.read_frames(str(file))
    facts = next(stream)
    width, height = facts["size"]
    return [
        np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in stream
    ], facts["fps"]


def shown(file):
    """Frames of a WebP or GIF, and its length [s]."""
    frames, length_ms = [], 0
    with Image.open(file) as image:
        for number in range(image.n_frames):
            image.seek(number)
            frames.append(np.asarray(image.convert("RGB")))
            length_ms += image.info["duration"]
    return frames, 1e-3 * length_ms


# --- frames and clock ------------------------------------------------------------------------------------------------


@needs_opengl
def test_an_mp4_has_the_frames_and_the_clock_of_the_episode(results, tmp_path):
    pytest.importorskip("imageio_ffmpeg", reason="extra 'video' is not installed")
    out = tmp_path / "folder" / "ball.mp4"
    options = FilmOptions(**SIZE, fps=10, speed=0.5)
    assert save_film(results, out, options) == []
    frames, fps = decoded(out)
    # The ball has 18 frames at 30 Hz, so 17/30 s: 11 steps of 0.05 s, the first picture, and 10 that hold the last one.
    assert (len(frames), fps) == (12 + 10, 10.0)
    panel_width = SIZE["width"] + _Scale(SIZE["height"]).gap
    assert frames[0].shape[1] == 2 * panel_width + _Scale(SIZE["height"]).gap
    assert frames[0].shape[0] % 2 == 0
    file, result = next(iter(results.items()))
    panel = SimulatedPanel(take_of(result, file), title="", detail="", **SIZE)
    rows, columns = picture_place()
    distances = []
    for time_s in (0.2, 0.25, 0.3):
        expected = panel.picture(time_s).astype(int)
        distances.append(
            [np.abs(frame[rows, columns] - expected).mean() for frame in frames]
        )
    panel.close()
    # The picture of each time is nearest to the frame that the clock gives it.
    assert np.argmin(distances, axis=1).tolist() == [4, 5, 6]
    assert np.min(distances) < 3.0


@needs_opengl
@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".webp", ".gif"])
def test_other_formats_have_the_length_of_the_film(results, tmp_path, suffix):
    out = tmp_path / f"ball{suffix}"
    save_film(results, out, FilmOptions(**SIZE, fps=24, speed=1.0, to_s=0.25))
    frames, length_s = shown(out)
    # Equal frames may be joined; a tick of a GIF is 10 ms.
    assert len({frame.tobytes() for frame in frames}) == 7
    assert length_s == pytest.approx((7 + 24) / 24, abs=0.0051)


def test_slow_films_use_more_views_of_the_episode():
    assert FilmOptions(fps=30.0).views_per_frame == 1
    assert FilmOptions(fps=30.0, speed=0.5).views_per_frame == 2
    assert FilmOptions(fps=30.0, speed=0.1).views_per_frame == 6
    assert film_times(
        FilmOptions(fps=25.0, speed=0.2, from_s=0.1), 0.2
    ) == pytest.approx(0.1 + 0.008 * np.arange(13))


# --- ghost -----------------------------------------------------------------------------------------------------------


def pixel(scene_point_m, take, width, height):
    """Column and row of a point, by a pinhole camera of its own."""
    view = experiment_view(
        take.experiment, aspect=width / height, reference=take.reference
    )
    azimuth, elevation = np.radians([view.azimuth_deg, view.elevation_deg])
    forward = np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    right = np.array([np.sin(azimuth), -np.cos(azimuth), 0.0])
    up = np.cross(right, forward)
    away = scene_point_m - (view.target_m - view.distance_m * forward)
    scale = (
        0.5 * height / np.tan(np.radians(0.5 * FIELD_OF_VIEW_DEG)) / (away @ forward)
    )
    return (
        np.array(
            [0.5 * width + scale * (away @ right), 0.5 * height - scale * (away @ up)]
        )
        - 0.5
    )


def ghost_error_px(take, shift_m=0.0):
    """Distance of the drawn ghost from the projection of the mean of the band [pixels]."""
    assert take.reference is not None and take.band is not None
    width, height = 320, 240
    # One known frame has no path, so that the ghost and its point alone are drawn.
    places_m = np.full_like(take.reference.places_m, np.nan)
    places_m[GHOST_FRAME] = take.reference.places_m[GHOST_FRAME] + [0.0, 0.0, shift_m]
    time_s = GHOST_FRAME / FRAME_RATE_HZ
    pictures = []
    for known_m in (np.full_like(places_m, np.nan), places_m):
        drawn = replace(take, reference=replace(take.reference, places_m=known_m))
        panel = SimulatedPanel(drawn, title="", detail="", width=width, height=height)
        pictures.append(panel.picture(time_s).astype(int))
        panel.close()
    changed = np.abs(pictures[1] - pictures[0]).max(axis=2) > 8
    seen = np.flatnonzero(changed.any(axis=0)), np.flatnonzero(changed.any(axis=1))
    middle = np.array([0.5 * (places.min() + places.max()) for places in seen])
    # The band of the ball is of its height.
    start_m = np.array(take.experiment.scene.body("ball").pose.position_m)
    mean_m = np.array([*start_m[:2], 1e-3 * float(take.band.mean[GHOST_FRAME, 0])])
    return float(np.linalg.norm(middle - pixel(mean_m, take, width, height)))


@needs_opengl
def test_the_ghost_is_where_the_mean_of_the_band_is(take):
    assert ghost_error_px(take) < 1.5
    # A ghost that is drawn 20 mm too high is seen.
    assert ghost_error_px(take, shift_m=0.02) > 4.0


def test_what_a_reference_is_in_words():
    assert reference_words(BandGrade.TRIALS, 20) == "the mean of 20 real trials"
    assert reference_words(BandGrade.TRIALS, 1) == "one real trial"
    assert reference_words(BandGrade.RECORDING, None) == "one recorded real trial"


def test_a_line_of_scores_has_the_numbers_of_the_result(take):
    score = take.result.score
    assert score.validation.rmse_aligned_normalized_95 is not None
    low, high = score.validation.rmse_aligned_normalized_95
    line = score_line(take.result, take.band)
    assert line.startswith(
        f"RMSE aligned {score.validation.rmse_aligned_normalized:.2f} [{low:.2f}, {high:.2f}]"
    )
    lost = replace(
        take.result, outcome=Outcome.DIVERGED, diverged_reason="left the room"
    )
    assert score_line(lost, take.band) == "diverged: left the room"


# --- panels ----------------------------------------------------------------------------------------------------------


@needs_opengl
def test_panels_differ_where_their_bodies_do(results):
    takes = [take_of(result, file) for file, result in results.items()]
    plain = [replace(one, reference=None) for one in takes]
    panels = [
        SimulatedPanel(one, title="", detail="", width=320, height=240) for one in plain
    ]
    start, end = (
        [panel.picture(time_s).astype(int) for panel in panels]
        for time_s in (0.0, panels[0].last_s)
    )
    for panel in panels:
        panel.close()
    assert np.abs(start[1] - start[0]).max() <= 12
    changed = np.abs(end[1] - end[0]).max(axis=2) > 12
    # Software rasterizers change a single pixel now and then.
    rows = np.flatnonzero(changed.sum(axis=1) > 3)
    places = [one.replay.poses[-1, 0, :3].astype(float) for one in takes]
    # The balls at the end are apart by more than a ball; their pictures span what has changed.
    radius_m = takes[0].experiment.scene.body("ball").shape.radius_m
    view = experiment_view(
        takes[0].experiment, aspect=320 / 240, reference=takes[0].reference
    )
    tops = [
        pixel(place + radius_m * view.axes[1], takes[0], 320, 240)[1]
        for place in places
    ]
    assert abs(tops[0] - tops[1]) > 10
    assert rows.min() == pytest.approx(min(tops), abs=2)


@needs_opengl
def test_a_result_without_its_engine_has_no_panel_and_a_reason(
    folder, tmp_path, monkeypatch, gauge
):
    versions_of = replay_module.versions_of

    def without_rapier(name):
        if name == "rapier":
            gone = ImportError("no rapier3d", name="rapier3d")
            raise MissingExtraError("backend 'rapier'", "rapier", gone)
        return versions_of(name)

    for file in folder.glob("*.npz"):
        file.unlink()
    monkeypatch.setattr(replay_module, "versions_of", without_rapier)
    out = tmp_path / "ball.mp4"
    shape = ["--width=160", "--height=120", "--until=0.1"]
    run = gauge("video", "film", folder, "--out", out, *shape)
    assert run.exit_code == 1
    assert "left out: BouncingBall-rubber.rapier.effective.json" in run.stderr
    assert "gauge-envs[rapier]" in run.stderr
    assert out.is_file()
    rapier = next(folder.glob("*.rapier.*.json"))
    with pytest.raises(ReplayError, match=r"no result can be drawn: .*rapier3d"):
        save_film({rapier: load_result(rapier)}, out, FilmOptions(**SIZE))


# --- errors ----------------------------------------------------------------------------------------------------------


@needs_opengl
def test_films_that_cannot_be_made_are_named(results, tmp_path, approved):
    (tmp_path / "file").touch()
    file, one = next(iter(results.items()))
    slider = Path("b.json")
    mixed = {file: one, slider: replace(one, id="GAUGE/SlopeSlider-2-wood")}
    many = {Path(f"{number}.json"): one for number in range(14)}

    def film(name="a.gif", shown=results, **options):
        return lambda: save_film(shown, tmp_path / name, FilmOptions(**SIZE | options))

    calls = {
        "two experiments": lambda: results_of_one_experiment(mixed),
        "another experiment": lambda: results_of_one_experiment(mixed, "Funnel-satin"),
        "no result": lambda: results_of_one_experiment({}),
        "width": film(width=10),
        "fps": film(fps=0.0),
        "speed": film(speed=float("nan")),
        "to_s": film(from_s=2.0, to_s=1.0),
        "format": film("a.avi"),
        "span": film(from_s=9.0),
        "frames": film(speed=0.001, fps=120.0),
        "panels": film(shown=many),
    }
    approved("film/refused_films", refused_calls(GaugeError, calls))
    with pytest.raises(VideoError, match=r"a\.gif: cannot be written"):
        film("file/a.gif", fps=2)()
    assert list(tmp_path.glob("a*")) == []
    chosen = results_of_one_experiment(mixed, "GAUGE/SlopeSlider-2-wood")
    assert list(chosen) == [slider]


def test_wrong_commands_are_named(folder, tmp_path, gauge):
    content = json.dumps({"id": "GAUGE/BouncingBall-rubber"})
    (tmp_path / "a.json").write_text(content, encoding="utf-8")
    damaged = gauge("video", "film", "a.json", "--out", "a.gif")
    assert damaged.exit_code == 2 and "not a result file" in damaged.stderr
    assert not (tmp_path / "a.gif").exists()


def test_an_mp4_without_its_extra_names_it(results, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingExtraError, match=r"a film needs.*gauge-envs\[video\]"):
        save_film(results, tmp_path / "a.mp4", FilmOptions(**SIZE))


def test_without_opengl_there_is_an_error_and_no_film(results, tmp_path, monkeypatch):
    def refuse(width, height):
        raise RenderError("no off-screen OpenGL")

    monkeypatch.setattr(renderer, "_graphics_context", refuse)
    with pytest.raises(RenderError, match="no off-screen OpenGL"):
        save_film(results, tmp_path / "a.gif", FilmOptions(**SIZE))
    assert not (tmp_path / "a.gif").exists()


@needs_opengl
@pytest.mark.parametrize(
    "suffix", [".mp4", pytest.param(".gif", marks=pytest.mark.slow)]
)
def test_an_interrupted_film_leaves_the_earlier_one(results, tmp_path, suffix):
    if suffix == ".mp4":
        pytest.importorskip("imageio_ffmpeg", reason="extra 'video' is not installed")
    out = tmp_path / f"ball{suffix}"
    out.write_bytes(b"earlier")

    def interrupt(done, total):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save_film(results, out, FilmOptions(**SIZE, fps=10), progress=interrupt)
    assert out.read_bytes() == b"earlier"
    assert [file.name for file in tmp_path.iterdir()] == [out.name]
