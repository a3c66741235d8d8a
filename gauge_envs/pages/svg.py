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

SHOWN_PX = 0.2
"""Largest distance of a simplified curve from its samples, in units of the figure."""


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


def curve_panel(panel: CurvePanel) -> Html:
    """Return a panel as SVG."""
    low, high = _range(panel)
    to_x = _scale(0.0, panel.end_s or 1.0, LEFT, WIDTH - RIGHT)
    to_y = _scale(low, high, HEIGHT - BOTTOM, TOP)
    parts = [element("text", panel.title, x=LEFT, y=13)]
    for tick in _ticks(low, high):
        y = float(to_y(np.array(tick)))
        parts.append(
            element(
                "line",
                x1=LEFT,
                x2=WIDTH - RIGHT,
                y1=f"{y:.1f}",
                y2=f"{y:.1f}",
                class_="grid",
            )
        )
        parts.append(
            element(
                "text",
                _tick_text(tick),
                x=LEFT - 4,
                y=f"{y + 4:.1f}",
                text_anchor="end",
                class_="quiet",
            )
        )
    for tick in _ticks(0.0, panel.end_s):
        x = float(to_x(np.array(tick)))
        text = _tick_text(tick)
        parts.append(
            element(
                "text",
                text,
                x=f"{x:.1f}",
                y=HEIGHT - BOTTOM + 14,
                text_anchor="middle",
                class_="quiet",
            )
        )
    parts.append(
        element(
            "text",
            "time [s]",
            x=(LEFT + WIDTH) / 2,
            y=HEIGHT - 5,
            text_anchor="middle",
            class_="quiet",
        )
    )
    if len(panel.times_s):
        parts += _band(panel, to_x, to_y)
    curves = []
    for (color, is_dashed), label, times_s, values in panel.curves:
        shown = (times_s <= panel.end_s + 1e-9) & np.isfinite(values)
        points = np.column_stack(
            [to_x(times_s[shown]), np.clip(to_y(values[shown]), -HEIGHT, 2.0 * HEIGHT)]
        )
        if len(points):
            dashes = "5 3" if is_dashed else None
            along = _points(simplified(points, SHOWN_PX))
            line = element(
                "polyline",
                points=along,
                stroke=color,
                stroke_dasharray=dashes,
                class_="curve",
            )
            curves.append(element("g", element("title", label), line))
    width, height = WIDTH - RIGHT - LEFT, HEIGHT - BOTTOM - TOP
    # An inner SVG cuts what leaves the frame.
    inside = element(
        "svg",
        *curves,
        x=LEFT,
        y=TOP,
        width=width,
        height=height,
        viewBox=f"{LEFT} {TOP} {width} {height}",
    )
    return element(
        "svg",
        *parts,
        inside,
        element(
            "path", d=f"M{LEFT} {TOP}V{HEIGHT - BOTTOM}H{WIDTH - RIGHT}", class_="axis"
        ),
        viewBox=f"0 0 {WIDTH:.0f} {HEIGHT:.0f}",
        role="img",
        aria_label=f"{panel.title} over time",
        class_="plot",
    )


def _band(
    panel: CurvePanel,
    to_x: Callable[[FloatArray], FloatArray],
    to_y: Callable[[FloatArray], FloatArray],
) -> list[Html]:
    """Return areas of one and two sigma and the mean; what is extrapolated is dotted."""
    shown = panel.times_s <= panel.end_s + 1e-9
    times, mean, sigma = (
        values[shown] for values in (panel.times_s, panel.mean, panel.sigma)
    )
    measured = panel.measured[shown]
    parts: list[Html] = []
    for first, last in runs(np.isfinite(mean)):
        piece = slice(first, last)
        for reach, kind in ((2.0, "sigma2"), (1.0, "sigma1")):
            spread = reach * np.nan_to_num(sigma[piece])
            edge = np.concatenate([mean[piece] + spread, (mean[piece] - spread)[::-1]])
            along = np.concatenate([times[piece], times[piece][::-1]])
            points = np.column_stack(
                [to_x(along), np.clip(to_y(edge), TOP, HEIGHT - BOTTOM)]
            )
            parts.append(element("polygon", points=_points(points), class_=kind))
    for flags, dashes in ((measured, None), (~measured, "1 3")):
        for first, last in runs(flags & np.isfinite(mean)):
            # A piece reaches the next point, so that pieces join.
            piece = slice(first, min(last + 1, len(mean)))
            known = np.isfinite(mean[piece])
            points = np.column_stack(
                [to_x(times[piece][known]), to_y(mean[piece][known])]
            )
            line = element(
                "polyline",
                points=_points(simplified(points, SHOWN_PX)),
                class_="real",
                stroke_dasharray=dashes,
            )
            parts.append(line)
    return parts


def runs(flags: BoolArray) -> list[tuple[int, int]]:
    """Return half-open ranges of true flags."""
    edges = np.diff(np.concatenate([[False], flags, [False]]).astype(int))
    return list(
        zip(
            np.flatnonzero(edges == 1).tolist(),
            np.flatnonzero(edges == -1).tolist(),
            strict=True,
        )
    )


