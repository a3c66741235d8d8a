"""Frames of films and strips: pictures side by side with small text."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from gauge_envs.rendering.overlay import RECORDED_COLOR, SIMULATED_COLOR, Color

GROUND = (255, 255, 255)
INK = (28, 32, 38)
QUIET = (104, 110, 120)

CLOCK = 9
"""Width of the time, in sizes of its letters."""

MOST_ROW = 4
"""Largest number of panels in a row, if no number is chosen."""


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
        scale = _Scale(height)
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
        self._sheet, self.size = sheet, sheet.image.size
        sheet.head(caption, self.size[0] - 2 * scale.gap - CLOCK * scale.large)
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
        sheet, scale = self._sheet, self._sheet.scale
        for picture, place in zip(pictures, self._places, strict=True):
            sheet.image.paste(Image.fromarray(picture), place)
        right, middle = self.size[0] - scale.gap, scale.gap + scale.large_line // 2
        low = scale.gap + scale.large_line
        sheet.image.paste(GROUND, (right - CLOCK * scale.large, scale.gap, right, low))
        sheet.write((right, middle), clock, is_large=True, from_right=True)
        return np.array(sheet.image)


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
        self.scale = scale
        self.top = scale.gap + scale.large_line + scale.small_line
        legend: list[tuple[Color | None, str]] = [
            (SIMULATED_COLOR, caption.simulated),
            (RECORDED_COLOR, caption.reference),
            (None, caption.remark),
        ]
        legend = [(color, text) for color, text in legend if text]
        bottom = self.top + height + len(legend) * scale.small_line + scale.gap
        size = (width, bottom)
        if is_even:
            size = (width + width % 2, bottom + bottom % 2)
        self.image = Image.new("RGB", size, GROUND)
        for number, (color, text) in enumerate(legend):
            left: float = scale.gap
            middle = self.top + height + (number + 0.5) * scale.small_line
            if color is not None:
                radius = 0.38 * scale.small
                box = (left, middle - radius, left + 2.0 * radius, middle + radius)
                red, green, blue = (round(255 * part) for part in color[:3])
                ImageDraw.Draw(self.image).ellipse(box, fill=(red, green, blue))
                left += 1.4 * scale.small
            self.write((left, middle), text, width - scale.gap - left, color=QUIET)

    def head(self, caption: Caption, width: float) -> None:
        """Write title and subtitle."""
        left, scale = self.scale.gap, self.scale
        middle = scale.gap + 0.5 * scale.large_line
        self.write((left, middle), caption.title, width, is_large=True)
        middle = scale.gap + scale.large_line + 0.5 * scale.small_line
        self.write((left, middle), caption.subtitle, width, color=QUIET)

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
        font = _font(self.scale.large if is_large else self.scale.small)
        shown = text
        while shown and font.getlength(shown) > room:
            text = text[:-1].rstrip()
            shown = f"{text} ..." if text else ""
        anchor = "rm" if from_right else "lm"
        ImageDraw.Draw(self.image).text(
            place, shown, fill=color, font=font, anchor=anchor
        )
        return float(font.getlength(shown))

    def tag(self, text: str, corner: tuple[int, int]) -> None:
        """Write a time on a light field in the corner of a picture."""
        left, top = corner
        font, pad = _font(self.scale.small), self.scale.small // 2
        right = left + round(font.getlength(text)) + 2 * pad
        self.image.paste(GROUND, (left, top, right, top + self.scale.small_line))
        self.write((left + pad, top + 0.5 * self.scale.small_line), text)


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    """Return the font of a size [pixels] that comes with Pillow."""
    font = ImageFont.load_default(size)
    assert isinstance(font, ImageFont.FreeTypeFont)
    return font
