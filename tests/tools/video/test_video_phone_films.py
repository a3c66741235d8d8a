"""Films of one's own: a board to print, a camera held by hand, and what the motion says of the material."""

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from places import ROOT

cv2 = pytest.importorskip("cv2")

from clips import track_of  # noqa: E402
from handheld import SIZE_PX, shot  # noqa: E402
from PIL import Image  # noqa: E402

from gauge_envs.errors import ParameterError, VideoError  # noqa: E402
from gauge_envs.tools.video import score_track, video_task  # noqa: E402
from gauge_envs.tools.video.board import board_poses, charuco  # noqa: E402
from gauge_envs.tools.video.check import (  # noqa: E402
    check_film,
    edge_blur_px,
    moved_box,
)
from gauge_envs.tools.video.frames import ArrayFrames  # noqa: E402
from gauge_envs.tools.video.phone_films import (  # noqa: E402
    FrontalFilm,
    resistance,
    restitution,
    score_phone_film,
)
from gauge_envs.tools.video.plane import (  # noqa: E402
    Board,
    Calibration,
    CameraFile,
    Lens,
    read_camera,
)
from gauge_envs.tools.video.words import TITLES  # noqa: E402


def filmed(gauge, one, motion, *words):
    """Score a shot with its camera file and the box of its object."""
    box = ",".join(f"{value:.1f}" for value in one.box_px)
    given = ["--id", motion, f"--object={box}", "--camera", one.camera]
    return gauge("video", "score", one.video, *given, *words)


@pytest.mark.parametrize("suffix", [".png", ".pdf"])
def test_a_printed_board_has_its_size(tmp_path, suffix, gauge):
    file = tmp_path / f"board{suffix}"
    outcome = gauge("video", "board", file, "--square=30")
    assert outcome.exit_code == 0, outcome.output
    if suffix == ".pdf":
        # The box of the page is in points of 1/72 inch: 8 squares across, 6 down.
        assert b"/MediaBox [ 0 0 680." in file.read_bytes()
        assert 680 < 8 * 30 / 25.4 * 72 < 681
        return
    picture = Image.open(file)
    mm_per_px = 25.4 / picture.info["dpi"][0]
    corners, ids, *_ = cv2.aruco.CharucoDetector(charuco()).detectBoard(
        np.asarray(picture)
    )
    places = corners.reshape(-1, 2) * mm_per_px
    assert len(ids) == 24
    assert np.linalg.norm(places[5] - places[0]) == pytest.approx(5 * 30.0, rel=1e-3)


@pytest.mark.slow
def test_a_phone_gives_friction_and_the_recipe_reaches_it(tmp_path, gauge):
    one = shot("slide", 5, tmp_path)
    outcome = filmed(gauge, one, "slide", "--out", tmp_path / "drawn", "--json")
    assert outcome.exit_code == 0, outcome.output
    found = json.loads(outcome.stdout)
    low, high = found["uncertainty"]["friction"]
    assert low <= one.truth <= high and high - low < 0.15
    friction = found["metrics"]["friction"]
    assert friction == pytest.approx(one.truth, abs=0.03)
    assert (tmp_path / "drawn" / f"{one.video.stem}.overlay.mp4").exists()
    asked = [
        f"--friction={friction:.3f}",
        "--mass=0.1",
        "--set=timestep_s=0.002",
        "--json",
    ]
    for engine in ("mujoco", "pybullet"):
        recipe = gauge("recipe", *asked, "--backend", engine)
        assert recipe.exit_code == 0 and json.loads(recipe.stdout)["misses"] == []


