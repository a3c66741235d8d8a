"""Write a site: all pages into a new folder, which then takes the place of the old one.

A replay is data of a page: shapes, quantized poses and nodes, and the real trajectory as a ghost. Positions are whole
numbers of 16 bits between the ends of their range, orientations the components of the quaternion times 32767.
"""

import json
import shutil
from base64 import b64encode
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from secrets import token_hex
from string import Template
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gauge_envs.errors import GaugeError, ResultFileError
from gauge_envs.evaluation.reference import reference_band
from gauge_envs.evaluation.reference_path import reference_path, reference_words
from gauge_envs.experiments.experiment import Experiment
from gauge_envs.files import os_errors
from gauge_envs.observables.kinds import Observable
from gauge_envs.pages.document import Heading, Part, save_file
from gauge_envs.pages.html import (
    Html,
    element,
    folded,
    join,
    listed,
    script_value,
    slug,
    stylesheet,
)
from gauge_envs.pages.results import discretization_text
from gauge_envs.pages.table import Table, grid
from gauge_envs.pages.text import COST_TITLE, QUESTIONS, shortened
from gauge_envs.references.bands import Band
from gauge_envs.references.convergence import convergence_rows
from gauge_envs.references.grades import BandGrade
from gauge_envs.rendering.camera import FIELD_OF_VIEW_DEG, experiment_view
from gauge_envs.rendering.materials import STRING_RADIUS_M, USUAL
from gauge_envs.rendering.skin import Skin
from gauge_envs.runs.replay import (
    Replay,
    ReplayError,
    load_or_replay,
    replayed_experiment,
)
from gauge_envs.runs.result import Result
from gauge_envs.scene import (
    Box,
    Capsule,
    Cloth,
    Compound,
    ConvexUnion,
    Cylinder,
    Ellipsoid,
    Motion,
    Plane,
    Rod,
    Rope,
    SoftBody,
    Sphere,
)
from gauge_envs.scene.geometry import Pose, Shape
from gauge_envs.scene.meshes import hull_triangles
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.compare import ExperimentComparison, compare, mean_rank_text
from gauge_envs.tools.site.experiment_page import experiment_page
from gauge_envs.tools.site.model import (
    Site,
    cell_cost,
    first_result,
    first_results,
    score_cell,
    section,
    site_page,
)
from gauge_envs.tools.site.overview import overview_page
from gauge_envs.tools.site.reproduce import reproduce_page

MARK = "gauge-report-site.txt"
"""File that marks a folder as a site, which a later one may replace."""

MARK_TEXT = "A site of `gauge report`. The next one with this folder replaces everything in it.\n"

ASSETS = files("gauge_envs.tools.site") / "assets"

SCRIPTS = ("replay.js", "three.min.js", "three.LICENSE.txt")

HELP = (
    "Drag to turn, click and scroll to zoom. Keys in the picture: Space, left and right, Home, End, A, D. Poses of the "
    "run, which was repeated and has the same g(t) as its result, bit for bit."
)


@dataclass(frozen=True, kw_only=True)
class ReplayNote:
    """Why a configuration has no replay in an experiment.

    Attributes:
        id: Gymnasium id of the experiment.
        label: Label of the configuration.
        reason: The reason.
    """

    id: str
    label: str
    reason: str


