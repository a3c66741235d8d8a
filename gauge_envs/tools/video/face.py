"""Follow the face of a cube that rides a turntable through the frames of a video."""

import math

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.geometry import FloatArray
from gauge_envs.tools.video.frames import Picture, cv2
from gauge_envs.tools.video.sight import (
    COARSE,
    Areas,
    Sight,
    area_at,
    areas_of,
    covered_share,
    grey_of,
    likeness_of,
    look_of,
    matched,
    rotation_of,
    shrunk,
    tint_of,
    turned_square,
)
from gauge_envs.tools.video.tasks import (
    PLATE_RADIUS_PX,
    REFERENCE_SIZE_PX,
    VideoTask,
)

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

ANCHOR_REACH = 0.2
"""Distance within which the pattern of the first frame is looked for, in sizes."""

SMOOTH_PX = 3.0
"""Width of the grain that a pattern leaves out [px]."""

SEARCHED_RAD = (0.0, 0.15, -0.15, 0.3, -0.3, 0.5, -0.5, 0.8, -0.8)
"""Angles about the axis at which an object that was lost is looked for [rad]."""


class FaceFollower:
    """Follows the face of a cube on a turntable by a template that turns with it and is renewed in each frame.

    The place and angle of largest correlation are found from those that the last two frames predict (Evangelidis and
    Psarakis, 2008, as in OpenCV). An object that is lost there is looked for around the axis. Where the pattern of the
    face in the first frame is seen again, it corrects the drift of the template.

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
        self._face = turned_square(grey_of(first), self._pose, self._half)
        self._size_px = task.size_px
        self._least_outline = LEAST_OUTLINE * self._outline(grey_of(first))
        self._is_shiny = task.is_shiny
        self._colour = look_of(first, self._pose[1:], task.size_px)
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
        self._known = look_of(shown, COARSE * self._pose[1:], COARSE * task.size_px)
        is_clear = np.linalg.norm(plate - self._known) > CLEAR_CONTRAST
        areas = self._areas(first)
        self._area, self._longer, self._middle = area_at(areas, self._pose[1:])
        self._corners = self._corner_share(areas[0])
        if not is_clear:
            self._area = 0.0

    @property
    def is_blind(self) -> bool:
        """Whether the object is metal of the plate's tint: reflections change its face, and it has no area."""
        return self._is_shiny and self._area == 0.0

    def candidates(self, picture: Picture) -> list[Sight]:
        """Return the place in the next frame; none where it is lost."""
        grey = grey_of(picture)
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
        face = turned_square(grey, self._pose, self._half)
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
            shown = look_of(picture, sight.place, self._size_px)
            sight.tint = tint_of(shown, self._colour)
        if self._area == 0.0:
            return [sight]
        others = self._others(picture, sight, is_anchored=anchored > 0.0)
        return [sight, *others] if sight.likeness > 0.0 else []

    def _others(
        self, picture: Picture, found: Sight, *, is_anchored: bool
    ) -> list[Sight]:
        """Return what else looks like the object, and by how much the area around it has changed in size and shape."""
        areas = self._areas(picture)
        size, longer, middle = area_at(areas, found.place)
        found.size_ratio = math.sqrt(size / self._area)
        found.misfit = abs(longer / self._longer - 1.0)
        if not self._is_shiny:
            # Reflections take corners from the area of metal.
            lost = 1.0 - self._corner_share(areas[0]) / self._corners
            found.misfit = max(found.misfit, lost)
        slip_px = middle - rotation_of(self._pose[0]) @ self._middle
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
        face = turned_square((labels > 0).astype(np.float32), pose, half)
        is_near = np.abs(np.arange(-half, half + 1)) > CORNER * half
        return max(float(face[np.ix_(is_near, is_near)].mean()), 1e-3)

    def _areas(self, picture: Picture) -> Areas:
        """Return the areas that have got the object's colour."""
        covered, known = covered_share(self._shown(picture), self._bare, self._known)
        return areas_of(covered * known * self._counted)

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
        half, margin = len(self._pattern) // 2, int(ANCHOR_REACH * self._size_px)
        window = pattern_of(turned_square(grey, self._pose, half + margin), half)
        value, move = _aligned(self._pattern, window)
        moved_px = float(np.hypot(*move[1:]))
        if value < LEAST_PATTERN_CORRELATION or moved_px > margin:
            return 0.0
        self._pose = _moved(self._pose, move)
        return value

    def _outline(self, grey: NDArray[np.float32]) -> float:
        """Return how strong the edges are at the object's sides, against the strongest ones around each of them."""
        half = int(self._size_px)
        around = turned_square(grey, self._pose, half)
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
        value, move = _aligned(self._face, turned_square(grey, pose, self._wide))
        found = _moved(pose, move)
        # Correlation does not know the colour, and an edge of the plate is like one of the object.
        shown = look_of(picture, found[1:], self._size_px)
        is_on_plate = math.dist(found[1:], self._pivot) < PLATE_RADIUS_PX
        return found, is_on_plate * value * likeness_of(tint_of(shown, self._colour))


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
    return pose + np.array([move[0], *(rotation_of(pose[0]) @ move[1:])])


def _swung(pose: FloatArray, pivot: FloatArray, angle_rad: float) -> FloatArray:
    """Return a pose that has turned about an axis."""
    place = pivot + rotation_of(angle_rad) @ (pose[1:] - pivot)
    return np.array([pose[0] + angle_rad, *place])