@pytest.mark.slow
@pytest.mark.parametrize("motion", ["slide", "roll", "fall", "pendulum"])
def test_three_films_hold_the_truth(motion, tmp_path, gauge):
    for seed in (6, 7, 8):
        one = shot(motion, seed, tmp_path, fps=30.0 if motion == "pendulum" else 60.0)
        outcome = filmed(gauge, one, motion, "--json")
        low, high = json.loads(outcome.stdout)["uncertainty"][one.name]
        assert low <= one.truth <= high, (seed, one.truth, low, high)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "wrong", "reason"),
    [
        (
            "fall",
            ["--fps=15"],
            r"gravity is (2\.[345]\d) m/s\^2: give --fps of the camera",
        ),
        (
            "pendulum",
            ["--fps=15"],
            r"gravity is (2\.[345]\d?) m/s\^2: give --fps of the camera",
        ),
        ("slide", [], "friction is below 0: .* check the camera file"),
        ("roll", [], "rolling_resistance is below 0: .* check the camera file"),
    ],
)
def test_slow_motion_and_a_board_in_millimetres_are_not_sound(
    motion, wrong, reason, tmp_path, gauge
):
    one = shot(motion, 335, tmp_path, fps=30.0)
    sound = filmed(gauge, one, motion)
    assert "the track is sound" in sound.output
    assert TITLES[one.name] in sound.output
    if not wrong:
        text = one.camera.read_text()
        one.camera.write_text(text.replace("square_m = 0.035", "square_m = 35"))
    outcome = filmed(gauge, one, motion, *wrong)
    assert "the track is not sound" in outcome.output
    assert re.search(reason, " ".join(outcome.output.split())), outcome.output


EDGE_M = 0.05
BOARD_VIEW = CameraFile(
    size_px=SIZE_PX, board=Board(square_m=0.03, offset_m=0.0, offset_sigma_m=0.0)
)
GREY = ArrayFrames([np.full((*SIZE_PX[::-1], 3), 120, np.uint8)] * 9, fps=30.0)


@pytest.mark.parametrize(
    ("size_px", "words"),
    [
        (SIZE_PX, "8 corners of the board must be seen .* 9 of 9 lack them: 0, 1, 2"),
        ((640, 480), "the camera file states"),
    ],
)
def test_a_film_without_the_board_says_how_many_frames_lack_it(size_px, words):
    with pytest.raises(VideoError, match=words):
        FrontalFilm(GREY, BOARD_VIEW.model_copy(update={"size_px": size_px}))


def wall_film(*, off_level_deg=0.0, yaw_deg=0.0, frames=30, lasts=True):
    """Return a film at 30 Hz of a square that slides by 30 degrees on the wall of its board, seen from 1 m.

    The board is off level, and the camera to its right, by these angles; the square stays where it is unless it lasts.
    The friction is 0.2, from the third frame on.
    """
    px_per_m = 1000.0
    board = charuco().generateImage((210, 150))
    to_wall = cv2.getRotationMatrix2D((105, 75), -off_level_deg, 1.0)
    to_wall[:, 2] += (0.5 * px_per_m - 105, 0.5 * px_per_m - 75)
    wall = np.full((int(px_per_m), int(px_per_m), 3), 200, np.uint8)
    cv2.warpAffine(
        cv2.cvtColor(board, cv2.COLOR_GRAY2BGR),
        to_wall,
        wall.shape[:2],
        dst=wall,
        borderMode=cv2.BORDER_TRANSPARENT,
    )
    turn = cv2.Rodrigues(np.array([0.0, math.radians(yaw_deg), 0.0]))[0]
    # Places on the wall [px] in the frame of the camera [m]: to the right, down and away.
    plane = np.array([[1, 0, -500], [0, 1, -500], [0, 0, px_per_m]]) / px_per_m
    plane = turn @ np.diag([1.0, 1.0, 0.0]) @ plane + np.array(
        [[0, 0, 0], [0, 0, 0], [0, 0, 1.0]]
    )
    lens = np.array([[1500.0, 0, 640], [0, 1500.0, 360], [0, 0, 1]])
    a_m_s2 = 9.80665 * (math.sin(math.pi / 6) - 0.2 * math.cos(math.pi / 6))
    pictures = []
    for number in range(frames):
        away_m = 0.5 * a_m_s2 * (max(number - 2, 0) / 30.0) ** 2 if lasts else 0.0
        low = np.array([0.33, 0.15]) + away_m * np.array(
            [-math.cos(math.pi / 6), -math.sin(math.pi / 6)]
        )
        corners = low * (1, -1) + EDGE_M * np.array([[0, 0], [1, 0], [1, -1], [0, -1]])
        shown = wall.copy()
        cv2.fillConvexPoly(
            shown, (16 * (px_per_m * corners + 500)).astype(int), (40, 60, 150), 16, 4
        )
        shown = cv2.GaussianBlur(shown, (0, 0), 1.0)
        pictures.append(cv2.warpPerspective(shown, lens @ plane, SIZE_PX)[..., ::-1])
    return ArrayFrames(pictures, fps=30.0)


