"""Write the tables of `docs/engines/conformance.md`: the checks that an engine fails, from `scoring/conformance.json`.

A second table has the contacts and calls that the scenes of the checks load.

    gauge backend check '*:default' '*:out_of_box' --out engines.json
    python -m scripts conformance engines.json genesis.json
    python -m scripts build conformance

Engines that need environments of their own have files of their own, which the second command joins.
"""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from gauge_envs.backends import backend
from gauge_envs.fixtures.recording import Recording
from gauge_envs.rendering.camera import scene_view
from gauge_envs.rendering.renderer import SceneRenderer
from gauge_envs.scene.geometry import vector
from gauge_envs.tools.conformance import Lab, Status, checks
from gauge_envs.tools.conformance.model import CheckResult
from gauge_envs.tools.conformance.report import comparison
from gauge_envs.tools.conformance.results import (
    EngineColumn,
    read_columns,
    write_columns,
)
from gauge_envs.tools.conformance.run import run_check
from scripts import check_coverage
from scripts.generated import ROOT, SCORING, markdown_table, page_part, with_part

PAGE = ROOT / "docs" / "engines" / "conformance.md"
RESULTS = SCORING / "conformance.json"
PICTURE = ROOT / "docs" / "images" / "engines.webp"
PRESETS = {"default": ("#0072B2", "o"), "out_of_box": ("#D55E00", "x")}
RATIOS = (1e-3, 1e3)
"""Smallest and largest error over tolerance of the picture."""
SCRIPT = f"scripts/{Path(__file__).name}"

USES = {
    "sliding and pushing": ("pucks-friction", "slide", "slide-crowd", "push-*"),
    "grasping": ("grasp", "push-holds", "slide-between", "rest-small"),
    "floors of tiles": ("seam-*",),
    "towers and piles": ("tower-stands", "mass-ratio", "wall", "rest-*"),
    "thrown and spinning bodies": ("spin-*", "tumble-long", "spinning-top"),
    "impacts": ("rebound-*", "bounce-row", "volley", "oblique-*", "strike-aside"),
    "fast bodies": ("thin-wall", "crossed-edges", "drop-energy"),
    "cloth": ("cloth-*",),
    "foam": ("foam-*",),
    "ropes": ("rope-*", "rod-*"),
}
"""Patterns of the checks that a use needs."""

SHOWN = {
    "sliding and pushing": (
        "push-slides",
        "cube at 1.01 of the limit under 3 weights",
        1.6,
    ),
    "grasping": ("grasp", "object", 0.4),
    "floors of tiles": ("seam-slide", "six tiles at 1.5 m/s", 1.2),
    "towers and piles": ("wall", "box 20 of 0.3 kg", 0.5),
    "thrown and spinning bodies": ("spinning-top", "top", 0.35),
    "impacts": ("strike-aside", "bar 130 mm off the middle, e = 0.5", 0.8),
    "fast bodies": ("drop-energy", "off its centre on a post", 1.6),
    "cloth": ("cloth-rests-on", "sheet 1", 0.6),
    "foam": ("foam-rests-on", "foam block 0", 0.4),
    "ropes": ("rope-length", "rope", 0.5),
}
"""Check that shows a use, body in the centre of its picture at the end, and distance of the camera [m]."""


def join(files: Sequence[Path]) -> None:
    """Write the results of files of `gauge backend check --out` to `scoring/conformance.json`."""
    write_columns([column for file in files for column in read_columns(file)], RESULTS)


def contents() -> dict[Path, str]:
    """Return the pages with their generated parts replaced."""
    columns = read_columns(RESULTS)
    pairs = {pair for column in columns for pair in column.versions.items()}
    versions = ", ".join(f"{name} {text}" for name, text in sorted(pairs))
    days = ", ".join(sorted({column.made for column in columns}))
    table = comparison([column for column in columns if column.name == "default"])
    head = [column.title for column in table.columns]
    lines = [f"Run on {days} with {versions}.", "", *markdown_table(head, table.rows)]
    pages = page_part(PAGE, "matrix", SCRIPT, "\n".join(lines))
    chosen = [column for column in columns if column.name == "default"]
    uses = [
        [_shown(use), *(_verdict(use, column) for column in chosen)] for use in USES
    ]
    head = ["use", *(column.title for column in chosen)]
    part = "\n".join(markdown_table(head, uses))
    pages[PAGE] = with_part(pages[PAGE], "uses", SCRIPT, part)
    pages[PAGE] = with_part(pages[PAGE], "coverage", SCRIPT, check_coverage.tables())
    return pages


