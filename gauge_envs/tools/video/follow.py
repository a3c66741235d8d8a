"""Find an object in the frames of a video: the places of each frame that may show it.

No learned model is used, so a text prompt is not needed: the first frame of each task is known.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Picture, cv2
from gauge_envs.tools.video.tasks import (
    PLATE_RADIUS_PX,
    REFERENCE_SIZE_PX,
    SLOPE_DIRECTION,
    Motion,
    VideoTask,
)

COARSE, REACH = 0.25, 8
"""Scale at which the whole picture is searched, and distance from a found place within which it is refined [px]."""

CHANGED = 30
"""Difference of a colour channel with which a pixel has changed since the first frame."""

ADAPTATION = 0.05
"""Share of a frame that the background takes over where nothing moves: generated scenes drift."""

HIDDEN, CORE = 1.1, 0.3
"""Half of the part of the first frame that an object and its shadow may hide, and of its core, in sizes."""

LEAST_OFF, MOST_OFF = 0.1, 0.5
"""Distances from the line of a slide between which an outline may float across it, in sizes."""

PART = 0.2
"""Least width of what is seen of an object that stops in that part of the last frame, in sizes."""

MOST_CANDIDATES = 6
"""Most places of a frame that may show the object."""

LEAST_RESPONSE = 0.4
"""Smallest difference of the covered share in the outline and around it that may be an object."""

GAP, AROUND = 1.12, 1.5
"""Outlines between which the surroundings lie, in sizes of the object."""

LEAST_CONTRAST = 40.0
"""Distance of the colours of background and object from which a pixel says which of both it shows."""

LEAST_KNOWN_SHARE = 0.25
"""Smallest share of the outline before such a background."""

LINE, NEAR_LINE, LEAST_KNOWN_LINE = 1.5, 0.75, 0.9
"""Half of the length of the lines along the motion by which size and shape are measured, and of their parts at the
object, in sizes, and smallest share of those parts before another colour than the object's."""

GAP_SHARE = 0.15
"""Covered share, in the largest along the motion, below which there is a gap."""

NOISE_SHARE = 0.15
"""Covered share that noise and texture leave to the bare background."""

TINT, TINT_RANGE = 10.0, 20.0
"""Difference of a colour, at any brightness, that is still the object's, and that at which likeness falls to 1/e."""


@dataclass(kw_only=True)
class Sight:
    """Where the object may be in one frame.

    Attributes:
        place: Horizontal and vertical position [px], shape [2]; NaN when not found.
        likeness: Likeness of shape and colour to the object in the first frame, from 0 to 1.
        size_ratio: Apparent size against that in the first frame.
        misfit: Difference of its profile across the motion from that of its outline, in parts of the area.
        tint: Difference of its colour from the object's in the first frame at any brightness, in levels of 255.
    """

    place: FloatArray = field(default_factory=lambda: np.full(2, np.nan))
    likeness: float = 0.0
    size_ratio: float = math.nan
    misfit: float = 0.0
    tint: float = 0.0


def shrunk(picture: NDArray[Any]) -> NDArray[np.float32]:
    """Return a picture at the scale at which it is searched and compared."""
    small = cv2.resize(
        picture, None, fx=COARSE, fy=COARSE, interpolation=cv2.INTER_AREA
    )
    return np.asarray(small, dtype=np.float32)


