"""Write the scenes of a sanity check for any simulator: MJCF, USD, URDF, drivers, a manifest and a loop that runs them.

Example:
    >>> from pathlib import Path
    >>> from gauge_envs.tools.sanity import export
    >>> written = export(Path("my_engine"), only=["creep-wood"])  # doctest: +SKIP
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterator, Sequence
from importlib.resources import files
from inspect import getsource
from pathlib import Path

import numpy as np

from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.mjcf_writer import described_xml, start_notes
from gauge_envs.errors import ParameterError, ResultFileError
from gauge_envs.files import MEGABYTE, json_document, os_errors, read_regular, write_texts
from gauge_envs.scene.driver_path import DriverPath
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.scene.usd.writer import scene_stage
from gauge_envs.tools.assets import SOURCE, body_files
from gauge_envs.tools.sanity.exchange.loop import run as run_exported
from gauge_envs.tools.sanity.exchange.scenes import COLUMNS, DRIVERS, FORMAT, MANIFEST, ExportedScene, manifest, scenes

MOST_MANIFEST_BYTES = 4 * MEGABYTE
"""Largest size of a manifest."""

USD_SAMPLES_PER_FRAME = 6
"""Time samples of driven bodies per frame of 1/30 s in a USD file."""

DRIVER_COLUMNS = (
    *(*COLUMNS, "wx_rad_per_s", "wy_rad_per_s", "wz_rad_per_s"),
    *("ax_m_per_s2", "ay_m_per_s2", "az_m_per_s2", "bx_rad_per_s2", "by_rad_per_s2", "bz_rad_per_s2"),
)
"""Columns of a file with the motion of driven bodies, in the world frame."""


def export(folder: Path, *, only: Sequence[str] = ()) -> list[Path]:
    """Write the scenes of rigid bodies of a sanity check.

    Motion files of an earlier run in the folder stay.

    Args:
        folder: New or empty folder, or one of an earlier export.
        only: Ids of phenomena or patterns such as `creep-*`; the scenes of all when empty.

    Returns:
        The written files.
    """
    chosen = scenes(only)
    if not chosen:
        raise ParameterError(f"{', '.join(only)}: these rows have no scene to export: see gauge list phenomena")
    _check_folder(folder)
    with os_errors(lambda cause: ResultFileError(f"{folder}: cannot be written: {cause}: choose another folder")):
        return write_texts(folder, _texts(chosen))


def _check_folder(folder: Path) -> None:
    """Raise an error if a folder holds anything but an earlier export."""
    try:
        if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
            return
        known = json_document(read_regular(folder / MANIFEST, MOST_MANIFEST_BYTES))
    except (OSError, ValueError):
        known = None
    if not isinstance(known, dict) or known.get("format") != FORMAT:
        raise ResultFileError(f"{folder}: is no empty folder and no earlier export: choose a new folder")


def _texts(chosen: Sequence[ExportedScene]) -> Iterator[tuple[str, str]]:
    """Yield the path below the folder and the text of each file."""
    program = files("gauge_envs.tools.sanity.exchange")
    for scene in chosen:
        yield f"{scene.name}/scene.xml", _mjcf(scene)
        yield f"{scene.name}/scene.usda", _usd(scene)
        for file in body_files(scene.scenario.scene).values():
            for name, text in file.texts.items():
                yield f"{scene.name}/urdf/{name}", text
        if scene.scenario.scene.drivers:
            yield f"{scene.name}/{DRIVERS}", _drivers(scene)
    yield "gauge_loop.py", (program / "loop.py").read_text(encoding="utf-8")
    readme = (program / "readme.md").read_text(encoding="utf-8")
    yield "README.md", readme.replace("LOOP\n", getsource(run_exported))
    # Written last: a folder with a manifest is complete.
    yield MANIFEST, json.dumps(manifest(chosen), indent=1, allow_nan=False) + "\n"


def _mjcf(scene: ExportedScene) -> str:
    simulation = BackendMuJoCo().build(scene.scenario.scene)
    notes = [
        f"Scene {scene.name!r} of a sanity check, from {scene.scenario.id}.",
        "Options and contact constants are those of gauge-envs' preset: replace them by your own.",
        *start_notes(simulation),
    ]
    if scene.scenario.scene.drivers:
        notes.append(f"Driven bodies have free joints and follow {DRIVERS}.")
    text = described_xml(simulation, scene.name, [*notes, SOURCE])
    simulation.close()
    return text


def _usd(scene: ExportedScene) -> str:
    stage = scene_stage(scene.scenario.scene, samples_per_frame=USD_SAMPLES_PER_FRAME)
    layer = stage.GetRootLayer()
    layer.documentation = f"Scene {scene.name!r} of a sanity check, from {scene.scenario.id}. {SOURCE}"
    return str(layer.ExportToString())


def _drivers(scene: ExportedScene) -> str:
    scenario = scene.scenario
    stream = io.StringIO(newline="")
    out = csv.writer(stream, lineterminator="\n")
    out.writerow(DRIVER_COLUMNS)
    for driver in scenario.scene.drivers:
        frame_count = 2 + math.ceil(scenario.seconds * FRAME_RATE_HZ)
        path = DriverPath(driver, scenario.scene, frame_count, interval_s=scenario.interval_s)
        still = np.zeros(path.motion_count)
        for index in range(round(scenario.seconds / scenario.interval_s) + 2):
            pose, velocity, acceleration = path.interval(index, still)
            numbers = (*pose.position_m, *pose.quaternion, *velocity.tolist(), *acceleration.tolist())
            out.writerow([repr(index * scenario.interval_s), driver.body, *map(repr, numbers)])
    return stream.getvalue()
