"""Find an object of known outline and colour before a known background, in the frames of a video."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Picture, cv2
from gauge_envs.tools.video.sight import (
    COARSE,
    LEAST_CONTRAST,
    Sight,
    covered_share,
    cut_around,
    likeness_of,
    look_of,
    matched,
    shrunk,
    tint_of,
    turned_square,
)
from gauge_envs.tools.video.tasks import (
    REFERENCE_SIZE_PX,
    SLOPE_DIRECTION,
    Motion,
    VideoTask,
)

REACH = 8
"""Distance from a place found at the coarse scale within which it is refined [px]."""

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

LEAST_KNOWN_SHARE = 0.25
"""Smallest share of the outline before such a background."""

LINE, NEAR_LINE, LEAST_KNOWN_LINE = 1.5, 0.75, 0.9
"""Half of the length of the lines along the motion by which size and shape are measured, and of their parts at the
object, in sizes, and smallest share of those parts before another colour than the object's."""

GAP_SHARE = 0.15
"""Covered share, in the largest along the motion, below which there is a gap."""


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
        self._colour = look_of(first, start, task.size_px)
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
        covered, known = covered_share(shrunk(picture), bare, self._colour)
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
        bare, _ = cut_around(self._scene, place[0], place[1], self._half)
        _, known = covered_share(bare, bare, self._colour)
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
        window, corner = cut_around(picture, place[0], place[1], half)
        bare, _ = cut_around(self._scene, place[0], place[1], half)
        covered, known = covered_share(window, bare, self._colour)
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
        tint = tint_of(look_of(picture, found, self._size_px), self._colour)
        return Sight(
            place=found, likeness=min(1.0, value) * likeness_of(tint), tint=tint
        )

    def _measured(self, sight: Sight, picture: Picture) -> Sight:
        """Return a sight with its size and shape; one beside the line of a slide is moved to it if the shape says so.

        An outline floats across a cube and its shadow on the board, which may have the colour of the cube.
        """
        sights = [sight]
        if self._task.motion is Motion.SLIDE:
            across = np.array(self._task.direction)[::-1] * (-1.0, 1.0)
            off_px = (sight.place - self._start) @ across
            if LEAST_OFF < abs(off_px) / self._size_px < MOST_OFF:
                on_line = replace(sight, place=sight.place - off_px * across)
                # The first one that is measured at the first place gives the profile of the object.
                sights = [on_line, sight]
        for one in sights:
            self._measure(one, picture)
        # Of equal shapes the place stays.
        return min(reversed(sights), key=_misfit)

    def _measure(self, sight: Sight, picture: Picture) -> None:
        """Measure the size and the shape of what covers a place, by its profile across the motion.

        The exposure smears an object along its motion only, so that each line along it is covered as much.
        """
        half = int(LINE * self._size_px)
        x, y = _direction(self._task, sight.place)
        pose = np.array([math.atan2(y, x), *sight.place])
        window = turned_square(picture.astype(np.float32), pose, half)
        bare = turned_square(self._scene, pose, half)
        covered, known = covered_share(window, bare, self._colour)
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
        if self._task.motion is Motion.SLIDE and core.any():
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


def _misfit(sight: Sight) -> float:
    """Return the misfit of a sight; infinite where its shape is not known."""
    return math.inf if math.isnan(sight.size_ratio) else sight.misfit


def _uncovered(
    first: Picture, last: Picture, start_px: FloatArray, size_px: float
) -> Picture:
    """Return the first frame without the object: what it hides is seen in the last frame, or guessed by its edges."""
    low, high = (start_px + HIDDEN * size_px * np.array([[-1.0], [1.0]])).astype(int)
    left, top = np.maximum(low, 0)
    hidden = np.s_[top : high[1], left : high[0]]
    core = (start_px[0], start_px[1], int(CORE * size_px))
    change = cut_around(first, *core)[0] - cut_around(last, *core)[0].astype(np.float32)
    if np.median(np.abs(change).max(axis=2)) > CHANGED:
        scene, colour = first.copy(), look_of(first, start_px, size_px)
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


def _direction(task: VideoTask, place: FloatArray) -> FloatArray:
    """Return the direction of the motion in the picture at a place, shape [2]."""
    if task.direction is not None:
        return np.array(task.direction)
    assert task.pivot_px is not None
    x, y = place - task.pivot_px
    return np.array([y, -x])
