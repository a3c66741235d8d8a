"""Write what error over cost teaches into the note of this study, with every number taken from `scoring/pareto.json`.

    python studies/accuracy_and_cost/lessons.py            writes the note
    python studies/accuracy_and_cost/lessons.py --check    fails if the note is not current

A lesson that does not follow from the data any more is an error.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from textwrap import fill

import numpy as np
from pydantic import TypeAdapter

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))

from scripts.generated import settle
from scripts.pareto_model import Family, Phenomenon, Point, Tradeoff

DATA = Path(__file__).parents[2] / "scoring" / "pareto.json"
NOTE = Path(__file__).with_name("README.md")
BEGIN, END = "<!-- lessons, written by lessons.py -->", "<!-- end of lessons -->"

INTERVAL_S = 1 / 180

WIDTH = 120
"""Characters in a line of the page."""


class LessonError(AssertionError):
    """A lesson does not follow from the data."""


def lessons(found: Tradeoff) -> str:
    """Return the lessons as a Markdown list.

    Raises:
        LessonError: One does not follow from the data any more.
    """
    phenomena = {one.name: one for one in found.phenomena}
    texts = (
        _slide(phenomena["SlopeSlider-2"]),
        _finer(phenomena),
        _step_decides_nothing(phenomena),
    )
    return "".join(
        f"{fill(text, WIDTH, subsequent_indent='  ', break_on_hyphens=False)}\n"
        for text in texts
    )


def _check(holds: bool, claim: str) -> None:
    if not holds:
        raise LessonError(f"this does not follow from the data: {claim}")


def _family(phenomenon: Phenomenon, name: str) -> Family:
    return next(family for family in phenomenon.families if family.name == name)


def _line(families: Iterable[Family]) -> list[Point]:
    """Return the points whose step alone differs, and that did not diverge."""
    return [
        point
        for family in families
        for point in family.points
        if point.is_on_main_line and not point.diverged
    ]


def _at(family: Family, step_s: float) -> Point:
    return next(
        point for point in _line([family]) if np.isclose(point.step_s or 0.0, step_s)
    )


def _known(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _range(values: Iterable[float | None], digits: int = 2) -> str:
    """Return the least and the largest value with so many significant digits, or one if they are equal."""
    known = _known(values)
    low, high = (f"{value:.{digits}g}" for value in (min(known), max(known)))
    return low if low == high else f"{low} to {high}"


def _slide(slide: Phenomenon) -> str:
    coarse = [(family, _at(family, INTERVAL_S)) for family in slide.families]
    errors = _known(point.numerical for _, point in coarse)
    floors = _known(family.floor for family in slide.families)
    _check(
        len(errors) == len(coarse) and max(errors) < min(floors),
        "a slide needs no finer step than 1/180 s",
    )
    real = _known(point.to_reality for point in _line(slide.families))
    _check(min(real) > 1.0, "no step brings a slide as near as a trial")
    mujoco = _family(slide, "mujoco")
    before, after = (
        _at(mujoco, INTERVAL_S),
        next(p for p in _line([mujoco]) if "timestep_s" not in p.settings_given),
    )
    return (
        "- **A slide needs no finer step than 1/180 s, on any engine here.** There the numerical error is "
        f"{_range(errors)} of the real scatter, below the floor of {_range(floors)} that the uncertain friction, start "
        f"and tilt set. The error against reality is {_range(real)} times that of a trial at every step of "
        f"every engine. MuJoCo's default step of 1/{1 / (after.step_s or 1.0):.0f} s lowers the numerical error from "
        f"{before.numerical:.2g} to "
        f"{after.numerical:.1g} for {after.cost / before.cost:.2g} times the time. The uncertain constants hide this "
        "difference."
    )


def _finer(phenomena: dict[str, Phenomenon]) -> str:
    carried, turned, drop = (
        phenomena["Turntable-1"],
        phenomena["Turntable-3"],
        phenomena["BouncingBall"],
    )
    parts = []
    for name in ("mujoco", "newton"):
        family = _family(carried, name)
        best = min(_line([family]), key=lambda point: point.to_closed_form or 0.0)
        end = family.converged
        _check(
            end is not None
            and (best.step_s or 0.0) > (end.step_s or 0.0)
            and not best.is_reference,
            f"{name} is closest to the exact motion at a coarser step",
        )
        parts.append((best, family.model))
    physx = sorted(
        _line([_family(carried, "physx")]), key=lambda point: -(point.step_s or 0.0)
    )
    close = [point for point in physx if (point.to_closed_form or 0.0) < 1e-4]
    _check(
        bool(close) and close[-1] is not physx[-1],
        "PhysX moves away at the finest step",
    )
    boxes = [_family(turned, f"{name} out_of_box") for name in ("mujoco", "newton")]
    ends = [
        sorted(_line([box]), key=lambda point: -(point.step_s or 0.0)) for box in boxes
    ]
    _check(
        all(
            (line[0].to_reality or 0.0) < (line[-1].to_reality or 0.0) for line in ends
        ),
        "Turntable-3 grows worse",
    )
    drops = [_family(drop, f"{name} out_of_box") for name in ("mujoco", "newton")]
    (mujoco, mujoco_end), (newton, newton_end) = parts
    return (
        "- **A finer step can be worse, and a converged motion can be wrong.** On the turntable that carries a cube, "
        f"MuJoCo is closest to the exact motion at {_step(mujoco)} ({mujoco.to_closed_form:.2g}) and converges to "
        f"{mujoco_end:.2g}; Newton is closest at {_step(newton)} ({newton.to_closed_form:.2g}) and converges to "
        f"{newton_end:.2g}. PhysX is within 0.0001 from {_step(close[0])} to {_step(close[-1])} and at "
        f"{physx[-1].to_closed_form:.2g} at {_step(physx[-1])}. With the documented defaults of MuJoCo and Newton, "
        "`out_of_box`, the error against reality of Turntable-3 increases from "
        f"{_range(line[0].to_reality for line in ends)} to {_range(line[-1].to_reality for line in ends)} between "
        f"{_step(ends[0][0])} and {_step(ends[0][-1])}: the error of the coarse step cancels a part of the model "
        f"error. Their ball drop is resolved to {_range(one.resolution for one in drops)}, and is "
        f"{_range(one.model for one in drops)} from the exact rebound."
    )


def _step_decides_nothing(phenomena: dict[str, Phenomenon]) -> str:
    cradle, drop, recorded = (
        phenomena[name]
        for name in ("NewtonsCradle", "BouncingBall", "BouncingBall, recorded")
    )
    steady = [_family(cradle, name) for name in ("mujoco", "physx", "newton")]
    others = [
        point for family in steady for point in family.points if not point.diverged
    ]
    _check(
        min(_known(point.to_reality for point in others)) > 20.0,
        "the cradle is far off at every step",
    )
    rapier = sorted(
        _line([_family(cradle, "rapier")]), key=lambda point: -(point.step_s or 0.0)
    )
    default = [family for family in drop.families if family.is_default]
    drops = _known(point.to_reality for point in _line(default))
    _check(min(drops) > 1.0, "no step brings the ball drop within the scatter")
    finest = [
        min(_line([family]), key=lambda point: point.step_s or 0.0)
        for family in recorded.families
    ]
    mended = _known(point.to_reality for point in finest)
    _check(max(mended) < 1.0, "recorded heights mend the ball drop")
    return (
        "- **No step brings the cradle near reality.** In the cradle, MuJoCo, PhysX and "
        f"Newton are {_range(point.to_reality for point in others)} real scatters from the real momentum transfer, and "
        f"Drake is {_range(point.to_reality for point in _line([_family(cradle, 'drake')]))}, with every step and "
        "number of iterations at which they did not diverge. The error of Rapier increases from "
        f"{rapier[0].to_reality:.2g} to {rapier[-1].to_reality:.2g} between {_step(rapier[0])} and {_step(rapier[-1])}"
        ", and these steps do not resolve a limit. The error of the ball drop is "
        f"{_range(drops)} at every step of the default presets, and {max(mended):.2g} or less at the finest step "
        "with the recorded restitution and heights (parameters "
        "`recorded`)."
    )


def _step(point: Point) -> str:
    return f"1/{1.0 / (point.step_s or 1.0):.0f} s"


def main(arguments: Sequence[str] | None = None) -> int:
    """Write or check the note; return the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--check",
        action="store_true",
        help="write nothing; fail if the note is not current",
    )
    options = parser.parse_args(arguments)
    values = json.loads(DATA.read_text(encoding="utf-8"))
    found = TypeAdapter(Tradeoff).validate_python(values["tradeoff"])
    note = NOTE.read_text(encoding="utf-8")
    before, _, rest = note.partition(BEGIN)
    _, _, after = rest.partition(END)
    text = f"{before}{BEGIN}\n{lessons(found)}{END}{after}"
    return settle(
        {NOTE: text}, "../studies/accuracy_and_cost/lessons.py", check=options.check
    )


if __name__ == "__main__":
    sys.exit(main())
