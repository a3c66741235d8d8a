"""Frames of films: pictures side by side with small text."""

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
"""Largest number of panels in a row."""


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
    """Text of a film.

    Attributes:
        title: Id of the experiment.
        subtitle: What happens in it.
        reference: What is drawn in the colour of the reference; empty if nothing is.
        remark: Further words below the pictures.
    """

    title: str
    subtitle: str
    reference: str
    remark: str = ""


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
    ) -> None:
        self._scale = scale = _Scale(height)
        legend: list[tuple[Color | None, str]] = [
            (SIMULATED_COLOR, "simulated"),
            (RECORDED_COLOR, caption.reference),
            (None, caption.remark),
        ]
        legend = [(color, text) for color, text in legend if text]
        # Rows are as even as possible: five panels are three and two.
        rows = -(-len(texts) // MOST_ROW)
        in_row = -(-len(texts) // rows)
        across = width + scale.gap
        down = scale.large_line + height + scale.small_line + scale.gap
        top = scale.gap + scale.large_line + scale.small_line
        low = top + rows * down
        right = scale.gap + in_row * across
        bottom = low + len(legend) * scale.small_line + scale.gap
        self.size = (right + right % 2, bottom + bottom % 2)
        self._image = Image.new("RGB", self.size, GROUND)
        left, room = scale.gap, right - 2 * scale.gap
        middle = scale.gap + 0.5 * scale.large_line
        self._write(
            (left, middle), caption.title, room - CLOCK * scale.large, is_large=True
        )
        self._write((left, top - 0.5 * scale.small_line), caption.subtitle, room, QUIET)
        self._places = [
            (
                left + (index % in_row) * across,
                top + (index // in_row) * down + scale.large_line,
            )
            for index in range(len(texts))
        ]
        for text, (x, y) in zip(texts, self._places, strict=True):
            above, under = y - 0.5 * scale.large_line, y + height
            used = self._write((x, above), text.title, width, is_large=True)
            end = (x + width, above)
            self._write(
                end, text.detail, width - used - scale.gap, QUIET, from_right=True
            )
            self._write((x, under + 0.5 * scale.small_line), text.note, width)
        for number, (color, words) in enumerate(legend):
            line = low + (number + 0.5) * scale.small_line
            start = left + (0.0 if color is None else 1.4 * scale.small)
            self._write((start, line), words, room, QUIET)
            if color is not None:
                radius = 0.38 * scale.small
                box = (left, line - radius, left + 2.0 * radius, line + radius)
                red, green, blue = (round(255 * part) for part in color[:3])
                ImageDraw.Draw(self._image).ellipse(box, fill=(red, green, blue))

    def frame(
        self, pictures: Sequence[NDArray[np.uint8]], clock: str
    ) -> NDArray[np.uint8]:
        """Return a frame, shape [height, width, 3].

        Args:
            pictures: Picture of each panel, shape [height, width, 3].
            clock: The time, in words.
        """
        scale = self._scale
        for picture, place in zip(pictures, self._places, strict=True):
            self._image.paste(Image.fromarray(picture), place)
        right, low = self.size[0] - scale.gap, scale.gap + scale.large_line
        box = (right - CLOCK * scale.large, scale.gap, right, low)
        self._image.paste(GROUND, box)
        middle = scale.gap + scale.large_line // 2
        self._write((right, middle), clock, is_large=True, from_right=True)
        return np.array(self._image)

    def _write(
        self,
        place: tuple[float, float],
        text: str,
        room: float = math.inf,
        color: tuple[int, int, int] = INK,
        *,
        is_large: bool = False,
        from_right: bool = False,
    ) -> float:
        """Write a text in a line, cut to its room, and return its width [pixels].

        Args:
            place: Left end of the line and its middle [pixels].
            text: The text.
            room: Largest width [pixels].
            color: Colour.
            is_large: Whether the letters are large.
            from_right: Whether the place is the right end.
        """
        font = _font(self._scale.large if is_large else self._scale.small)
        shown = text
        while shown and font.getlength(shown) > room:
            text = text[:-1].rstrip()
            shown = f"{text} ..." if text else ""
        anchor = "rm" if from_right else "lm"
        ImageDraw.Draw(self._image).text(
            place, shown, fill=color, font=font, anchor=anchor
        )
        return float(font.getlength(shown))


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    """Return the font of a size [pixels] that comes with Pillow."""
    font = ImageFont.load_default(size)
    assert isinstance(font, ImageFont.FreeTypeFont)
    return font
