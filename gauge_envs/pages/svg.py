"""Small inline SVG figures: curves over a band, and scores with intervals on a logarithmic axis.

Their colours are those of the page, also in dark mode. A figure is 360 units wide, so that its text is as large as the
page's on a phone.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from gauge_envs.pages.html import Html, element
from gauge_envs.pages.text import interval_text, quantity_text, score_text
from gauge_envs.scene.geometry import BoolArray, FloatArray

WIDTH, LEFT, RIGHT = 360.0, 46.0, 8.0
HEIGHT, TOP, BOTTOM = 200.0, 20.0, 34.0

MAX_POINTS = 300
"""Largest number of points of a curve: about one in each unit of the figure."""

Scale = Callable[[float | FloatArray], FloatArray]
"""Place of values along an axis of the figure."""


@dataclass(frozen=True, kw_only=True)
class CurvePanel:
    """One coordinate over time.

    Attributes:
        title: Name and unit of the coordinate.
        curves: Colour in CSS and whether it is dashed, label, times [s] and values of each curve.
        end_s: End of the time axis [s].
        times_s: Times of the real mean [s]; empty without a reference.
        mean: Real mean at those times; NaN is unknown.
        sigma: Its standard deviation.
        measured: Whether a time was measured; the others are extrapolated and drawn dotted.
        least_range: Range that the panel has at least: rounding errors must not fill it.
    """

    title: str
    curves: Sequence[tuple[tuple[str, bool], str, FloatArray, FloatArray]]
    end_s: float
    times_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    mean: FloatArray = field(default_factory=lambda: np.zeros(0))
    sigma: FloatArray = field(default_factory=lambda: np.zeros(0))
    measured: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))
    least_range: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ForestRow:
    """A score with its interval.

    Attributes:
        label: Name of the row.
        color: Colour in CSS.
        value: The score.
        interval: Its 95 % interval, or None.
    """

    label: str
    color: str
    value: float
    interval: tuple[float, float] | None


def _text(x: float, y: float, text: str, anchor: str | None = None) -> Html:
    """Return a text; with an anchor it is a quiet one, as at an axis."""
    kind = None if anchor is None else "quiet"
    return element(
        "text", text, x=f"{x:.1f}", y=f"{y:.1f}", text_anchor=anchor, class_=kind
    )


def _line(start: tuple[float, float], end: tuple[float, float], **look: str) -> Html:
    (x1, y1), (x2, y2) = start, end
    ends = {"x1": x1, "y1": y1, "x2": x2, "y2": y2}
    return element("line", **{key: f"{at:.1f}" for key, at in ends.items()}, **look)


def _points(x: FloatArray, y: FloatArray) -> str:
    return " ".join(f"{at_x:.1f},{at_y:.1f}" for at_x, at_y in zip(x, y, strict=True))


def _scale(low: float, high: float, start: float, end: float) -> Scale:
    return lambda values: (
        start
        + (np.asarray(values, dtype=np.float64) - low) * (end - start) / (high - low)
    )


def _ticks(low: float, high: float) -> list[float]:
    """Return round numbers in a range, about six."""
    span = high - low
    if not span > 0.0:
        return [low]
    power = 10.0 ** math.floor(math.log10(span / 6))
    step = next(
        factor * power
        for factor in (1.0, 2.0, 5.0, 10.0)
        if factor * power >= span / 6 * 0.999
    )
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [step * number for number in range(first, last + 1)]


# --- curves ----------------------------------------------------------------------------------------------------------


def curve_panel(panel: CurvePanel) -> Html:
    """Return a panel as SVG."""
    low, high = _range(panel)
    to_x = _scale(0.0, panel.end_s or 1.0, LEFT, WIDTH - RIGHT)
    to_y = _scale(low, high, HEIGHT - BOTTOM, TOP)
    parts = [_text(LEFT, 13, panel.title)]
    for tick in _ticks(low, high):
        y = float(to_y(tick))
        parts.append(_line((LEFT, y), (WIDTH - RIGHT, y), class_="grid"))
        parts.append(_text(LEFT - 4, y + 4, _tick_text(tick), "end"))
    for tick in _ticks(0.0, panel.end_s):
        x = float(to_x(tick))
        parts.append(_text(x, HEIGHT - BOTTOM + 14, _tick_text(tick), "middle"))
    parts.append(_text((LEFT + WIDTH) / 2, HEIGHT - 5, "time [s]", "middle"))
    parts += _band(panel, to_x, to_y)
    width, height = WIDTH - RIGHT - LEFT, HEIGHT - BOTTOM - TOP
    # An inner SVG cuts what leaves the frame.
    parts.append(
        element(
            "svg",
            *_curves(panel, to_x, to_y),
            x=LEFT,
            y=TOP,
            width=width,
            height=height,
            viewBox=f"{LEFT} {TOP} {width} {height}",
        )
    )
    axis = f"M{LEFT} {TOP}V{HEIGHT - BOTTOM}H{WIDTH - RIGHT}"
    parts.append(element("path", d=axis, class_="axis"))
    return _drawing(parts, HEIGHT, f"{panel.title} over time")


def _drawing(parts: Sequence[Html], height: float, label: str) -> Html:
    box = f"0 0 {WIDTH:.0f} {height:.0f}"
    return element(
        "svg", *parts, viewBox=box, role="img", aria_label=label, class_="plot"
    )


def _tick_text(value: float) -> str:
    return quantity_text(round(value, 9) + 0.0)


def _curves(panel: CurvePanel, to_x: Scale, to_y: Scale) -> list[Html]:
    """Return the curves up to the end of the axis, each with its label."""
    parts = []
    for (color, is_dashed), label, times_s, values in panel.curves:
        shown = np.flatnonzero((times_s <= panel.end_s + 1e-9) & np.isfinite(values))
        if not len(shown):
            continue
        count = min(len(shown), MAX_POINTS)
        shown = shown[np.linspace(0, len(shown) - 1, count).round().astype(int)]
        y = np.clip(to_y(values[shown]), -HEIGHT, 2.0 * HEIGHT)
        curve = element(
            "polyline",
            points=_points(to_x(times_s[shown]), y),
            stroke=color,
            stroke_dasharray="5 3" if is_dashed else None,
            class_="curve",
        )
        parts.append(element("g", element("title", label), curve))
    return parts


def _band(panel: CurvePanel, to_x: Scale, to_y: Scale) -> list[Html]:
    """Return areas of one and two sigma and the mean; what is extrapolated is dotted."""
    shown = panel.times_s <= panel.end_s + 1e-9
    x, mean = to_x(panel.times_s[shown]), panel.mean[shown]
    sigma, measured = np.nan_to_num(panel.sigma[shown]), panel.measured[shown]
    known = np.isfinite(mean)
    parts: list[Html] = []
    for first, last in runs(known):
        piece = slice(first, last)
        for reach, kind in ((2.0, "sigma2"), (1.0, "sigma1")):
            upper = mean[piece] + reach * sigma[piece]
            lower = mean[piece] - reach * sigma[piece]
            edge = np.concatenate([to_y(upper), to_y(lower)[::-1]])
            along = np.concatenate([x[piece], x[piece][::-1]])
            points = _points(along, np.clip(edge, TOP, HEIGHT - BOTTOM))
            parts.append(element("polygon", points=points, class_=kind))
    for flags, dashes in ((measured, None), (~measured, "1 3")):
        for first, last in runs(flags & known):
            # A piece reaches the next point, so that pieces join.
            last = min(last + int(known[last : last + 1].any()), len(mean))
            points = _points(x[first:last], to_y(mean[first:last]))
            parts.append(
                element(
                    "polyline", points=points, class_="real", stroke_dasharray=dashes
                )
            )
    return parts


def runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return half-open ranges of true flags."""
    edges = np.diff(np.concatenate([[False], flags, [False]]).astype(int))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return list(zip(starts.tolist(), ends.tolist(), strict=True))


