"""Error over cost in words, and as a table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict

from gauge_envs.pages.document import Bullets, Document, Heading, Paragraph, Part
from gauge_envs.pages.table import Column, Table
from gauge_envs.pages.text import short_id
from gauge_envs.tools.cost.model import STEP, Family, Phenomenon, Point, Tradeoff

SCATTER = 1.0
"""Error that equals the real scatter, in units of it."""

TITLES = {"rmse": "RMSE over frames", "pd": "period", "mte": "momentum transfer", "lsd": "longest rest"}


def pareto_document(tradeoff: Tradeoff) -> Document:
    """Return for each phenomenon its statements, and a table with a row per engine and preset.

    The JSON row has all numbers, and the statements with the names of their phenomena.
    """
    parts: list[Part] = []
    statements = []
    for phenomenon in tradeoff.phenomena:
        lines = list(phenomenon_statements(phenomenon, tradeoff))
        statements += [f"{phenomenon.name}: {line}" for line in lines]
        parts += [Heading(phenomenon.name, 3), Paragraph(_heading(phenomenon)), Bullets(lines), _table(phenomenon)]
    return Document(parts=parts, rows=[asdict(tradeoff) | {"statements": statements}])


def phenomenon_statements(phenomenon: Phenomenon, tradeoff: Tradeoff) -> Iterator[str]:
    """Yield what the numbers of a phenomenon say: the cheapest sufficient setting, steps, and errors of the model."""
    if phenomenon.unit == "scatter":
        yield _reality(phenomenon, tradeoff)
    known = [family for family in phenomenon.families if family.sufficient_step_s is not None]
    if known:
        words = [f"{family.name} {step_words(family.sufficient_step_s)}" for family in known]
        yield f"Largest step whose numerical error is below {_limit(known)}: {', '.join(words)}."
    unresolved = [family for family in phenomenon.families if family.converged and family.sufficient_step_s is None]
    if unresolved:
        words = [f"{family.name} (resolved to {_number(family.resolution)})" for family in unresolved]
        yield f"No step has a numerical error known to be below {_limit(unresolved)}: {', '.join(words)}."
    off = [family for family in phenomenon.families if _is_model_limited(family)]
    if off:
        words = [f"{one.name} {_number(one.model)} (numerical error known to {_number(one.resolution)})" for one in off]
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
    visible = SCATTER if family.floor is None else family.floor
    return family.model > 2.0 * family.resolution and family.model > visible


def _limit(families: Iterable[Family]) -> str:
    """Return what the numerical error of families is compared with."""
    floors = [family.floor for family in families]
    if all(floor is None for floor in floors):
        return "the real scatter"
    known = [floor for floor in floors if floor is not None]
    low, high = _number(min(known)), _number(max(known))
    return f"the parametric floor, {low if low == high else f'{low} to {high}'} of the real scatter"


def _heading(phenomenon: Phenomenon) -> str:
    names = ", ".join(map(short_id, phenomenon.ids))
    unit = "the real scatter" if phenomenon.unit == "scatter" else phenomenon.unit
    worst = ", of the worst experiment" if len(phenomenon.ids) > 1 else ""
    title = TITLES.get(phenomenon.metric, phenomenon.metric)
    return f"{title[0].upper()}{title[1:]} of {names}; errors in units of {unit}{worst}."


def _table(phenomenon: Phenomenon) -> Table:
    def usual(family: Family) -> Point | None:
        return next((p for p in family.points if p.is_on_main_line and STEP not in p.settings_given), None)

    def enough(family: Family) -> Point | None:
        step_s = family.sufficient_step_s
        return next((p for p in family.points if step_s and p.is_on_main_line and p.step_s == step_s), None)

    def cheapest(family: Family) -> Point | None:
        within = [p for p in family.points if p.to_reality is not None and p.to_reality <= SCATTER]
        return min(within, key=lambda point: point.cost, default=None)

    def column(
        title: str, found: Callable[[Family], Point | None], text: Callable[[Point], str], *, is_number: bool = True
    ) -> Column:
        def cell(family: Family) -> str:
            point = found(family)
            return "" if point is None else text(point)

        return Column("", title, cell, is_number=is_number)

    return Table(
        columns=(
            Column("name", "engine"),
            Column("", "parametric floor", lambda family: _number(family.floor), is_number=True),
            Column("", "model error", lambda family: _number(family.model), is_number=True),
            Column("", "sufficient step", lambda family: step_words(family.sufficient_step_s), is_number=True),
            column("its cost", enough, _ratio),
            column("cheapest within real scatter", cheapest, setting_words, is_number=False),
            column("its cost", cheapest, _ratio),
            column("default step", usual, lambda point: step_words(point.step_s)),
            column("its cost", usual, _ratio),
        ),
        rows=phenomenon.families,
    )


def setting_words(point: Point) -> str:
    """Return the effort of a setting in words, as `a step of 1/1800 s`."""
    words = [] if point.step_s is None else [f"a step of {step_words(point.step_s)}"]
    if not point.is_on_main_line:
        words += [f"{name}={value:g}" for name, value in point.effort.items() if name in point.settings_given]
    return ", ".join(words) or "its settings"


def step_words(step_s: float | None) -> str:
    """Return a step as a fraction of a second; empty for None."""
    return "" if step_s is None else f"1/{1.0 / step_s:.6g} s"


def _cost(point: Point, tradeoff: Tradeoff) -> str:
    unit = "CPU" if tradeoff.cost == "cpu" else "wall"
    if point.cost_ratio is None:
        return f"{point.cost:.3g} s of {unit} time per simulated second"
    return f"{point.cost_ratio:.2g} times the {unit} time of {tradeoff.reference.partition(',')[0]}"


def _ratio(point: Point) -> str:
    return f"{point.cost:.3g} s/s" if point.cost_ratio is None else f"{point.cost_ratio:.2g}"


def _number(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.2g}" if value >= 1e-4 or value == 0.0 else "below 0.0001"
