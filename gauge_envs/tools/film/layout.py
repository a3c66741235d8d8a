"""Frames of films and strips: pictures side by side with small text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from gauge_envs.envs.rendering.overlay import RECORDED_COLOR, SIMULATED_COLOR, Color

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
        self, texts: Sequence[PanelText], caption: Caption, *, width: int, height: int, columns: int | None = None
    ) -> None:
        scale = self._scale = _Scale(height)
        # Rows are as even as possible: five panels are three and two.
        rows = -(-len(texts) // (columns or MOST_ROW))
        in_row = columns or -(-len(texts) // rows)
        in_row = min(in_row, len(texts))
        panel_height = scale.large_line + height + scale.small_line + scale.gap
        self._head = scale.gap + scale.large_line + scale.small_line
        full_width = scale.gap + in_row * (width + scale.gap)
        legend = _legend_lines(caption, full_width - 2 * scale.gap, scale)
        full_height = self._head + rows * panel_height + len(legend) * scale.small_line + scale.gap
        self.size = (full_width + full_width % 2, full_height + full_height % 2)
        self._places = [
            (
                scale.gap + (index % in_row) * (width + scale.gap),
                self._head + (index // in_row) * panel_height + scale.large_line,
            )
            for index in range(len(texts))
        ]
        self._ground = Image.new("RGB", self.size, GROUND)
        clock_width = 9 * scale.large
        _head(self._ground, caption, scale, self.size[0] - 2 * scale.gap - clock_width)
        for text, place in zip(texts, self._places, strict=True):
            _panel_text(self._ground, text, place, width, height, scale)
        _draw_legend(self._ground, legend, scale, self._head + rows * panel_height)

    def frame(self, pictures: Sequence[NDArray[np.uint8]], clock: str) -> NDArray[np.uint8]:
        """Return a frame, shape [height, width, 3].

        Args:
            pictures: Picture of each panel, shape [height, width, 3].
            clock: The time, in words.
        """
        frame = self._ground.copy()
        for picture, place in zip(pictures, self._places, strict=True):
            frame.paste(Image.fromarray(picture), place)
        scale = self._scale
        middle = scale.gap + 0.5 * scale.large_line
        _write(frame, (self.size[0] - scale.gap, middle), clock, size=scale.large, color=INK, from_right=True)
        return np.array(frame)


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
    full_width = scale.gap + len(clocks) * (width + scale.gap)
    row_height = scale.large_line + height + scale.gap
    head = scale.gap + scale.large_line + scale.small_line
    legend = _legend_lines(caption, full_width - 2 * scale.gap, scale)
    full_height = head + len(rows) * row_height + len(legend) * scale.small_line + scale.gap
    sheet = Image.new("RGB", (full_width, full_height), GROUND)
    _head(sheet, caption, scale, full_width - 2 * scale.gap)
    for number, (pictures, text) in enumerate(zip(rows, texts, strict=True)):
        top = head + number * row_height
        _row_text(sheet, text, top, scale)
        for column, (picture, clock) in enumerate(zip(pictures, clocks, strict=True)):
            left = scale.gap + column * (width + scale.gap)
            sheet.paste(Image.fromarray(picture), (left, top + scale.large_line))
            _tag(sheet, clock, (left, top + scale.large_line), scale)
    _draw_legend(sheet, legend, scale, head + len(rows) * row_height)
    return np.array(sheet)


# --- parts ---


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    """Return the font that comes with Pillow, `FINER` times larger than a size [pixels]."""
    font = ImageFont.load_default(FINER * size)
    assert isinstance(font, ImageFont.FreeTypeFont)
    return font


def _length(text: str, size: int) -> float:
    """Return the width of a text [pixels]."""
    return _font(size).getlength(text) / FINER


def _write(
    image: Image.Image,
    place: tuple[float, float],
    text: str,
    *,
    size: int,
    color: tuple[int, int, int],
    from_right: bool = False,
) -> None:
    """Write a text in a line.

    Args:
        image: The image.
        place: Left end of the line and its middle [pixels].
        text: The text.
        size: Size of the font [pixels].
        color: Colour.
        from_right: Whether the place is the right end.
    """
    if not text:
        return
    width, height = round(_length(text, size)) + 4, 2 * size
    mask = Image.new("L", (FINER * width, FINER * height))
    ImageDraw.Draw(mask).text((2 * FINER, FINER * size), text, fill=255, font=_font(size), anchor="lm")
    mask = mask.resize((width, height), Image.Resampling.BOX)
    left = place[0] - 2 if not from_right else place[0] - width + 2
    image.paste(color, (round(left), round(place[1]) - size), mask)


def _fitted(text: str, size: int, width: float) -> str:
    """Return a text that fits, with dots where it was cut."""
    if _length(text, size) <= width:
        return text
    while text and _length(f"{text.rstrip()} ...", size) > width:
        text = text[:-1]
    return f"{text.rstrip()} ..." if text else ""


def _head(image: Image.Image, caption: Caption, scale: _Scale, width: float) -> None:
    title = _fitted(caption.title, scale.large, width)
    _write(image, (scale.gap, scale.gap + 0.5 * scale.large_line), title, size=scale.large, color=INK)
    middle = scale.gap + scale.large_line + 0.5 * scale.small_line
    subtitle = _fitted(caption.subtitle, scale.small, width)
    _write(image, (scale.gap, middle), subtitle, size=scale.small, color=QUIET)


def _panel_text(
    image: Image.Image, text: PanelText, place: tuple[int, int], width: int, height: int, scale: _Scale
) -> None:
    left, top = place
    middle = top - 0.5 * scale.large_line
    title = _fitted(text.title, scale.large, width)
    _write(image, (left, middle), title, size=scale.large, color=INK)
    detail = _fitted(text.detail, scale.small, width - _length(title, scale.large) - scale.gap)
    _write(image, (left + width, middle), detail, size=scale.small, color=QUIET, from_right=True)
    note = _fitted(text.note, scale.small, width)
    _write(image, (left, top + height + 0.5 * scale.small_line), note, size=scale.small, color=INK)


def _row_text(image: Image.Image, text: PanelText, top: int, scale: _Scale) -> None:
    room, middle = image.width - 2 * scale.gap, top + 0.5 * scale.large_line
    title = _fitted(text.title, scale.large, room)
    _write(image, (scale.gap, middle), title, size=scale.large, color=INK)
    left = _length(title, scale.large) + 2 * scale.gap
    note = _fitted(text.note, scale.small, room - left)
    _write(image, (scale.gap + room, middle), note, size=scale.small, color=INK, from_right=True)
    detail = _fitted(text.detail, scale.small, room - left - _length(note, scale.small) - scale.gap)
    _write(image, (scale.gap + left, middle), detail, size=scale.small, color=QUIET)


def _tag(image: Image.Image, text: str, corner: tuple[int, int], scale: _Scale) -> None:
    """Write a time on a light field in the corner of a picture."""
    left, top = corner
    pad = scale.small // 2
    size = (round(_length(text, scale.small)) + 2 * pad, scale.small_line)
    image.paste(GROUND, (left, top, left + size[0], top + size[1]))
    _write(image, (left + pad, top + 0.5 * scale.small_line), text, size=scale.small, color=INK)


Entry = tuple[Color | None, str]


def _legend_lines(caption: Caption, width: float, scale: _Scale) -> list[list[Entry]]:
    """Return the entries of the legend in lines that fit."""
    entries: list[Entry] = [(SIMULATED_COLOR, caption.simulated), (RECORDED_COLOR, caption.reference)]
    entries = [entry for entry in (*entries, (None, caption.remark)) if entry[1]]
    lines: list[list[Entry]] = [[]] if entries else []
    left = 0.0
    for color, text in entries:
        taken = _entry_width(color, text, scale)
        if lines[-1] and left + taken > width:
            lines.append([])
            left = 0.0
        room = width - (taken - _length(text, scale.small))
        lines[-1].append((color, _fitted(text, scale.small, room)))
        left += taken
    return lines


def _entry_width(color: Color | None, text: str, scale: _Scale) -> float:
    return (1.4 * scale.small if color else 0.0) + _length(text, scale.small) + 1.5 * scale.small


def _draw_legend(image: Image.Image, lines: list[list[Entry]], scale: _Scale, top: int) -> None:
    for number, line in enumerate(lines):
        left, middle = float(scale.gap), top + (number + 0.5) * scale.small_line
        for color, text in line:
            start = left
            if color:
                _spot(image, (left, middle), 0.38 * scale.small, color)
                start += 1.4 * scale.small
            _write(image, (start, middle), text, size=scale.small, color=QUIET)
            left += _entry_width(color, text, scale)


def _spot(image: Image.Image, place: tuple[float, float], radius: float, color: Color) -> None:
    """Draw a disk whose left end is at a place."""
    side = round(2 * radius) + 2
    mask = Image.new("L", (FINER * side, FINER * side))
    ImageDraw.Draw(mask).ellipse((0, 0, FINER * 2 * radius, FINER * 2 * radius), fill=255)
    red, green, blue = (round(255 * part) for part in color[:3])
    corner = (round(place[0]), round(place[1] - radius))
    image.paste((red, green, blue), corner, mask.resize((side, side), Image.Resampling.BOX))