def save_site(
    results: Mapping[Path, Result],
    out: Path,
    *,
    replays: bool = True,
    command: str = "gauge report",
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[ReplayNote, ...]:
    """Write the site of results into a folder: a page for all, one for each experiment and engine, and replays.

    The pages are written beside the folder and then take its place, so that an interruption leaves the old site.

    Args:
        results: Result files and their contents, one or more.
        out: Folder of the site. It must be new, empty, or a site.
        replays: Whether to run the episodes again for their poses; see `gauge_envs.runs.replay`.
        command: Command that makes the site, which it shows.
        progress: Receives the name of each experiment before its page is made.

    Returns:
        Why configurations have no replay; the pages say the same.

    Raises:
        ResultFileError: There is no result, the folder holds something else, or it cannot be written.
    """
    if not results:
        raise ResultFileError("there is no result to report")
    check_replaceable(out)
    part = out.with_name(f".{out.name}.{token_hex(8)}.tmp")
    try:
        notes = _write(
            results, part, replays=replays, command=command, progress=progress
        )
        _replace(part, out)
    except GaugeError:
        raise
    except OSError as error:
        raise ResultFileError(
            f"{out}: cannot be written: {error.strerror or error}"
        ) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return notes


def check_replaceable(out: Path) -> None:
    """Check that a site may take the place of a folder."""
    with os_errors(lambda cause: ResultFileError(f"{out}: cannot be read: {cause}")):
        is_taken = out.is_symlink() or (
            out.exists() and (not out.is_dir() or any(out.iterdir()))
        )
    if is_taken and (out.is_symlink() or not (out / MARK).is_file()):
        raise ResultFileError(
            f"{out}: holds something else than a site of gauge report; give another folder"
        )


def _replace(part: Path, out: Path) -> None:
    old = out.with_name(f".{out.name}.{token_hex(8)}.old")
    if out.exists():
        out.replace(old)
    try:
        part.replace(out)
    except OSError:
        with suppress(OSError):
            old.replace(out)
        raise
    shutil.rmtree(old, ignore_errors=True)


def _write(
    results: Mapping[Path, Result],
    out: Path,
    *,
    replays: bool,
    command: str,
    progress: Callable[[str], None],
) -> tuple[ReplayNote, ...]:
    comparison = compare(results.values())
    site = Site(
        comparison=comparison,
        files={id(result): file for file, result in results.items()},
    )
    for name in SCRIPTS:
        save_file(out / "assets" / name, (ASSETS / name).read_bytes())
    save_file(out / "assets" / "site.css", stylesheet())
    save_file(out / MARK, MARK_TEXT)
    notes: list[ReplayNote] = []
    for one in comparison.experiments:
        progress(one.name)
        replay, missing = _replays(site, one, out) if replays else (None, [])
        notes += missing
        texts = [
            f"{note.label} has no replay: {note.reason}. Its curves are below."
            for note in missing
        ]
        save_file(
            out / site.experiment_page(one), experiment_page(site, one, replay, texts)
        )
    for name in site.engines:
        save_file(out / site.engine_page(name), engine_page(site, name))
    save_file(out / "reproduce.html", reproduce_page(site, command))
    save_file(out / "index.html", overview_page(site))
    return tuple(notes)


# --- replays ---


def _replays(
    site: Site, one: ExperimentComparison, out: Path
) -> tuple[Html | None, list[ReplayNote]]:
    """Write the replay of each configuration in an experiment; return their element, and what has none and why."""
    entries: list[dict[str, str]] = []
    ghosts, notes = [], []
    for index, result in first_results(one).items():
        label = site.labels[index]
        try:
            data = _replay(site, index, result)
        except GaugeError as error:
            notes.append(ReplayNote(id=one.id, label=label, reason=str(error)))
            continue
        if data["ghost"] is not None:
            ghosts.append(data["ghost"])
        key = f"{slug(one.name)}.{site.slugs[index]}"
        path = Path("data") / f"{key}.js"
        save_file(
            out / path, f"gaugeReplay({script_value(key)},{script_value(data)});\n"
        )
        entries.append(
            {
                "key": key,
                "file": path.as_posix(),
                "label": label,
                "color": site.line(index)[0],
            }
        )
    return (_replay_element(entries, ghost_text(ghosts)) if entries else None), notes


def _replay(site: Site, index: int, result: Result) -> dict[str, Any]:
    file = site.files.get(id(result))
    if file is None:
        raise ReplayError("its result file is not known")
    replay = load_or_replay(result, file)
    experiment = replayed_experiment(result)
    band = reference_band(experiment, use_withheld=result.score.withheld is not None)
    return replay_data(
        experiment, replay, band, label=site.labels[index], color=site.line(index)[0]
    )


def _replay_element(entries: Sequence[Mapping[str, str]], ghost: str) -> Html:
    boxes = [
        element(
            "label",
            element("input", type="checkbox", name="engine", value=entry["key"]),
            f" {entry['label']}",
        )
        for entry in entries
    ]
    if ghost:
        box = element("input", type="checkbox", name="ghost", checked=True)
        boxes.append(element("label", box, " reference"))
    stage = Template((ASSETS / "stage.html").read_text(encoding="utf-8")).substitute(
        boxes=join(boxes)
    )
    replay = element(
        "div", Html(stage), class_="replay", data_replays=script_value(list(entries))
    )
    return join(
        [replay, element("p", HELP, f" {ghost}" if ghost else "", class_="small")]
    )


def engine_page(site: Site, name: str) -> str:
    """Return the page of an engine; `file` is the name for trajectory files."""
    parts: list[Part] = []
    for index in site.engines[name]:
        parts += [
            *_means(site, index),
            *section(QUESTIONS["validation"], _scores(site, index, is_verified=False)),
            *section(QUESTIONS["verification"], _scores(site, index, is_verified=True)),
            *_settings(site, index),
            *_reasons(site, index),
        ]
    return site_page(f"Engine: {name}", parts, here=site.engine_page(name))


def _means(site: Site, index: int) -> list[Html]:
    one, summary = (
        site.comparison.configurations[index],
        site.comparison.summaries()[index],
    )
    versions = (
        ", ".join(f"{package} {text}" for package, text in one.engine_versions.items())
        or "not stated"
    )
    counts = f"{summary.ran} experiments ran, {summary.scored} have a score, {summary.diverged} diverged, "
    counts += f"{summary.not_run} did not run."
    heading = element("h2", site.swatch(index), site.labels[index])
    ranks = [
        f"{grade.name}: {mean_rank_text(score.mean_rank)} of {len(grade.scores)}"
        for grade in site.comparison.grades
        for score in grade.scores
        if score.configuration == index
        and score.mean_rank is not None
        and len(grade.scores) > 1
    ]
    places = [element("p", f"Mean rank: {'; '.join(ranks)}.")] if ranks else []
    physics = f" Physics: {one.physics}." if one.physics else ""
    return [heading, element("p", f"Versions: {versions}.{physics} {counts}"), *places]


def _scores(site: Site, index: int, *, is_verified: bool) -> Table:
    rows = []
    for one in site.comparison.experiments:
        cell = one.cells[index]
        if cell is not None and one.is_verified is is_verified:
            result = first_result(cell)
            convergence = None
            if result is not None:
                convergence = discretization_text(
                    result, convergence_rows(result.backend, result.id)
                )
            name, score = (
                site.experiment_link(one, site.family(one)[0]),
                score_cell(one, cell, one.primary),
            )
            rows.append(
                (name, one.grade_name, score, cell_cost(cell), convergence or "-")
            )
    return grid(
        ("experiment", "grade", "score [95 %]", COST_TITLE, "discretization"), rows
    )


def _settings(site: Site, index: int) -> list[Part]:
    groups: dict[str, list[str]] = {}
    for one in site.comparison.experiments:
        result = first_result(one.cells[index])
        if result is not None:
            text = "\n".join(
                f"{key} = {json.dumps(value)}" for key, value in result.settings.items()
            )
            groups.setdefault(text, []).append(one.name)
    blocks = (
        folded(shortened(names), element("pre", element("code", text or "none stated")))
        for text, names in groups.items()
    )
    return [Heading("Settings in force", 3), *blocks] if groups else []


def _reasons(site: Site, index: int) -> list[Part]:
    reasons: dict[tuple[str, str], list[str]] = {}
    for one in site.comparison.experiments:
        cell = one.cells[index]
        for result in cell.results if cell else ():
            if reason := result.error or result.diverged_reason:
                reasons.setdefault(
                    (result.outcome.value, reason.replace(f"{one.id}: ", "")), []
                ).append(one.name)
    entries = [
        join([element("b", outcome), f": {shortened(names)}: {reason}"])
        for (outcome, reason), names in reasons.items()
    ]
    return [Heading("Did not finish", 3), listed(entries)] if entries else []


FloatArray = NDArray[np.floating[Any]]

MAX_COUNT = 32767
"""Largest stored number."""

ROUND_M = 5
"""Digits of lengths in metres that are written as text: 10 micrometres."""


def quantized(positions_m: FloatArray) -> dict[str, Any]:
    """Return positions as numbers of 16 bits, JSON-ready; a position that is not finite becomes the centre.

    Args:
        positions_m: Positions [m], shape [..., 3].

    Returns:
        The numbers as base64, the position of number 0 [m], and the length of one count along each axis [m]; a position
        is wrong by half of it at most.
    """
    points = positions_m.reshape(-1, 3).astype(np.float64)
    finite = points[np.isfinite(points).all(axis=1)]
    low, high = (
        (finite.min(axis=0), finite.max(axis=0))
        if len(finite)
        else (np.zeros(3), np.zeros(3))
    )
    centre, step = 0.5 * (low + high), np.maximum(0.5 * (high - low) / MAX_COUNT, 1e-12)
    counts = np.nan_to_num(
        np.rint((positions_m - centre) / step), posinf=0.0, neginf=0.0
    ).astype(np.int16)
    return {"data": _packed(counts), "centre": centre.tolist(), "step": step.tolist()}


def _packed(values: NDArray[Any]) -> str:
    """Return integers as base64, in the byte order of browsers."""
    return b64encode(
        np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).tobytes()
    ).decode("ascii")