def _range(panel: CurvePanel) -> tuple[float, float]:
    """Return limits that hold the band and the curves; a curve that leaves the band by far is cut."""
    spread = 2.0 * panel.sigma
    reals = np.concatenate([panel.mean - spread, panel.mean + spread])
    reals = reals[np.isfinite(reals)]
    values = np.concatenate(
        [
            np.zeros(0),
            *(curve[3][curve[2] <= panel.end_s + 1e-9] for curve in panel.curves),
        ]
    )
    values = values[np.isfinite(values)]
    if len(reals):
        reach = 10.0 * max(float(np.ptp(reals)), panel.least_range, 1e-9)
        values = np.clip(values, reals.min() - reach, reals.max() + reach)
    every = np.concatenate([reals, values])
    low, high = (float(every.min()), float(every.max())) if len(every) else (0.0, 1.0)
    lacking = max(panel.least_range - (high - low), 0.0)
    margin = 0.05 * (high - low + lacking) or max(0.05 * abs(high), 1e-6)
    return low - 0.5 * lacking - margin, high + 0.5 * lacking + margin


# --- scores ----------------------------------------------------------------------------------------------------------

ROW = 20.0
MAX_WORDED = 3
"""Largest number of decades of an axis of scores with words below the 1."""
LABELS, LONGEST_LABEL = 134.0, 20
"""Room for the labels at the left, and the length of the longest [characters]."""
VALUES = 52.0
"""Room for the scores at the right end, as 0.00032."""
MIN_SCORE = 0.1
"""Left end of the axis of scores; an arrow points at what is below it."""