def _shown(use: str) -> str:
    """Return a use with its picture."""
    return f"![{SHOWN[use][0]}](../images/uses/{use.replace(' ', '_')}.webp) {use}"


class _Recorder(Lab):
    """A lab of MuJoCo that keeps its recordings."""

    def __init__(self) -> None:
        super().__init__(backend("mujoco"))
        self.recordings: list[Recording] = []

    def rollout(self, *scene: Any, **changes: Any) -> Recording:
        self.recordings.append(super().rollout(*scene, **changes))
        return self.recordings[-1]


def draw_uses() -> None:
    """Draw the end of the scene that shows each use, in MuJoCo."""
    for use, (check, name, distance_m) in SHOWN.items():
        lab = _Recorder()
        run_check(lab, checks([check])[0])
        held = [r for r in lab.recordings if name in r.states or name in r.nodes_m]
        picture = Image.fromarray(_picture(held[-1], name, distance_m))
        file = PICTURE.parent / "uses" / f"{use.replace(' ', '_')}.webp"
        file.parent.mkdir(exist_ok=True)
        picture.save(file, quality=60)


def _picture(end: Recording, name: str, distance_m: float) -> NDArray[np.uint8]:
    """Return a picture of the last sample around a body, shape [90, 120, 3]."""
    poses = {body: states[-1, :7] for body, states in end.states.items()}
    nodes_m = {body: nodes[-1] for body, nodes in end.nodes_m.items()}
    target = nodes_m[name].mean(axis=0) if name in nodes_m else poses[name][:3]
    view = scene_view(end.scene).model_copy(
        update={"target_m": vector(target), "distance_m": distance_m}
    )
    rest_m = {body: nodes[0] for body, nodes in end.nodes_m.items()}
    renderer = SceneRenderer(end.scene, rest_m, 120, 90, view=view, materials={})
    with closing(renderer):
        return renderer.picture(poses, nodes_m)


def _verdict(use: str, column: EngineColumn) -> str:
    """Return whether all checks of a use pass, or those that fail; with the count of those without a result."""
    needed = [check.id for pattern in USES[use] for check in checks([pattern])]
    results = [column.results.get(name) for name in dict.fromkeys(needed)]
    ran = [result for result in results if result is not None]
    failed = [result.check for result in ran if result.is_bad]
    passed = [result for result in ran if result.status is Status.PASS]
    if failed or not passed:
        return f"✗ {', '.join(failed)}" if failed else "-"
    left = len(needed) - len(passed)
    return f"✓, without {left} of {len(needed)}" if left else "✓"


def draw() -> None:
    """Draw the error over the tolerance of the worst check of each use, for each engine and its main presets."""
    columns = read_columns(RESULTS)
    engines = list(dict.fromkeys(column.backend for column in columns))
    figure = Figure(figsize=(11.0, 5.6), layout="constrained")
    grid = figure.subplots(2, 5, sharex=True, sharey=True)
    for axes, use in zip(grid.flat, USES, strict=True):
        for column in columns:
            _draw_worst(axes, use, column, engines.index(column.backend))
        axes.axvspan(1.0, 2.0 * RATIOS[1], color="#FFF1E6", zorder=0)
        axes.axvline(1.0, color="black", linewidth=1.0)
        axes.set(xscale="log", xlim=(0.5 * RATIOS[0], 2.0 * RATIOS[1]), title=use)
        axes.title.set_fontsize(10)
    grid[0, 0].set_yticks(range(len(engines)), engines)
    grid[0, 0].invert_yaxis()
    figure.supxlabel(
        "error over tolerance of the worst check; right of the line: failed",
        fontsize=10,
    )
    figure.suptitle(
        "Dots: settings of this package. Crosses: the engine's own defaults.",
        fontsize=11,
    )
    figure.savefig(PICTURE, dpi=90)
    draw_uses()


def _draw_worst(axes: Axes, use: str, column: EngineColumn, row: int) -> None:
    """Draw the worst check that ran, within the limits of the picture; an error is the largest one."""
    needed = {check.id for pattern in USES[use] for check in checks([pattern])}
    ran = [column.results[name] for name in needed & column.results.keys()]
    ratios = [_ratio(r) for r in ran if r.is_bad or r.status is Status.PASS]
    colour, marker = PRESETS[column.name]
    if ratios:
        axes.plot(np.clip(max(ratios), *RATIOS), row, marker, color=colour)


def _ratio(result: CheckResult) -> float:
    """Return the error over the tolerance; a limit of the picture where a check has no number or no tolerance."""
    measured, expected = result.measured, result.expected
    if not result.width or measured is None or expected is None or np.isnan(measured):
        return RATIOS[result.is_bad]
    return abs(measured - expected) / result.width