# --- scene ---


def scene_data(experiment: Experiment) -> dict[str, Any]:
    """Return the still part of the scene of an experiment, JSON-ready: shapes, colours, strings and the camera."""
    scene = experiment.scene
    shapes: list[list[dict[str, Any]]] = []
    known: dict[Shape, int] = {}
    bodies = []
    for body in scene.bodies:
        if body.shape not in known:
            known[body.shape] = len(shapes)
            shapes.append(_solids(body.shape))
        bodies.append(
            {
                "name": body.name,
                "shape": known[body.shape],
                "color": _color(USUAL[body.motion].color),
                "pose": _pose(body.pose),
            }
        )
    view = experiment_view(experiment)
    return {
        "shapes": shapes,
        "bodies": bodies,
        "strings": [
            {"body": joint.body, "anchor": list(joint.anchor_m)}
            for joint in scene.joints
        ],
        "string": {"radius": STRING_RADIUS_M},
        "camera": {
            "target": [round(float(x), ROUND_M) for x in view.target_m],
            "distance": view.distance_m,
            "azimuth": view.azimuth_deg,
            "elevation": view.elevation_deg,
            "fov": FIELD_OF_VIEW_DEG,
        },
    }


def _color(rgba: Sequence[float]) -> str:
    return "#" + "".join(f"{round(255 * part):02x}" for part in rgba[:3])


