"""The figure of error over cost shows every engine, its limits, and hostile names as text."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("matplotlib")

from gauge_envs.pages.figures import save_png
from scripts.build_pareto_figure import draw_pareto
from scripts.pareto_model import Family, Phenomenon, Point, Tradeoff


def family(
    backend: str, *, preset: str = "default", floor: float | None = 0.3
) -> Family:
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
        name="Slide $x$",
        ids=("GAUGE/Slide-wood",),
        metric="rmse",
        unit=unit,
        scatter={},
        families=families,
    )
    return Tradeoff(
        cost="cpu", reference="mujoco", phenomena=(slide,), versions={}, notes=()
    )


def test_the_legend_names_every_family_and_limit() -> None:
    figure = draw_pareto(
        made(
            family("mujoco"), family("mujoco", preset="out_of_box"), family("my_engine")
        )
    )
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert names == [
        "mujoco",
        "mujoco out_of_box",
        "my_engine",
        "scatter of real trials",
        "parametric floor",
    ]


def test_the_converged_motion_has_no_point_of_numerical_error() -> None:
    left = draw_pareto(made(family("mujoco"))).axes[0]
    line = max(left.get_lines(), key=lambda one: len(one.get_xdata()))
    assert list(line.get_xdata()) == pytest.approx([1e-2, 1e-1])


def test_a_picture_is_written(tmp_path: Path) -> None:
    assert (
        save_png(
            draw_pareto(made(family("mujoco", floor=None), unit="mm")),
            tmp_path / "pareto.png",
        )
        .stat()
        .st_size
        > 10_000
    )