def test_a_film_says_what_it_shows_before_it_is_scored():
    findings, picture = check_film(
        wall_film(yaw_deg=20.0, off_level_deg=4.0, frames=14), BOARD_VIEW
    )
    texts = {one.name: one.text for one in findings}
    assert not any(one.advice for one in findings), findings
    assert re.match(
        r"the board is turned by (3\.[6-9]|4\.[0-4]) degrees.*level\?", texts["level"]
    )
    assert re.match(
        r"the camera looks at it from (19|20|21) degrees to the", texts["parallel"]
    )
    assert "14 of 14 frames show it" in texts["board"]
    level = {
        one.name: one.text for one in check_film(wall_film(frames=14), BOARD_VIEW)[0]
    }
    box = re.match(
        r"--object [\d,]+, (\d+) x (\d+) mm, \d+ px when judged: is this the object",
        level["object"],
    )
    for edge_mm in map(float, box.groups()):
        assert edge_mm == pytest.approx(1e3 * EDGE_M, abs=3.0)
    assert picture.shape == (*SIZE_PX[::-1], 3)


def test_a_film_in_which_nothing_moves_or_no_board_is_seen_says_what_to_mend():
    findings, _ = check_film(wall_film(lasts=False, frames=9), BOARD_VIEW)
    assert [one.name for one in findings if one.advice] == ["object"]
    findings, _ = check_film(GREY, BOARD_VIEW)
    assert findings[-1].name == "board" and "8 corners" in findings[-1].advice


def test_a_camera_that_faces_the_board_does_not_tell_its_focal_length():
    film, board = wall_film(frames=3), BOARD_VIEW.board
    faces = board_poses(film, BOARD_VIEW)[0]
    aside = board_poses(wall_film(yaw_deg=20.0, frames=3), BOARD_VIEW)[0]
    for pose, largest in ((faces, 0.3), (aside, 0.03)):
        error = math.log(pose.lens.matrix[0][0] / 1500.0)
        assert abs(error) < 2.0 * pose.focal_sigma < 2.0 * largest
    # What is 35 mm before the board has an unknown scale then.
    behind = board.model_copy(update={"offset_m": 0.035})
    before = BOARD_VIEW.model_copy(update={"board": behind})
    advice = [one.advice for one in check_film(film, before)[0] if one.name == "camera"]
    assert advice == ["state its [lens], or let it look from the side"]


@pytest.mark.parametrize("sigma_px", [1.5, 3.0])
def test_the_blur_of_edges_is_that_of_the_gaussian_that_made_them(sigma_px):
    board = cv2.cvtColor(charuco().generateImage((700, 500)), cv2.COLOR_GRAY2BGR)
    blurred = cv2.GaussianBlur(board, (0, 0), sigma_px)
    corners = np.array([[100.0, 100.0], [600.0, 400.0]])
    assert edge_blur_px(blurred, corners) == pytest.approx(sigma_px, rel=0.2)


@pytest.mark.slow
def test_a_board_that_is_not_level_contradicts_the_stated_slope():
    for off_deg, is_sound in ((0.0, True), (4.0, False)):
        film = FrontalFilm(wall_film(off_level_deg=off_deg), BOARD_VIEW)
        result = score_phone_film(film, "slide", moved_box(film), angle_deg=30.0)
        assert result.is_sound is is_sound, result.reasons
        told = any("is the board level, upright" in one for one in result.reasons)
        assert told is not is_sound
        if is_sound:
            assert result.metrics["friction"] == pytest.approx(0.2, abs=0.02)