def _pose(pose: Pose) -> list[float]:
    """Return position and quaternion x y z w, the order of three.js."""
    w, x, y, z = pose.quaternion
    return [*pose.position_m, x, y, z, w]


SOLIDS: Mapping[type, tuple[str, Mapping[str, str]]] = {
    Box: ("box", {"size": "size_m"}),
    Sphere: ("sphere", {"radius": "radius_m"}),
    Cylinder: ("cylinder", {"radius": "radius_m", "length": "length_m"}),
    Capsule: ("capsule", {"radius": "radius_m", "length": "length_m"}),
    Ellipsoid: ("ellipsoid", {"radii": "radii_m"}),
    Plane: ("plane", {}),
}
"""Kind of each shape, and its attributes by their names in the data."""


def _solids(shape: Shape) -> list[dict[str, Any]]:
    """Return the solids of a shape, each with its place in the body frame."""
    if isinstance(shape, Compound):
        solids = []
        for part in shape.parts:
            for solid in _solids(part.shape):  # type: ignore[arg-type]
                solids.append(solid | {"pose": _pose(part.pose)})
        return solids
    if isinstance(shape, ConvexUnion):
        triangles = (hull_triangles(np.asarray(piece)) for piece in shape.pieces_m)
        return [
            {"kind": "mesh", "triangles": np.round(one, ROUND_M + 1).ravel().tolist()}
            for one in triangles
        ]
    kind, sizes = SOLIDS[type(shape)]
    return [
        {"kind": kind}
        | {name: getattr(shape, attribute) for name, attribute in sizes.items()}
    ]