class ShapeFollower:
    """Finds where an object of known outline and colour covers a known background.

    A pixel between the colours of background and object is covered in part: motion blur keeps its centre. Where both
    have the same colour, the picture says nothing, and the pixel does not count. The object's look is that of the first
    frame and is never renewed, so that nothing else is learnt.

    Args:
        first: The first frame.
        last: The last frame, which shows what the object hid in the first one.
        task: The task; a cube on a slope keeps its direction.
    """

    def __init__(self, first: Picture, last: Picture, task: VideoTask) -> None:
        self._task, self._size_px = task, task.size_px
        self._start = start = np.array(task.rest_px or task.centre_px)
        self._profile_px: FloatArray | None = None
        self._added_px: tuple[float, float] | None = None
        self._colour = _look(first, start, task.size_px)
        self._half = math.ceil(0.5 * AROUND * task.size_px) + 2
        self._outline = self._drawn(1.0)
        self._around = np.maximum(self._drawn(AROUND) - self._drawn(GAP), 0.0)
        scene = first
        if task.motion is not Motion.CRADLE:
            scene = _uncovered(first, last, start, task.size_px)
        self._scene = scene.astype(np.float32)

    def candidates(self, picture: Picture) -> list[Sight]:
        """Return the places of a frame that may show the object, and let the background follow the frame."""
        bare = shrunk(self._scene)
        covered, known = _covered(shrunk(picture), bare, self._colour)
        inside, around = shrunk(self._outline), shrunk(self._around)
        margin = len(inside) // 2
        sides = [margin] * 4
        response = _response(
            cv2.copyMakeBorder(covered, *sides, cv2.BORDER_CONSTANT),
            cv2.copyMakeBorder(known, *sides, cv2.BORDER_CONSTANT),
            inside,
            around,
        )
        reach = 2 * int(0.25 * self._size_px * COARSE) + 3
        highest = cv2.dilate(response, np.ones((reach, reach), np.uint8))
        is_peak = (response >= highest) & (response > LEAST_RESPONSE)
        rows, columns = np.nonzero(is_peak)
        order = np.argsort(-response[rows, columns])[:MOST_CANDIDATES]
        middle = 0.5 * len(inside) - margin
        places = (np.column_stack([columns, rows])[order] + middle) / COARSE - 0.5
        found = [self._refined(picture, place) for place in places]
        moving = cv2.dilate(
            (covered * known > 0.3).astype(np.uint8), np.ones((5, 5), np.uint8)
        )
        still = cv2.resize(
            1 - moving, REFERENCE_SIZE_PX, interpolation=cv2.INTER_NEAREST
        )
        cv2.accumulateWeighted(picture, self._scene, ADAPTATION, mask=still)
        found = [one for one in found if one.likeness > 0.0]
        found.sort(key=lambda one: math.dist(one.place, self._start))
        return [self._measured(one, picture) for one in found]

    def known_share(self, place: FloatArray) -> float:
        """Return on which share of the outline the background at a place has another colour than the object."""
        bare, _ = _cut(self._scene, place[0], place[1], self._half)
        _, known = _covered(bare, bare, self._colour)
        return float((known * self._outline).sum() / self._outline.sum())

    def _drawn(self, share: float) -> NDArray[np.float32]:
        """Return a filled outline in a square of the template, of a share of the size; its edge is soft."""
        side, size_px = 2 * self._half + 1, share * self._task.size_px
        middle = np.array([self._half, self._half], dtype=float)
        filled = np.zeros((side, side), dtype=np.float32)
        if self._task.motion is Motion.SLIDE:
            angle_deg = math.degrees(math.atan2(*SLOPE_DIRECTION[::-1]))
            corners = cv2.boxPoints((middle, (size_px, size_px), angle_deg))
            fixed = np.round(16.0 * corners).astype(np.int32)
            cv2.fillPoly(filled, [fixed], 1.0, cv2.LINE_8, 4)
        else:
            fixed = (16.0 * middle).astype(int).tolist()
            cv2.circle(filled, fixed, round(8.0 * size_px), 1.0, -1, cv2.LINE_8, 4)
        return np.asarray(cv2.GaussianBlur(filled, (0, 0), 1.0))

    def _refined(self, picture: Picture, place: FloatArray) -> Sight:
        """Return a candidate with fractions of pixels and its likeness."""
        half = self._half + REACH
        window, corner = _cut(picture, place[0], place[1], half)
        bare, _ = _cut(self._scene, place[0], place[1], half)
        covered, known = _covered(window, bare, self._colour)
        _, warp = matched(self._outline, covered, REACH, cv2.MOTION_TRANSLATION, known)
        middle = (warp[:, 2] + self._half).tolist()
        size = self._outline.shape
        response = _response(
            cv2.getRectSubPix(covered, size, middle),
            cv2.getRectSubPix(known, size, middle),
            self._outline,
            self._around,
        )
        value = float(response[0, 0])
        if value < LEAST_RESPONSE:
            return Sight()
        found = corner + middle
        tint = _tint(_look(picture, found, self._size_px), self._colour)
        return Sight(place=found, likeness=min(1.0, value) * _likeness(tint), tint=tint)

    def _measured(self, sight: Sight, picture: Picture) -> Sight:
        """Return a sight with its size and shape; one beside the line of a slide is moved to it if the shape says so.

        An outline floats across a cube and its shadow on the board, which may have the colour of the cube.
        """
        sights = [sight]
        if self._task.motion is Motion.SLIDE and self._task.law:
            across = np.array(self._task.direction)[::-1] * (-1.0, 1.0)
            off_px = (sight.place - self._start) @ across
            if LEAST_OFF < abs(off_px) / self._size_px < MOST_OFF:
                on_line = replace(sight, place=sight.place - off_px * across)
                sights.insert(0, on_line)
        for one in sights:
            self._measure(one, picture)
        sights.reverse()
        return min(sights, key=lambda one: (math.isnan(one.size_ratio), one.misfit))

    def _measure(self, sight: Sight, picture: Picture) -> None:
        """Measure the size and the shape of what covers a place, by its profile across the motion.

        The exposure smears an object along its motion only, so that each line along it is covered as much.
        """
        half = int(LINE * self._size_px)
        x, y = _direction(self._task, sight.place)
        pose = np.array([math.atan2(y, x), *sight.place])
        window = _turned(picture.astype(np.float32), pose, half)
        bare = _turned(self._scene, pose, half)
        covered, known = _covered(window, bare, self._colour)
        across_px = np.arange(-half, half + 1)
        radius_px = 0.5 * self._size_px
        if self._task.motion is Motion.SLIDE:
            # The outermost line of pixels is covered in part.
            share = np.clip(radius_px - np.abs(across_px) + 0.5, 0.0, 1.0)
            wanted_px = self._size_px * share
        else:
            wanted_px = 2.0 * np.sqrt(np.maximum(radius_px**2 - across_px**2, 0.0))
        is_near = np.abs(across_px) <= NEAR_LINE * self._size_px
        is_known = known[:, is_near].mean(axis=1) > LEAST_KNOWN_LINE
        if self._profile_px is not None:
            wanted_px = self._profile_px
        whole_px2 = float(wanted_px[is_known].sum())
        if whole_px2 < LEAST_KNOWN_SHARE * self._size_px**2:
            return
        seen = (covered * known)[is_known]
        # Blur leaves no gap: what lies beyond one is another object, or its other half.
        along = seen.mean(axis=0)
        gaps = np.flatnonzero(along < GAP_SHARE * along.max())
        start = gaps[gaps < half].max(initial=-1) + 1
        end = gaps[gaps > half].min(initial=len(along))
        seen_px = seen[:, start:end].sum(axis=1)
        is_first = math.dist(sight.place, self._start) < CORE * self._size_px
        if (
            self._profile_px is None
            and is_first
            and self._task.motion is not Motion.CRADLE
        ):
            # The object's own profile holds its other sides too.
            self._profile_px = wanted_px.copy()
            self._profile_px[is_known] = seen_px
            wanted_px = self._profile_px
            whole_px2 = float(seen_px.sum())
        sight.size_ratio = math.sqrt(float(seen_px.sum()) / whole_px2)
        misses_px = np.abs(seen_px - wanted_px[is_known])
        sight.misfit = float(misses_px.sum()) / whole_px2
        # The board and the shadow on it lie beyond the core.
        core = seen[np.abs(across_px[is_known]) <= CORE * self._size_px, start:end]
        if self._task.motion is Motion.SLIDE and self._task.law and core.any():
            away_px = core.sum(axis=0) @ across_px[start:end] / core.sum()
            wide_px = core.sum() / len(core)
            self._place_face(sight, away_px, wide_px, is_first=is_first)

    def _place_face(
        self, sight: Sight, away_px: float, wide_px: float, *, is_first: bool
    ) -> None:
        """Place the face of a cube by the middle of all that is seen of the cube along its motion.

        A dark side is not told from the face, so that the outline of the face may lie anywhere on both. In the first
        frame the place of the face is known, and so is what is added there: by its side, which makes it wider and goes
        with the distance from where the camera looks straight at the cube, in the middle of the picture; and by the
        pattern of the face, which stays.

        Args:
            sight: The sight, of the outline; its place is changed.
            away_px: The middle of what is seen, from that place along the motion [px].
            wide_px: Width of what is seen along the motion [px].
            is_first: Whether the cube is at its first place.
        """
        direction, half_px = np.array(self._task.direction), 0.5 * self._size_px
        places = np.array([sight.place, 0.5 * np.array(REFERENCE_SIZE_PX)])
        way_px, straight_px = (places - self._start) @ direction
        seen_px = way_px + away_px
        if is_first and self._added_px is None:
            most_px = max(0.5 * wide_px - half_px, 0.0)
            side_px = float(np.clip(seen_px, -most_px, most_px))
            self._added_px = side_px, seen_px - side_px
        side_px, fixed_px = self._added_px or (0.0, 0.0)
        left_px = straight_px - np.array([side_px, seen_px - fixed_px])
        first_px, beyond_px = left_px - np.clip(left_px, -half_px, half_px)
        added_px = fixed_px
        # Where the camera looks straight at the first place, the side is unknown.
        if abs(first_px) > half_px:
            added_px += side_px * beyond_px / first_px
        sight.place = sight.place + (away_px - added_px) * direction