def test_a_film_from_aside_sees_the_plane_from_the_front():
    lens = Lens(matrix=((1500.0, 0.0, 640.0), (0.0, 1500.0, 360.0), (0.0, 0.0, 1.0)))
    known = BOARD_VIEW.model_copy(update={"lens": lens})
    film = FrontalFilm(wall_film(yaw_deg=20.0, lasts=False, frames=3), known)
    blue, _, red = next(film.native()).transpose(2, 0, 1).astype(int)
    rows, columns = np.nonzero(red - blue > 55)
    # OpenCV fills a pixel of the edge more, of 50.
    assert len(rows) == pytest.approx((EDGE_M / film.scale) ** 2, rel=0.08)
    assert np.ptp(rows) == pytest.approx(np.ptp(columns), abs=2.0)
    seen = track_of(np.array([[columns.mean(), rows.mean()]]), 30.0)
    # The square stands 330 to 380 mm to the right of the middle of the board, and 150 to 200 mm above it.
    assert film.in_plane(seen).points_px[0] == pytest.approx([355.0, 175.0], abs=1.5)


def test_rebounds_give_the_restitution():
    task = video_task("BouncingBall-rubber")
    times, e, height = np.arange(80) / 60.0, 0.7, 0.5
    impact = 0.1 + math.sqrt(2.0 * height / 9.81)
    flight = 2.0 * e * 9.81 * (impact - 0.1) / 9.81
    late = np.where(times < impact + flight, times - impact, times - impact - flight)
    speed = np.where(times < impact + flight, e, e**2) * 9.81 * (impact - 0.1)
    fallen = height - 0.5 * 9.81 * np.maximum(times - 0.1, 0.0) ** 2
    heights = np.where(times < impact, fallen, speed * late - 0.5 * 9.81 * late**2)
    used = times < impact + flight * (1.0 + 0.9 * e)
    places = np.column_stack(
        [np.full(used.sum(), 300.0), -heights[used] / task.scale_m_per_px]
    )
    assert restitution(track_of(places, 60.0), task) == pytest.approx(e, abs=1e-6)
    with pytest.raises(ParameterError, match="two flights"):
        restitution(track_of(places[:30], 60.0), task)


def test_a_ball_that_rolls_is_no_slide():
    # Without slip a = g (sin t - c cos t) / (1 + k), Goldstein, Classical Mechanics, section 2.4 for c = 0.
    slope, c, k = math.radians(20.0), 0.02, 0.4
    a_m_s2 = 9.80665 * (math.sin(slope) - c * math.cos(slope)) / (1.0 + k)
    rolled_m = 0.5 * a_m_s2 * np.maximum(np.arange(60) / 60.0 - 0.25, 0.0)[:, None] ** 2
    task = replace(
        video_task("SlopeSlider-2-wood"),
        direction=(-math.cos(slope), math.sin(slope)),
    )
    places = task.centre_px + rolled_m / task.scale_m_per_px * task.direction
    exact = Calibration(points_px=places[:0], sigma_px=0.0)
    result = score_track(track_of(places, 60.0), task, calibration=exact)
    rolled, ends = resistance(result, task, None, k)
    assert (
        rolled == pytest.approx(c, abs=1e-3)
        and ends is not None
        and ends[0] < c < ends[1]
    )
    # Judged as a slide it seems to have two sevenths of the tangent as friction; a hollow ball would push itself.
    assert resistance(result, task, None, 0.0)[0] == pytest.approx(
        (k * math.tan(slope) + c) / (1.0 + k), abs=1e-3
    )
    wrong = resistance(result, task, None, 2.0 / 3.0)[1]
    assert wrong[1] < 0.0


def test_places_scatter_as_the_points_that_they_are_placed_by():
    points = np.array([[200.0, 100.0], [600.0, 100.0], [600.0, 400.0], [200.0, 400.0]])
    calibration, rng = (
        Calibration(points_px=points, sigma_px=2.0),
        np.random.default_rng(4),
    )
    drawn = np.array([calibration.drawn(points, rng) for _ in range(400)])
    assert drawn.mean(axis=0) == pytest.approx(points, abs=0.5)
    assert drawn.std(axis=0) == pytest.approx(np.full((4, 2), 2.0), rel=0.15)


def test_the_camera_file_of_the_guide_is_read(tmp_path):
    page = (ROOT / "docs" / "world_models.md").read_text()
    blocks = re.findall(r"^```toml\n(.*?)^```$", page, flags=re.MULTILINE | re.DOTALL)
    (text,) = (text for text in blocks if "size_px" in text)
    (tmp_path / "camera.toml").write_text(text)
    assert read_camera(tmp_path / "camera.toml").board.square_m == 0.03