# --- motion ---


def replay_data(
    experiment: Experiment, replay: Replay, band: Band | None, *, label: str, color: str
) -> dict[str, Any]:
    """Return a replay of the experiment that ran, JSON-ready; a band of positions becomes the ghost."""
    # Quaternions are stored x y z w, the order of three.js.
    turns = (
        np.rint(MAX_COUNT * np.nan_to_num(replay.poses[..., [4, 5, 6, 3]]))
        .clip(-MAX_COUNT, MAX_COUNT)
        .astype(np.int16)
    )
    return {
        "label": label,
        "color": color,
        "rate": replay.rate_hz,
        "views": len(replay.poses),
        "scene": scene_data(experiment),
        "moving": list(replay.bodies),
        "positions": quantized(replay.poses[..., :3]),
        "turns": _packed(turns),
        "soft": [
            _soft(body, replay.nodes_m[body.name])
            for body in experiment.scene.deformables
        ],
        "markers": quantized(replay.markers_m) | {"count": replay.markers_m.shape[1]}
        if replay.markers_m.size
        else None,
        "ghost": None if band is None else _ghost(experiment, band),
    }


def _soft(
    body: Cloth | SoftBody | Rope | Rod, nodes_m: NDArray[np.float32]
) -> dict[str, Any]:
    data: dict[str, Any] = {"count": nodes_m.shape[1], "nodes": quantized(nodes_m)}
    if isinstance(body, Rope | Rod):
        return data | {
            "kind": "line",
            "radius": body.radius_m,
            "color": _color(USUAL[Motion.DYNAMIC].color),
        }
    faces = Skin(body, nodes_m[0].astype(np.float64)).faces
    return data | {
        "kind": "surface",
        "faces": _packed(faces.astype(np.uint16)),
        "color": _color(USUAL[Motion.DYNAMIC].color),
    }


def _ghost(experiment: Experiment, band: Band) -> dict[str, Any] | None:
    """Return the real positions of bodies or markers at the frames; None if the band is of other quantities."""
    path = reference_path(experiment, band)
    if path is None:
        return None
    is_body = experiment.score.observable is Observable.POSITION
    shapes = [
        experiment.scene.body(name).shape if is_body else None for name in path.names
    ]
    return {
        "grade": band.grade.value,
        "trials": band.trial_count,
        "full": path.is_full,
        "names": list(path.names),
        "radii": [
            shape.radius_m if isinstance(shape, Sphere) else None for shape in shapes
        ],
        "places": [
            np.round(row, ROUND_M).tolist() if np.isfinite(row).all() else None
            for row in path.places_m
        ],
        "measured": band.measured.tolist(),
    }


def ghost_text(ghosts: Sequence[Mapping[str, Any]]) -> str:
    """Return what the ghost of a page is, in words; an empty text without one."""
    if not ghosts:
        return ""
    ghost = ghosts[0]
    grade = BandGrade(ghost["grade"])
    what = reference_words(grade, ghost["trials"])
    what += ", no recorded motion" if not grade.is_real else ""
    kept = (
        ""
        if ghost["full"]
        else " Directions that were not measured keep the start of the simulation."
    )
    last = max(
        (frame for frame, place in enumerate(ghost["places"]) if place is not None),
        default=0,
    )
    end = (
        f" It ends at {last / FRAME_RATE_HZ:.2f} s."
        if last < len(ghost["places"]) - 1
        else ""
    )
    return f"Ghost: {what}; not aligned in time.{kept}{end}"