def _uncovered(
    first: Picture, last: Picture, start_px: FloatArray, size_px: float
) -> Picture:
    """Return the first frame without the object: what it hides is seen in the last frame, or guessed by its edges."""
    low, high = (start_px + HIDDEN * size_px * np.array([[-1.0], [1.0]])).astype(int)
    left, top = np.maximum(low, 0)
    hidden = np.s_[top : high[1], left : high[0]]
    core = (start_px[0], start_px[1], int(CORE * size_px))
    change = _cut(first, *core)[0] - _cut(last, *core)[0].astype(np.float32)
    if np.median(np.abs(change).max(axis=2)) > CHANGED:
        scene, colour = first.copy(), _look(first, start_px, size_px)
        before, after = (
            np.linalg.norm(one[hidden] - colour, axis=2) for one in (first, last)
        )
        # An object that stops beside its first place hides there in the last frame what the first one shows.
        stopped = ((before > LEAST_CONTRAST) & (after < LEAST_CONTRAST)).astype("u1")
        part = np.ones((int(PART * size_px),) * 2, np.uint8)
        around = cv2.dilate(cv2.morphologyEx(stopped, cv2.MORPH_OPEN, part), part)
        is_first = (around > 0) & (before > after)
        scene[hidden] = np.where(is_first[..., None], first[hidden], last[hidden])
        return scene
    mask = np.zeros(first.shape[:2], dtype=np.uint8)
    mask[hidden] = 255
    return np.asarray(cv2.inpaint(first, mask, 3, cv2.INPAINT_TELEA))