def forest(title: str, rows: Sequence[ForestRow], *, unity: str) -> Html:
    """Return scores with intervals on a logarithmic axis, with a line at 1, whose meaning is `unity`."""
    highest = max([1.0, *((row.interval or (0.0, row.value))[1] for row in rows)])
    first, last = round(math.log10(MIN_SCORE)), math.ceil(math.log10(highest * 1.2))
    to_x = _scale(first, last, LABELS, WIDTH - VALUES)

    def place(value: float) -> float:
        return float(to_x(math.log10(max(value, MIN_SCORE))))

    bottom = TOP + ROW * len(rows)
    parts = [element("text", title, x=2, y=12, font_weight="600")]
    for power in range(first, last + 1):
        x = place(10.0**power)
        kind = "grid" if power else "one"
        parts.append(_line((x, TOP), (x, bottom), class_=kind))
        # More decades leave too little room for the words.
        is_worded = power == 0 and last - first <= MAX_WORDED
        text = f"1 = {unity}" if is_worded else f"{10.0**power:g}"
        parts.append(_text(x, bottom + 13, text, "middle"))
    for number, row in enumerate(rows):
        parts += _forest_row(row, TOP + ROW * (number + 0.5), place)
    values = "; ".join(
        f"{row.label} {interval_text(row.value, row.interval)}" for row in rows
    )
    drawing = _drawing(parts, bottom + 18, f"{title}: {values}")
    if any(row.value < MIN_SCORE for row in rows):
        note = f"Scores below {MIN_SCORE:g} have an arrow in place of a dot."
        return element("figure", drawing, element("figcaption", note))
    return element("figure", drawing)


def _forest_row(
    row: ForestRow, y: float, place: Callable[[float], float]
) -> list[Html]:
    """Return label, interval, dot and score of a row."""
    name = row.label
    if len(name) > LONGEST_LABEL:
        name = f"{name[: LONGEST_LABEL - 1]}\u2026"
    low, high = row.interval or (row.value, row.value)
    paint = f"stroke:{row.color};stroke-width:2.5"
    x = place(low)
    parts = [_text(2, y + 4, name), _line((x, y), (place(high), y), style=paint)]
    if low < MIN_SCORE:
        arrow = f"M{x + 4:.1f} {y - 4}L{x - 1:.1f} {y}L{x + 4:.1f} {y + 4}"
        parts.append(element("path", d=arrow, style=f"fill:none;{paint}"))
    if row.value >= MIN_SCORE:
        x = place(row.value)
        paint = f"fill:{row.color}"
        parts.append(element("circle", cx=f"{x:.1f}", cy=y, r=4, style=paint))
    score = score_text(row.value)
    parts.append(
        element("text", score, x=WIDTH - 2, y=f"{y + 4:.1f}", text_anchor="end")
    )
    return parts
