"""Frames of films and strips: pictures side by side with small text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from gauge_envs.rendering.overlay import RECORDED_COLOR, SIMULATED_COLOR, Color

GROUND = (255, 255, 255)
INK = (28, 32, 38)
QUIET = (104, 110, 120)

MOST_ROW = 4
"""Largest number of panels in a row, if no number is chosen."""

FINER = 4
"""Text is drawn this much larger and then reduced, which places letters on parts of a pixel."""


@dataclass(frozen=True, kw_only=True)
class PanelText:
    """Text of a panel.

    Attributes:
        title: Above the picture, as the name of the engine.
        detail: Beside it, small.
        note: Below the picture, as a score.
    """

    title: str
    detail: str
    note: str


@dataclass(frozen=True, kw_only=True)
class Caption:
    """Text of a film or a strip.

    Attributes:
        title: Id of the experiment.
        subtitle: What happens in it.
        reference: What is drawn in the colour of the reference; empty if nothing is.
        remark: Further words below the pictures.
        simulated: What is drawn in the colour of the simulation; empty if nothing is.
    """

    title: str
    subtitle: str
    reference: str
    remark: str = ""
    simulated: str = "simulated"


@dataclass(frozen=True)
class _Scale:
    """Sizes of text and gaps for pictures of a height [pixels]."""

    height: int

    @property
    def large(self) -> int:
        return max(13, round(self.height / 19))

    @property
    def small(self) -> int:
        return max(12, round(self.height / 25))

    @property
    def gap(self) -> int:
        return max(6, round(self.height / 36))

    @property
    def large_line(self) -> int:
        return round(1.5 * self.large)

    @property
    def small_line(self) -> int:
        return round(1.55 * self.small)


class FilmLayout:
    """Frames of a film: a head line, the panels in rows, and a legend.

    Args:
        texts: Text of each panel.
        caption: Text of the film.
        width: Width of a picture [pixels].
        height: Height of a picture [pixels].
        columns: Panels in a row; None for at most four.

    Attributes:
        size: Width and height of a frame [pixels], both even.
    """

    def __init__(
        self,
        texts: Sequence[PanelText],
        caption: Caption,
        *,
        width: int,
        height: int,
        columns: int | None = None,
    ) -> None:
        scale = self._scale = _Scale(height)
        # Rows are as even as possible: five panels are three and two.
        rows = -(-len(texts) // (columns or MOST_ROW))
        in_row = min(columns or -(-len(texts) // rows), len(texts))
        step = (
            width + scale.gap,
            scale.large_line + height + scale.small_line + scale.gap,
        )
        sheet = _Sheet(
            scale.gap + in_row * step[0], rows * step[1], caption, scale, is_even=True
        )
        self._ground, self.size = sheet, sheet.image.size
        sheet.head(caption, self.size[0] - 2 * scale.gap - 9 * scale.large)
        self._places = [
            (
                scale.gap + (index % in_row) * step[0],
                sheet.top + (index // in_row) * step[1] + scale.large_line,
            )
            for index in range(len(texts))
        ]
        for text, (left, top) in zip(texts, self._places, strict=True):
            above, under = (
                top - 0.5 * scale.large_line,
                top + height + 0.5 * scale.small_line,
            )
            used = sheet.write((left, above), text.title, width, is_large=True)
            sheet.write(
                (left + width, above),
                text.detail,
                width - used - scale.gap,
                color=QUIET,
                from_right=True,
            )
            sheet.write((left, under), text.note, width)

    def frame(
        self, pictures: Sequence[NDArray[np.uint8]], clock: str
    ) -> NDArray[np.uint8]:
        """Return a frame, shape [height, width, 3].

        Args:
            pictures: Picture of each panel, shape [height, width, 3].
            clock: The time, in words.
        """
        frame, scale = self._ground.copy(), self._scale
        for picture, place in zip(pictures, self._places, strict=True):
            frame.image.paste(Image.fromarray(picture), place)
        middle = scale.gap + 0.5 * scale.large_line
        frame.write(
            (self.size[0] - scale.gap, middle), clock, is_large=True, from_right=True
        )
        return np.array(frame.image)


def strip_picture(
    rows: Sequence[Sequence[NDArray[np.uint8]]],
    texts: Sequence[PanelText],
    caption: Caption,
    clocks: Sequence[str],
) -> NDArray[np.uint8]:
    """Return pictures at a few times beside each other, a row for each panel, shape [height, width, 3].

    Args:
        rows: Pictures of each panel, shape [height, width, 3] each.
        texts: Text of each panel.
        caption: Text of the strip.
        clocks: The times, in words.
    """
    height, width = rows[0][0].shape[:2]
    scale = _Scale(height)
    row_height = scale.large_line + height + scale.gap
    sheet = _Sheet(
        scale.gap + len(clocks) * (width + scale.gap),
        len(rows) * row_height,
        caption,
        scale,
    )
    room = sheet.image.width - 2 * scale.gap
    sheet.head(caption, room)
    for number, (pictures, text) in enumerate(zip(rows, texts, strict=True)):
        top = sheet.top + number * row_height
        middle = top + 0.5 * scale.large_line
        left = (
            sheet.write((scale.gap, middle), text.title, room, is_large=True)
            + 2 * scale.gap
        )
        taken = sheet.write(
            (scale.gap + room, middle), text.note, room - left, from_right=True
        )
        sheet.write(
            (scale.gap + left, middle),
            text.detail,
            room - left - taken - scale.gap,
            color=QUIET,
        )
        for column, (picture, clock) in enumerate(zip(pictures, clocks, strict=True)):
            corner = (scale.gap + column * (width + scale.gap), top + scale.large_line)
            sheet.image.paste(Image.fromarray(picture), corner)
            sheet.tag(clock, corner)
    return np.array(sheet.image)


# --- text ---

Entry = tuple[Color | None, str]
"""Colour of a spot, or None, and text of an entry of the legend."""


class _Sheet:
    """A white picture with a head, room for panels, and a legend below them.

    Args:
        width: Its width [pixels].
        height: Height of the panels [pixels].
        caption: Its text.
        scale: Sizes of text.
        is_even: Whether its sides are rounded up to even numbers.

    Attributes:
        image: The picture.
        top: Upper end of the panels [pixels].
    """

    def __init__(
        self,
        width: int,
        height: int,
        caption: Caption,
        scale: _Scale,
        *,
        is_even: bool = False,
    ) -> None:
        self._scale = scale
        self.top = scale.gap + scale.large_line + scale.small_line
        legend = _legend_lines(caption, width - 2 * scale.gap, scale)
        full_height = self.top + height + len(legend) * scale.small_line + scale.gap
        odd = (width % 2, full_height % 2) if is_even else (0, 0)
        self.image = Image.new("RGB", (width + odd[0], full_height + odd[1]), GROUND)
        for number, line in enumerate(legend):
            left, middle = (
                float(scale.gap),
                self.top + height + (number + 0.5) * scale.small_line,
            )
            for color, text in line:
                if color:
                    self._spot((left, middle), 0.38 * scale.small, color)
                self.write(
                    (left + _spot_width(color, scale), middle), text, color=QUIET
                )
                left += _entry_width(color, text, scale)

    def copy(self) -> _Sheet:
        """Return a sheet with a picture of its own."""
        other = copy(self)
        other.image = self.image.copy()
        return other

    def head(self, caption: Caption, width: float) -> None:
        """Write title and subtitle."""
        gap, large, small = (
            self._scale.gap,
            self._scale.large_line,
            self._scale.small_line,
        )
        self.write((gap, gap + 0.5 * large), caption.title, width, is_large=True)
        self.write(
            (gap, gap + large + 0.5 * small), caption.subtitle, width, color=QUIET
        )

    def write(
        self,
        place: tuple[float, float],
        text: str,
        room: float = math.inf,
        *,
        is_large: bool = False,
        color: tuple[int, int, int] = INK,
        from_right: bool = False,
    ) -> float:
        """Write a text in a line, cut to its room, and return its width [pixels].

        Args:
            place: Left end of the line and its middle [pixels].
            text: The text.
            room: Largest width [pixels].
            is_large: Whether the letters are large.
            color: Colour.
            from_right: Whether the place is the right end.
        """
        size = self._scale.large if is_large else self._scale.small
        text = _fitted(text, size, room)
        if not text:
            return 0.0
        width, height = round(_length(text, size)) + 4, 2 * size
        mask = Image.new("L", (FINER * width, FINER * height))
        ImageDraw.Draw(mask).text(
            (2 * FINER, FINER * size), text, fill=255, font=_font(size), anchor="lm"
        )
        mask = mask.resize((width, height), Image.Resampling.BOX)
        left = place[0] - width + 2 if from_right else place[0] - 2
        self.image.paste(color, (round(left), round(place[1]) - size), mask)
        return _length(text, size)

    def tag(self, text: str, corner: tuple[int, int]) -> None:
        """Write a time on a light field in the corner of a picture."""
        (left, top), size, line = corner, self._scale.small, self._scale.small_line
        pad = size // 2
        self.image.paste(
            GROUND, (left, top, left + round(_length(text, size)) + 2 * pad, top + line)
        )
        self.write((left + pad, top + 0.5 * line), text)

    def _spot(self, place: tuple[float, float], radius: float, color: Color) -> None:
        """Draw a disk whose left end is at a place."""
        side = round(2 * radius) + 2
        mask = Image.new("L", (FINER * side, FINER * side))
        ImageDraw.Draw(mask).ellipse(
            (0, 0, FINER * 2 * radius, FINER * 2 * radius), fill=255
        )
        red, green, blue = (round(255 * part) for part in color[:3])
        corner = (round(place[0]), round(place[1] - radius))
        self.image.paste(
            (red, green, blue), corner, mask.resize((side, side), Image.Resampling.BOX)
        )


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    """Return the font that comes with Pillow, `FINER` times larger than a size [pixels]."""
    font = ImageFont.load_default(FINER * size)
    assert isinstance(font, ImageFont.FreeTypeFont)
    return font


def _length(text: str, size: int) -> float:
    """Return the width of a text [pixels]."""
    return _font(size).getlength(text) / FINER


def _fitted(text: str, size: int, width: float) -> str:
    """Return a text that fits, with dots where it was cut."""
    if _length(text, size) <= width:
        return text
    while text and _length(f"{text.rstrip()} ...", size) > width:
        text = text[:-1]
    return f"{text.rstrip()} ..." if text else ""


def _legend_lines(caption: Caption, width: float, scale: _Scale) -> list[list[Entry]]:
    """Return the entries of the legend in lines that fit."""
    entries: list[Entry] = [
        (SIMULATED_COLOR, caption.simulated),
        (RECORDED_COLOR, caption.reference),
    ]
    lines: list[list[Entry]] = []
    left = 0.0
    for color, text in (*entries, (None, caption.remark)):
        if not text:
            continue
        taken = _entry_width(color, text, scale)
        if not lines or (lines[-1] and left + taken > width):
            lines.append([])
            left = 0.0
        room = width - (taken - _length(text, scale.small))
        lines[-1].append((color, _fitted(text, scale.small, room)))
        left += taken
    return lines


def _spot_width(color: Color | None, scale: _Scale) -> float:
    return 1.4 * scale.small if color else 0.0


def _entry_width(color: Color | None, text: str, scale: _Scale) -> float:
    return _spot_width(color, scale) + _length(text, scale.small) + 1.5 * scale.small