def _response(
    covered: NDArray[np.float32],
    known: NDArray[np.float32],
    inside: NDArray[np.float32],
    around: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Return the covered share in the outline less that around it, of the pixels that say something, at each place."""
    shares, wholes = [], []
    for mask in (inside, around):
        share = cv2.matchTemplate(covered * known, mask, cv2.TM_CCORR)
        wholes.append(cv2.matchTemplate(known, mask, cv2.TM_CCORR))
        shares.append(share / np.maximum(wholes[-1], 1.0))
    is_seen = wholes[0] >= LEAST_KNOWN_SHARE * inside.sum()
    return np.where(is_seen, shares[0] - shares[1], -1.0)


def matched(
    template: NDArray[np.floating],
    window: NDArray[np.float32],
    margin: int,
    motion: int,
    known: NDArray[np.float32] | None = None,
) -> tuple[float, NDArray[np.float32]]:
    """Return the correlation of a template with a part of a window, and where it is largest (Evangelidis and Psarakis).

    Args:
        template: The template, shape [side, side].
        window: Picture around it that is wider by a margin on each side.
        margin: The margin [px].
        motion: `cv2.MOTION_TRANSLATION` or `cv2.MOTION_EUCLIDEAN`.
        known: Pixels of the window that say something; all if None.

    Returns:
        The correlation, 0 where none is found, and the matrix from the template to the window, shape [2, 3].
    """
    warp = np.eye(2, 3, dtype=np.float32)
    warp[:, 2] = margin
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-4)
    mask = None if known is None else known.astype(np.uint8)
    small = template.astype(np.float32)
    try:
        return cv2.findTransformECC(small, window, warp, motion, stop, mask, 5)
    except cv2.error:
        # It does not converge: the window shows something else.
        return 0.0, warp


def _direction(task: VideoTask, place: FloatArray) -> FloatArray:
    """Return the direction of the motion in the picture at a place, shape [2]."""
    if task.direction is not None:
        return np.array(task.direction)
    assert task.pivot_px is not None
    x, y = place - task.pivot_px
    return np.array([y, -x])


def _covered(
    picture: NDArray[Any], bare: NDArray[np.float32], colour: FloatArray
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return which share of each pixel is covered by an object of a colour, and whether the pixel says so."""
    span = bare - colour
    length = np.sqrt((span * span).sum(axis=2))
    change = bare - picture
    covered = (change * span).sum(axis=2) / np.maximum(length**2, 1.0)
    covered = np.clip((covered - NOISE_SHARE) / (1.0 - 2.0 * NOISE_SHARE), 0.0, 1.0)
    return covered.astype(np.float32), (length > LEAST_CONTRAST).astype(np.float32)


Areas: TypeAlias = tuple[NDArray[np.int32], NDArray[np.int32], FloatArray]
"""Labels of connected areas in a small picture, their sizes and their middles."""


def _areas(covered: NDArray[np.float32]) -> Areas:
    """Return the connected areas of a small picture that are covered, without what is thin."""
    whole = (covered > 0.5).astype(np.uint8)
    whole = cv2.morphologyEx(whole, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    _, labels, stats, middles = cv2.connectedComponentsWithStats(whole)
    return labels, stats[:, cv2.CC_STAT_AREA], middles


def _area_at(areas: Areas, place: FloatArray) -> tuple[float, float, FloatArray]:
    """Return the largest covered area that a place of the whole picture is in or beside.

    Returns:
        Its size, 0 where there is none; the ratio of its axes; and its middle, from the place [px].
    """
    column, row = (COARSE * place).astype(int)
    labels = np.unique(_cut(areas[0], column, row, 2)[0])
    sizes = areas[1] * np.isin(np.arange(len(areas[1])), labels[labels > 0])
    if not sizes.any():
        return 0.0, 1.0, np.zeros(2)
    largest = sizes.argmax()
    one = cv2.moments((areas[0] == largest).astype(np.uint8), binaryImage=True)
    spreads = [[one["mu20"], one["mu11"]], [one["mu11"], one["mu02"]]]
    shorter, longer = np.linalg.eigvalsh(spreads)
    ratio = math.sqrt(longer / max(shorter, 1e-9))
    return float(sizes.max()), ratio, areas[2][largest] / COARSE - place


def _look(picture: NDArray[Any], place: FloatArray, size_px: float) -> FloatArray:
    """Return the mean colour of the middle of an object."""
    part, _ = _cut(picture, place[0], place[1], max(1, int(0.25 * size_px)))
    return np.asarray(part.reshape(-1, 3).mean(axis=0), dtype=float)


def _tint(colour: FloatArray, known: FloatArray) -> float:
    """Return the largest difference of a channel from a known colour at any brightness."""
    gain = np.clip(colour @ known / max(float(known @ known), 1.0), 0.5, 2.0)
    return float(np.abs(colour - gain * known).max())


def _likeness(tint: float) -> float:
    """Return the likeness of a colour that differs by a tint, from 0 to 1."""
    return math.exp(-max(0.0, tint - TINT) / TINT_RANGE)


def _cut(
    picture: NDArray[Any], x: float, y: float, half: int
) -> tuple[NDArray[Any], FloatArray]:
    """Return the part of a picture around a pixel, its edges repeated, and the place of its corner."""
    left, top = round(x) - half, round(y) - half
    columns = np.clip(np.arange(left, left + 2 * half + 1), 0, picture.shape[1] - 1)
    rows = np.clip(np.arange(top, top + 2 * half + 1), 0, picture.shape[0] - 1)
    return picture[rows[:, None], columns], np.array([float(left), float(top)])


# --- a face that turns ------------------------------------------------------------------------------------------------

FACE, WINDOW, INNER = 0.6, 0.4, 0.42
"""Half of the followed square, how far around it the next one is looked for, and half of the part of it that shows the
face alone, in sizes of the object."""

LEAST_PATTERN = 1.0
"""Smallest contrast of a pattern of a face, as the standard deviation of its brightness."""

LEAST_PATTERN_CORRELATION = 0.7
"""Smallest correlation with the pattern of a face that shows it again."""

RENEWAL = 0.2
"""Share of a frame that the template takes over: metal changes its brightness as it turns to the lamp."""

LEAST_CORRELATION = 0.5
"""Smallest correlation with the template that shows the object."""

RIM = 0.05
"""Half of the width of the plate's rim, in its radius."""

CLEAR_CONTRAST = 80.0
"""Distance of the colours of plate and object from which its area is known: a plate of wood has veins."""

TINT_GAIN, DARK = 768.0, 20.0
"""Factor that makes tints as large as colours, and brightness below which they are noise."""

CORNER = 0.6
"""Distance from the middle of a face beyond which its corners lie, in its half side: a disk of its width covers a tenth
of them. What is beside a face, its other sides and its shadow, covers no less of them."""

TWIN_SHARE = 0.4
"""Smallest area of a second object, in that of the first."""

MOST_SLIP = 0.25
"""Largest distance of the template from the middle of the object's area, beyond that in the first frame, in sizes."""

LEAST_OUTLINE = 0.75
"""Smallest strength of the edges at the object's sides, against the strongest around, in that of the first frame."""

SIDE, NEAR, EDGE_PX = 0.3, 0.1, 1.5
"""Half of the part of a side whose edge counts, and distance in which it lies, in sizes; blur of its profile [px]."""

SLIP = 0.2
"""Distance within which the pattern of the first frame is looked for, in sizes."""

SMOOTH_PX = 3.0
"""Width of the grain that a pattern leaves out [px]."""

SEARCHED_RAD = (0.0, 0.15, -0.15, 0.3, -0.3, 0.5, -0.5, 0.8, -0.8)
"""Angles about the axis at which an object that was lost is looked for [rad]."""


class FaceFollower:
    """Follows the face of a cube on a turntable by a template that turns with it and is renewed in each frame.

    The place and angle of largest correlation are found from those that the last two frames predict (Evangelidis and
    Psarakis, 2008, as in OpenCV). An object that is lost there is looked for around the axis.

    Args:
        first: The first frame.
        task: The task.
    """

    def __init__(self, first: Picture, task: VideoTask) -> None:
        assert task.pivot_px is not None
        self._half, self._pivot = int(FACE * task.size_px), np.array(task.pivot_px)
        self._wide = self._half + int(WINDOW * task.size_px)
        # Angle [rad] and place [px].
        self._pose = np.array([0.0, *task.centre_px])
        self._step, self._slip_px = np.zeros(3), np.zeros(2)
        self._face = _turned(_grey(first), self._pose, self._half)
        self._size_px = task.size_px
        self._least_outline = LEAST_OUTLINE * self._outline(_grey(first))
        self._is_shiny = task.is_shiny
        self._colour = _look(first, self._pose[1:], task.size_px)
        self._square = _normed(smooth(self._face))
        inner = int(INNER * task.size_px)
        margin = self._half - inner
        self._pattern = pattern_of(self._face, inner)[margin:-margin, margin:-margin]
        # Reflections change the face of metal that turns.
        self._has_pattern = not task.is_shiny and self._pattern.std() > LEAST_PATTERN
        width, height = REFERENCE_SIZE_PX
        rows, columns = np.mgrid[0:height, 0:width]
        away = np.hypot(*np.subtract([columns, rows], self._pivot[:, None, None]))
        away = away / PLATE_RADIUS_PX
        # The plate turns, and what is on it; its rim is left out.
        shown = self._shown(first)
        away = cv2.resize(away, shown.shape[1::-1], interpolation=cv2.INTER_AREA)
        plate = np.median(shown[away < 1.0 - RIM], axis=0)
        self._bare = np.where((away < 1.0)[..., None], plate, shown).astype(np.float32)
        self._counted = (abs(away - 1.0) > RIM).astype(np.float32)
        self._known = _look(shown, COARSE * self._pose[1:], COARSE * task.size_px)
        is_clear = np.linalg.norm(plate - self._known) > CLEAR_CONTRAST
        areas = self._areas(first)
        self._area, self._longer, self._middle = _area_at(areas, self._pose[1:])
        self._corners = self._corner_share(areas[0])
        if not is_clear:
            self._area = 0.0

    @property
    def is_blind(self) -> bool:
        """Whether the object is metal of the plate's tint: reflections change its face, and it has no area."""
        return self._is_shiny and self._area == 0.0

    def candidates(self, picture: Picture) -> list[Sight]:
        """Return the place in the next frame; none where it is lost."""
        grey = _grey(picture)
        pose, value = self._matched(picture, grey, self._pose + self._step)
        if value < LEAST_CORRELATION:
            around = [_swung(self._pose, self._pivot, one) for one in SEARCHED_RAD]
            found = (self._matched(picture, grey, one) for one in around)
            pose, value = next(
                (one for one in found if one[1] >= LEAST_CORRELATION), (pose, 0.0)
            )
        if value < LEAST_CORRELATION:
            self._step = np.zeros(3)
            return []
        self._step, self._pose = pose - self._pose, pose
        anchored = self._anchor(grey)
        face = _turned(grey, self._pose, self._half)
        self._face = (1.0 - RENEWAL) * self._face + RENEWAL * face
        if not self._is_shiny:
            # The renewed template would follow a cube that melts; its square has the threshold of all likenesses.
            # Of a plain face it would know the sides and the shadow, which do not turn: its area says more.
            if self._has_pattern or self._area == 0.0:
                whole = float((_normed(smooth(face)) * self._square).mean())
                value = max(whole, anchored, 0.0) ** 2
            if self._outline(grey) < self._least_outline:
                return []
        sight = Sight(place=self._pose[1:], likeness=min(1.0, value))
        if not self._is_shiny:
            # Reflections change the colour of metal that turns.
            shown = _look(picture, sight.place, self._size_px)
            sight.tint = _tint(shown, self._colour)
        if self._area == 0.0:
            return [sight]
        others = self._others(picture, sight, is_anchored=anchored > 0.0)
        return [sight, *others] if sight.likeness > 0.0 else []

    def _others(
        self, picture: Picture, found: Sight, *, is_anchored: bool
    ) -> list[Sight]:
        """Return what else looks like the object, and by how much the area around it has changed in size and shape."""
        areas = self._areas(picture)
        size, longer, middle = _area_at(areas, found.place)
        found.size_ratio = math.sqrt(size / self._area)
        found.misfit = abs(longer / self._longer - 1.0)
        if not self._is_shiny:
            # Reflections take corners from the area of metal.
            lost = 1.0 - self._corner_share(areas[0]) / self._corners
            found.misfit = max(found.misfit, lost)
        slip_px = middle - _rotation(self._pose[0]) @ self._middle
        is_off = np.linalg.norm(slip_px) > MOST_SLIP * self._size_px
        if is_off and not is_anchored:
            found.likeness = 0.0
        if self._is_shiny:
            # A renewed template drifts with reflections. Tints do not, and hold no shadow.
            self._slip_px += RENEWAL * (slip_px - self._slip_px)
            found.place = found.place + self._slip_px
        _, sizes, middles = areas
        is_large = sizes > TWIN_SHARE * self._area
        # The first area is all that is not covered.
        is_large[0] = False
        return [
            Sight(place=place, likeness=1.0) for place in middles[is_large] / COARSE
        ]

    def _corner_share(self, labels: NDArray[np.int32]) -> float:
        """Return which share of the corners of the face is covered, in a small picture of areas."""
        half = int(0.5 * COARSE * self._size_px)
        pose = self._pose * [1.0, COARSE, COARSE]
        face = _turned((labels > 0).astype(np.float32), pose, half)
        is_near = np.abs(np.arange(-half, half + 1)) > CORNER * half
        return max(float(face[np.ix_(is_near, is_near)].mean()), 1e-3)

    def _areas(self, picture: Picture) -> Areas:
        """Return the areas that have got the object's colour."""
        covered, known = _covered(self._shown(picture), self._bare, self._known)
        return _areas(covered * known * self._counted)

    def _shown(self, picture: Picture) -> NDArray[np.float32]:
        """Return a small picture in colours, or of metal in tints: its brightness changes as it turns to the lamp."""
        small = shrunk(picture)
        if not self._is_shiny:
            return small
        brightness = small.mean(axis=2, keepdims=True)
        return TINT_GAIN * (small - brightness) / (brightness + DARK)

    def _anchor(self, grey: NDArray[np.float32]) -> float:
        """Move the pose to where the pattern of the face in the first frame is seen again, and return how well it fits.

        The renewed template drifts, as the sides and the shadow around a face change with its place. Where the pattern
        is not seen, as there is none or a model draws it anew, the pose stays, and 0 is returned.
        """
        if not self._has_pattern:
            return 0.0
        half, margin = len(self._pattern) // 2, int(SLIP * self._size_px)
        window = pattern_of(_turned(grey, self._pose, half + margin), half)
        value, move = _aligned(self._pattern, window)
        slip_px = float(np.hypot(*move[1:]))
        if value < LEAST_PATTERN_CORRELATION or slip_px > margin:
            return 0.0
        self._pose = _moved(self._pose, move)
        return value

    def _outline(self, grey: NDArray[np.float32]) -> float:
        """Return how strong the edges are at the object's sides, against the strongest ones around each of them."""
        half = int(self._size_px)
        around = _turned(grey, self._pose, half)
        side = int(SIDE * self._size_px)
        shares = []
        for quarter in range(4):
            strip = np.rot90(around, quarter)[half - side : half + side + 1, half:]
            mean = cv2.GaussianBlur(strip.mean(axis=0)[None], (0, 0), EDGE_PX)[0]
            edges = np.abs(np.diff(mean))[side:]
            place, reach = half // 2 - side, int(NEAR * self._size_px)
            near = edges[place - reach : place + reach + 1]
            shares.append(float(near.max() / max(edges.max(), 1e-3)))
        return float(np.mean(shares))

    def _matched(
        self, picture: Picture, grey: NDArray[np.float32], pose: FloatArray
    ) -> tuple[FloatArray, float]:
        """Return the pose near another one at which the picture is most like the template, and how much it is."""
        value, move = _aligned(self._face, _turned(grey, pose, self._wide))
        found = _moved(pose, move)
        # Correlation does not know the colour, and an edge of the plate is like one of the object.
        shown = _look(picture, found[1:], self._size_px)
        is_on_plate = math.dist(found[1:], self._pivot) < PLATE_RADIUS_PX
        return found, is_on_plate * value * _likeness(_tint(shown, self._colour))


def smooth(grey: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return a picture without its grain."""
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), SMOOTH_PX))


def _normed(grey: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return a picture at the mean brightness 0 and the contrast 1."""
    return (grey - grey.mean()) / max(float(grey.std()), 1e-9)


def pattern_of(grey: NDArray[np.floating], half: int) -> NDArray[np.floating]:
    """Return a square without its grain, and without the even shading of the middle that a lamp makes.

    Args:
        grey: The square.
        half: Half of the side of its middle [px].
    """
    smoothed = smooth(grey)
    wide = len(grey) // 2
    middle = smoothed[wide - half : wide + half + 1, wide - half : wide + half + 1]
    along_px = np.arange(-half, half + 1)
    # On a centred square the plane of least squares has each slope for itself.
    square_px2 = (2 * half + 1) * float(along_px @ along_px)
    down, right = middle.sum(axis=1) @ along_px, middle.sum(axis=0) @ along_px
    places_px = np.arange(-wide, wide + 1)
    plane = (down * places_px[:, None] + right * places_px) / square_px2
    return np.asarray(smoothed - plane - middle.mean())


def _aligned(
    template: NDArray[np.floating], window: NDArray[np.floating]
) -> tuple[float, FloatArray]:
    """Return how like a square a part of a wider one is, and its angle [rad] and place [px] from the middle."""
    half, wide = len(template) // 2, len(window) // 2
    value, warp = matched(
        template, window.astype(np.float32), wide - half, cv2.MOTION_EUCLIDEAN
    )
    turn = math.atan2(warp[1, 0], warp[0, 0])
    return value, np.array([turn, *(warp @ [half, half, 1.0] - wide)])


def _moved(pose: FloatArray, move: FloatArray) -> FloatArray:
    """Return a pose that has moved by an angle and a place in its own directions."""
    return pose + np.array([move[0], *(_rotation(pose[0]) @ move[1:])])


def _grey(picture: Picture) -> NDArray[np.float32]:
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), dtype=np.float32)


def _rotation(angle_rad: float) -> FloatArray:
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cosine, -sine], [sine, cosine]])


def _swung(pose: FloatArray, pivot: FloatArray, angle_rad: float) -> FloatArray:
    """Return a pose that has turned about an axis."""
    place = pivot + _rotation(angle_rad) @ (pose[1:] - pivot)
    return np.array([pose[0] + angle_rad, *place])


def _turned(
    grey: NDArray[np.float32], pose: FloatArray, half: int
) -> NDArray[np.float32]:
    """Return the square around a pose that has its angle, shape [2 half + 1, 2 half + 1]."""
    matrix = np.column_stack([_rotation(pose[0]), pose[1:]])
    matrix[:, 2] -= matrix[:, :2] @ [half, half]
    side = 2 * half + 1
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(
            grey, matrix, (side, side), flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
    )
