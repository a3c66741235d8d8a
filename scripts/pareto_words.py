"""Error over cost in words, as a table, and as a picture."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from pareto_model import Family, Phenomenon, Point, Tradeoff

from gauge_envs.backends.registry import backend_class
from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part
from gauge_envs.pages.figures import REAL, new_figure, tidy_axis
from gauge_envs.pages.table import Column, Table
from gauge_envs.pages.text import short_id
from gauge_envs.tools.compare.cost import (
    GREY,
    MIN_SHOWN,
    ROW_IN,
    STEP,
    set_ticks,
    step_text,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SCATTER = 1.0
"""Error that equals the real scatter, in units of it."""

TITLES = {
    "rmse": "RMSE over frames",
    "pd": "period",
    "mte": "momentum transfer",
    "lsd": "longest rest",
}


def pareto_document(tradeoff: Tradeoff) -> Document:
    """Return for each phenomenon its statements, and a table with a row per engine and preset.

    The JSON row has all numbers, and the statements with the names of their phenomena.
    """
    parts: list[Part] = []
    statements = []
    for phenomenon in tradeoff.phenomena:
        lines = list(phenomenon_statements(phenomenon, tradeoff))
        statements += [f"{phenomenon.name}: {line}" for line in lines]
        parts += [
            Heading(phenomenon.name, 3),
            Paragraph(_heading(phenomenon)),
            Bullets(lines),
            _table(phenomenon),
        ]
    return Document(parts=parts, rows=[asdict(tradeoff) | {"statements": statements}])


def phenomenon_statements(phenomenon: Phenomenon, tradeoff: Tradeoff) -> Iterator[str]:
    """Yield what the numbers of a phenomenon say: the cheapest sufficient setting, steps, and errors of the model."""
    if phenomenon.unit == "scatter":
        yield _reality(phenomenon, tradeoff)
    known = [
        family for family in phenomenon.families if family.sufficient_step_s is not None
    ]
    if known:
        words = [
            f"{family.name} {step_text(family.sufficient_step_s)}" for family in known
        ]
        yield f"Largest step whose numerical error is below {_limit(known)}: {', '.join(words)}."
    unresolved = [
        family
        for family in phenomenon.families
        if family.converged and family.sufficient_step_s is None
    ]
    if unresolved:
        words = [
            f"{family.name} (resolved to {_number(family.resolution)})"
            for family in unresolved
        ]
        yield f"No step has a numerical error known to be below {_limit(unresolved)}: {', '.join(words)}."
    off = [family for family in phenomenon.families if _is_model_limited(family)]
    if off:
        words = [
            f"{one.name} {_number(one.model)} (numerical error known to {_number(one.resolution)})"
            for one in off
        ]
        yield (
            "A finer step does not help these, whose converged motion differs from the exact one by more than the "
            f"parametric floor or the real scatter: {', '.join(words)}."
        )


def _reality(phenomenon: Phenomenon, tradeoff: Tradeoff) -> str:
    found = phenomenon.cheapest("to_reality", SCATTER)
    if found is not None:
        family, point = found
        return (
            f"The cheapest setting within the real scatter is {family.name} with {setting_words(point)}, "
            f"at {_cost(point, tradeoff)}: {_number(point.to_reality)} of the real scatter."
        )
    best = phenomenon.best("to_reality")
    if best is None:
        return "No run of these settings has a score against reality."
    family, point = best
    text = (
        f"No setting is within the real scatter. The closest is {family.name} with {setting_words(point)}, at "
        f"{_number(point.to_reality)} times the real scatter"
    )
    if point.numerical is not None and family.resolution is not None:
        text += f"; the numerical error of this setting is {_number(max(point.numerical, family.resolution))}"
    return f"{text}."


def _is_model_limited(family: Family) -> bool:
    """Return whether the converged motion is off by more than its own resolution and than what can be seen."""
    if family.model is None or family.resolution is None:
        return False
    return family.model > 2.0 * family.resolution and family.model > _visible(family)


def _visible(family: Family) -> float:
    """Return the error that can be seen, in real scatters: the smaller of parametric floor and real scatter."""
    return SCATTER if family.floor is None else min(family.floor, SCATTER)


def _limit(families: Iterable[Family]) -> str:
    """Return what the numerical error of families is compared with."""
    limits = [_visible(family) for family in families]
    low, high = _number(min(limits)), _number(max(limits))
    if min(limits) == SCATTER:
        return "the real scatter"
    return f"the parametric floor and the real scatter, {low if low == high else f'{low} to {high}'} of the scatter"


def _heading(phenomenon: Phenomenon) -> str:
    names = ", ".join(map(short_id, phenomenon.ids))
    unit = "the real scatter" if phenomenon.unit == "scatter" else phenomenon.unit
    worst = ", of the worst experiment" if len(phenomenon.ids) > 1 else ""
    title = TITLES.get(phenomenon.metric, phenomenon.metric)
    return (
        f"{title[0].upper()}{title[1:]} of {names}; errors in units of {unit}{worst}."
    )


def _table(phenomenon: Phenomenon) -> Table:
    def usual(family: Family) -> Point | None:
        return next(
            (
                p
                for p in family.points
                if p.is_on_main_line and STEP not in p.settings_given
            ),
            None,
        )

    def enough(family: Family) -> Point | None:
        step_s = family.sufficient_step_s
        return next(
            (
                p
                for p in family.points
                if step_s and p.is_on_main_line and p.step_s == step_s
            ),
            None,
        )

    def cheapest(family: Family) -> Point | None:
        within = [
            p
            for p in family.points
            if p.to_reality is not None and p.to_reality <= SCATTER
        ]
        return min(within, key=lambda point: point.cost, default=None)

    def column(
        title: str,
        found: Callable[[Family], Point | None],
        text: Callable[[Point], str],
        *,
        is_number: bool = True,
    ) -> Column:
        def cell(family: Family) -> str:
            point = found(family)
            return "" if point is None else text(point)

        return Column("", title, cell, is_number=is_number)

    return Table(
        columns=(
            Column("name", "engine"),
            Column(
                "",
                "parametric floor",
                lambda family: _number(family.floor),
                is_number=True,
            ),
            Column(
                "", "model error", lambda family: _number(family.model), is_number=True
            ),
            Column(
                "",
                "sufficient step",
                lambda family: step_text(family.sufficient_step_s),
                is_number=True,
            ),
            column("its cost", enough, _ratio),
            column(
                "cheapest within real scatter", cheapest, setting_words, is_number=False
            ),
            column("its cost", cheapest, _ratio),
            column("default step", usual, lambda point: step_text(point.step_s)),
            column("its cost", usual, _ratio),
        ),
        rows=phenomenon.families,
    )


def setting_words(point: Point) -> str:
    """Return the effort of a setting in words, as `a step of 1/1800 s`."""
    words = [] if point.step_s is None else [f"a step of {step_text(point.step_s)}"]
    if not point.is_on_main_line:
        words += [
            f"{name}={value:g}"
            for name, value in point.effort.items()
            if name in point.settings_given
        ]
    return ", ".join(words) or "its settings"


def _cost(point: Point, tradeoff: Tradeoff) -> str:
    unit = "CPU" if tradeoff.cost == "cpu" else "wall"
    if point.cost_ratio is None:
        return f"{point.cost:.3g} s of {unit} time per simulated second"
    return f"{point.cost_ratio:.2g} times the {unit} time of {tradeoff.reference.partition(',')[0]}"


def _ratio(point: Point) -> str:
    return (
        f"{point.cost:.3g} s/s"
        if point.cost_ratio is None
        else f"{point.cost_ratio:.2g}"
    )


def _number(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.2g}" if value >= 1e-4 or value == 0.0 else "below 0.0001"


# --- figure ----------------------------------------------------------------------------------------------------------


def draw_pareto(tradeoff: Tradeoff) -> Figure:
    """Return the picture.

    Each row is a phenomenon: on the left the numerical error with the parametric floor, on the right the error against
    reality with the real scatter, or the distance to the exact motion where there are no trials.
    """
    count = len(tradeoff.phenomena)
    figure = new_figure(10.0, ROW_IN * count + 1.3)
    grid = figure.subplots(count, 2, squeeze=False, sharex="row")
    for (left, right), phenomenon in zip(grid, tradeoff.phenomena, strict=True):
        _panel(left, phenomenon, "numerical", "numerical error")
        if phenomenon.best("to_reality") is not None:
            _panel(right, phenomenon, "to_reality", "error against reality")
        else:
            _panel(
                right, phenomenon, "to_closed_form", "error against the exact motion"
            )
        left.set_title(phenomenon.name, loc="left", fontsize=11, fontweight="bold")
    unit = "CPU" if tradeoff.cost == "cpu" else "wall"
    for axis in grid[-1]:
        axis.set_xlabel(f"{unit} seconds per simulated second", fontsize=9)
    handles = list(_legend(tradeoff))
    figure.legend(
        handles=handles, loc="outside upper left", ncols=5, frameon=False, fontsize=9
    )
    figure.supxlabel(
        "Each line is one engine with one preset, from its coarsest step (left) to its finest (right). "
        "Crosses: other iterations.\nThe converged motion itself, with numerical error 0, is not drawn. "
        "Errors below 0.0001 are drawn there.",
        x=0.01,
        ha="left",
        fontsize=8.5,
        color="#505050",
    )
    return figure


def _panel(axis: Axes, phenomenon: Phenomenon, error: str, title: str) -> None:
    """Draw one error of all families over their cost, the real scatter, and the parametric floor."""
    tidy_axis(axis)
    axis.set_xscale("log")
    axis.set_yscale("log")
    for family in phenomenon.families:
        style = _style(family)
        line = [
            p
            for p in family.points
            if p.is_on_main_line and _value(p, error) is not None
        ]
        line.sort(key=lambda point: -(point.step_s or 0.0))
        if line:
            axis.plot(
                [p.cost for p in line],
                [_value(p, error) or math.nan for p in line],
                **style,
            )
            if error == "numerical" and family.is_default and style["color"] == GREY:
                # The name of an engine without a colour of its own stands at the end of its line.
                end = (line[-1].cost, _value(line[-1], error) or MIN_SHOWN)
                place: dict[str, Any] = {
                    "xytext": (5, 0),
                    "textcoords": "offset points",
                    "va": "center",
                }
                axis.annotate(
                    family.backend,
                    end,
                    fontsize=7.5,
                    color=style["color"],
                    annotation_clip=False,
                    **place,
                )
        others = [
            p
            for p in family.points
            if not p.is_on_main_line and _value(p, error) is not None
        ]
        if others:
            cross: dict[str, Any] = {
                "marker": "x",
                "ms": 6,
                "mew": 1.6,
                "ls": "",
                "color": style["color"],
            }
            axis.plot(
                [p.cost for p in others],
                [_value(p, error) or math.nan for p in others],
                **cross,
            )
    unit = "real scatter" if phenomenon.unit == "scatter" else phenomenon.unit
    axis.set_ylabel(f"{title}\n[{unit}]", fontsize=8.5)
    axis.tick_params(labelsize=8)
    axis.margins(x=0.12)
    floors = [
        family.floor
        for family in phenomenon.families
        if family.floor is not None and family.floor > MIN_SHOWN
    ]
    if phenomenon.unit == "scatter":
        axis.axhline(1.0, color=REAL, lw=1.0, ls="-", zorder=1)
    if floors:
        axis.axhspan(
            min(floors) * 0.97,
            max(floors) * 1.03,
            color="#9a9a9a",
            alpha=0.55,
            lw=0.0,
            zorder=1,
        )
    set_ticks(axis)


def _value(point: Point, error: str) -> float | None:
    """Return an error that a logarithmic axis can show; None for the converged motion's own numerical error."""
    value = getattr(point, error)
    if value is None or (error == "numerical" and point.is_reference):
        return None
    return max(float(value), MIN_SHOWN)


def _style(family: Family) -> dict[str, Any]:
    engine = backend_class(family.backend)
    shared = {
        "color": engine.color or GREY,
        "marker": engine.marker,
        "ms": 5,
        "lw": 1.3,
    }
    return (
        shared
        if family.is_default
        else shared | {"ls": (0, (4, 2)), "mfc": "white", "lw": 1.0, "ms": 4.5}
    )


def _legend(tradeoff: Tradeoff) -> Sequence[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    every = [
        family for phenomenon in tradeoff.phenomena for family in phenomenon.families
    ]
    named = {
        family.name: family
        for family in sorted(every, key=lambda one: (one.backend, not one.is_default))
    }
    lines: list[Any] = [
        Line2D([], [], label=name, **_style(family)) for name, family in named.items()
    ]
    lines.append(Line2D([], [], color=REAL, lw=1.0, label="scatter of real trials"))
    return [*lines, Patch(facecolor="#9a9a9a", alpha=0.55, label="parametric floor")]
