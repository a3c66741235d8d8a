"""The figure of error over cost shows every engine, its limits, and hostile names as text."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from pydantic import TypeAdapter

pytest.importorskip("matplotlib")

import build_pareto

from gauge_envs.analysis.pareto import Family, Phenomenon, Point, Tradeoff
from gauge_envs.report.figures.pareto import draw_pareto, save_pareto


def family(backend: str, *, preset: str = "default", floor: float | None = 0.3) -> Family:
    points = [
        Point(
            effort={"timestep_s": step_s},
            settings_given={},
            step_s=step_s,
            cost=1e-4 / step_s,
            cost_most=1e-4 / step_s,
            cost_ratio=None,
            repeats=1,
            diverged=False,
            numerical=100.0 * step_s,
            to_reality=0.5,
            is_reference=step_s == 1e-4,
        )
        for step_s in (1e-2, 1e-3, 1e-4)
    ]
    return Family(
        backend=backend,
        preset=preset,
        is_default=preset == "default",
        given={},
        versions={},
        points=tuple(points),
        resolution=0.1,
        model=None,
        floor=floor,
        floor_source="",
        sufficient_step_s=1e-3,
    )


def made(*families: Family, unit: str = "scatter") -> Tradeoff:
    slide = Phenomenon(
        name="Slide $x$", ids=("GAUGE/Slide-wood",), metric="rmse", unit=unit, scatter={}, families=families
    )
    return Tradeoff(cost="cpu", reference="mujoco", phenomena=(slide,), versions={}, notes=())


def test_the_legend_names_every_family_and_limit() -> None:
    figure = draw_pareto(made(family("mujoco"), family("mujoco", preset="out_of_box"), family("my_engine")))
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == ["mujoco", "mujoco out_of_box", "my_engine", "scatter of real trials", "parametric floor"]


def test_the_converged_motion_has_no_point_of_numerical_error() -> None:
    left = draw_pareto(made(family("mujoco"))).axes[0]
    line = max(left.get_lines(), key=lambda one: len(one.get_xdata()))
    assert list(line.get_xdata()) == pytest.approx([1e-2, 1e-1])


def test_a_picture_is_written(tmp_path: Path) -> None:
    assert save_pareto(made(family("mujoco", floor=None), unit="mm"), tmp_path / "pareto.png").stat().st_size > 10_000


def test_the_page_is_that_of_its_data_and_its_lessons_hold() -> None:
    assert build_pareto.main(["--check"]) == 0
    values = json.loads(build_pareto.DATA.read_text(encoding="utf-8"))
    found = TypeAdapter(Tradeoff).validate_python(values["tradeoff"])
    phenomena = {one.name: one for one in found.phenomena}
    coarse = [
        (point.numerical, family.floor)
        for family in phenomena["SlopeSlider-2"].families
        for point in family.points
        if point.is_on_main_line and point.step_s == pytest.approx(1 / 180)
    ]
    assert len(coarse) >= 10
    assert all(error is not None and floor is not None and error <= 0.22 < 0.37 < floor for error, floor in coarse)
    carried = {family.name: family for family in phenomena["Turntable-1"].families}
    errors = {point.step_s: point.to_closed_form for point in carried["mujoco"].points}
    assert min(error for error in errors.values() if error is not None) == pytest.approx(0.035, abs=5e-4)
    assert carried["mujoco"].model == pytest.approx(0.054, abs=5e-4)
    drop = {family.name: family for family in phenomena["BouncingBall"].families}["mujoco out_of_box"]
    assert drop.model == pytest.approx(14.2, abs=0.1)
    assert drop.resolution == pytest.approx(0.033, abs=1e-3)