def _range(panel: CurvePanel) -> tuple[float, float]:
    """Return limits that hold the band and the curves; a curve that leaves the band by far is cut."""
    reals = np.concatenate(
        [panel.mean - 2.0 * panel.sigma, panel.mean + 2.0 * panel.sigma]
    )
    reals = reals[np.isfinite(reals)]
    values = np.concatenate(
        [curve[3][curve[2] <= panel.end_s + 1e-9] for curve in panel.curves]
        or [np.zeros(0)]
    )
    values = values[np.isfinite(values)]
    if len(reals):
        reach = 10.0 * max(float(np.ptp(reals)), panel.least_range, 1e-9)
        values = np.clip(values, reals.min() - reach, reals.max() + reach)
    every = np.concatenate([reals, values])
    low, high = (float(every.min()), float(every.max())) if len(every) else (0.0, 1.0)
    lacking = max(panel.least_range - (high - low), 0.0)
    low, high = low - 0.5 * lacking, high + 0.5 * lacking
    margin = 0.05 * (high - low) or max(0.05 * abs(high), 1e-6)
    return low - margin, high + margin


def _scale(
    low: float, high: float, start: float, end: float
) -> Callable[[FloatArray], FloatArray]:
    return lambda values: (
        start
        + (np.asarray(values, dtype=np.float64) - low) * (end - start) / (high - low)
    )


def _ticks(low: float, high: float) -> list[float]:
    """Return round numbers in a range, about six."""
    span = high - low
    if not span > 0.0:
        return [low]
    raw = span / 6
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(
        factor * power
        for factor in (1.0, 2.0, 5.0, 10.0)
        if factor * power >= raw * 0.999
    )
    return [
        step * number
        for number in range(
            math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1
        )
    ]


def _tick_text(value: float) -> str:
    return quantity_text(round(value, 9) + 0.0)


def _points(points: FloatArray) -> str:
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points.tolist())


def simplified(points: FloatArray, tolerance: float) -> FloatArray:
    """Return the points of a line without those that it misses by no more than a tolerance (Ramer, Douglas, Peucker).

    Args:
        points: Points, shape [point_count, 2].
        tolerance: Largest distance of a left-out point from the simpler line.
    """
    kept = np.zeros(len(points), dtype=bool)
    kept[[0, -1]] = True
    waiting = [(0, len(points) - 1)]
    while waiting:
        first, last = waiting.pop()
        if last - first < 2:
            continue
        start, along = points[first], points[last] - points[first]
        inner = points[first + 1 : last] - start
        length = float(np.hypot(*along))
        away = (
            np.hypot(*inner.T)
            if length == 0.0
            else np.abs(inner[:, 0] * along[1] - inner[:, 1] * along[0]) / length
        )
        worst = int(away.argmax())
        if away[worst] > tolerance:
            middle = first + 1 + worst
            kept[middle] = True
            waiting += [(first, middle), (middle, last)]
    return points[kept]


# --- scores ---

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
    highest = max(
        [1.0, *(row.interval[1] if row.interval else row.value for row in rows)]
    )
    right = 10.0 ** math.ceil(math.log10(highest * 1.2))
    span = (math.log10(MIN_SCORE), math.log10(right))
    to_x = _scale(*span, LABELS, WIDTH - VALUES)

    def place(value: float) -> float:
        return float(to_x(np.array(math.log10(max(value, MIN_SCORE)))))

    bottom = TOP + ROW * len(rows)
    parts: list[Html] = [element("text", title, x=2, y=12, font_weight="600")]
    for power in range(round(span[0]), round(span[1]) + 1):
        x, value = place(10.0**power), 10.0**power
        kind = "one" if power == 0 else "grid"
        parts.append(
            element(
                "line", x1=f"{x:.1f}", x2=f"{x:.1f}", y1=TOP, y2=bottom, class_=kind
            )
        )
        # More decades leave too little room for the words.
        text = (
            f"1 = {unity}"
            if power == 0 and span[1] - span[0] <= MAX_WORDED
            else f"{value:g}"
        )
        parts.append(
            element(
                "text",
                text,
                x=f"{x:.1f}",
                y=bottom + 13,
                text_anchor="middle",
                class_="quiet",
            )
        )
    for number, row in enumerate(rows):
        y = TOP + ROW * (number + 0.5)
        name = (
            row.label
            if len(row.label) <= LONGEST_LABEL
            else f"{row.label[: LONGEST_LABEL - 1]}\u2026"
        )
        parts.append(element("text", name, x=2, y=f"{y + 4:.1f}"))
        low, high = row.interval or (row.value, row.value)
        paint = f"stroke:{row.color};stroke-width:2.5"
        parts.append(
            element(
                "line",
                x1=f"{place(low):.1f}",
                x2=f"{place(high):.1f}",
                y1=y,
                y2=y,
                style=paint,
            )
        )
        if low < MIN_SCORE:
            x = place(low)
            arrow = f"M{x + 4:.1f} {y - 4}L{x - 1:.1f} {y}L{x + 4:.1f} {y + 4}"
            parts.append(element("path", d=arrow, style=f"fill:none;{paint}"))
        if row.value >= MIN_SCORE:
            parts.append(
                element(
                    "circle",
                    cx=f"{place(row.value):.1f}",
                    cy=y,
                    r=4,
                    style=f"fill:{row.color}",
                )
            )
        parts.append(
            element(
                "text",
                score_text(row.value),
                x=WIDTH - 2,
                y=f"{y + 4:.1f}",
                text_anchor="end",
            )
        )
    values = "; ".join(
        f"{row.label} {interval_text(row.value, row.interval)}" for row in rows
    )
    box, label = f"0 0 {WIDTH:.0f} {bottom + 18:.0f}", f"{title}: {values}"
    drawing = element(
        "svg", *parts, viewBox=box, role="img", aria_label=label, class_="plot"
    )
    if any(row.value < MIN_SCORE for row in rows):
        note = f"Scores below {MIN_SCORE:g} have an arrow in place of a dot."
        return element("figure", drawing, element("figcaption", note))
    return element("figure", drawing)
