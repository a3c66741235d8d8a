"""Describe the scenes of a sanity check, and write them for any simulator.

A folder has MJCF, USD, URDF, drivers, a manifest and a loop that runs them.

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
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from inspect import getsource
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.mjcf_writer import described_xml, start_notes
from gauge_envs.backends.shared.pair_values import Combination, body_values, pair_values
from gauge_envs.errors import ParameterError, ResultFileError, UnsupportedSceneError
from gauge_envs.files import MEGABYTE, json_document, json_ready, os_errors, read_regular, versions, write_texts
from gauge_envs.scene import Hinge, Motion, RigidBody, Scene
from gauge_envs.scene.driver_path import DriverPath
from gauge_envs.scene.hinged import joint_fields
from gauge_envs.scene.meshes import body_mass_properties
from gauge_envs.scene.timing import FRAME_RATE_HZ
from gauge_envs.tools.assets import SOURCE, BodyFile, body_files
from gauge_envs.tools.sanity.exchange.loop import run as run_exported
from gauge_envs.tools.sanity.phenomena import RELEASE_ID, phenomena, selection
from gauge_envs.tools.sanity.phenomena.base import Phenomenon
from gauge_envs.tools.sanity.scenario import Scenario
from gauge_envs.tools.usd import scene_stage

FORMAT, VERSION = "gauge-sanity-export", 1

MANIFEST = "manifest.json"
MOTION = "motion.csv"
DRIVERS = "drivers.csv"

COLUMNS = (
    *("time_s", "body", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"),
    *("vx_m_per_s", "vy_m_per_s", "vz_m_per_s"),
)
"""Columns of a motion file; the last three may be left out."""

CONSTANTS: tuple[Literal["friction", "restitution"], ...] = ("friction", "restitution")
"""Contact constants of a pair."""


@dataclass(frozen=True, eq=False)
class ExportedScene:
    """A scenario and the phenomena that are measured in it.

    Attributes:
        scenario: The scenario.
        phenomena: Its phenomena.
    """

    scenario: Scenario
    phenomena: tuple[Phenomenon, ...]

    @property
    def name(self) -> str:
        """Name of the scenario, and of its folder."""
        return self.scenario.name

    @property
    def recorded(self) -> tuple[str, ...]:
        """Names of the bodies whose motion is recorded: all that are not fixed."""
        return tuple(body.name for body in self.scenario.scene.bodies if body.motion is not Motion.FIXED)

    def entry(self) -> dict[str, Any]:
        """Return the description of the scene, JSON-ready."""
        scene = self.scenario.scene
        described = body_files(scene)
        constants = _body_constants(scene)
        return json_ready(
            {
                "name": self.name,
                "experiment": self.scenario.id,
                "seconds": self.scenario.seconds,
                "longest_interval_s": self.scenario.interval_s,
                "gravity_m_per_s2": [0.0, 0.0, -scene.gravity_m_per_s2],
                "bodies": [_body(body, described[body.name], constants.get(body.name, {})) for body in scene.bodies],
                "hinges": [joint_fields(joint) for joint in scene.joints if isinstance(joint, Hinge)],
                "contacts": [
                    {name: getattr(contact, name) for name in ("first", "second", *CONSTANTS)}
                    for contact in scene.contacts
                ],
                "mjcf": "scene.xml",
                "usd": "scene.usda",
                "drivers": DRIVERS if scene.drivers else None,
                "motion": MOTION,
                "recorded": self.recorded,
                "phenomena": [_phenomenon(one) for one in self.phenomena],
            }
        )


@cache
def _all_scenes() -> tuple[ExportedScene, ...]:
    grouped: dict[str, list[Phenomenon]] = {}
    for one in phenomena():
        # A scene with a robot's foot needs a target, and files have no compounds. In files a body starts where it
        # touches, so that a release has the scene of a rest.
        if not one.needs_foot and one.id != RELEASE_ID:
            grouped.setdefault(one.scenario.name, []).append(one)
    return tuple(ExportedScene(several[0].scenario, tuple(several)) for several in grouped.values())


def scenes(only: Sequence[str] = ()) -> tuple[ExportedScene, ...]:
    """Return the scenes of rigid bodies in a fixed order, without those of a target's own foot.

    Args:
        only: Ids of phenomena or patterns; scenes without one of them are left out. All when empty.
    """
    chosen = selection(only)
    return tuple(scene for scene in _all_scenes() if any(one.id in chosen for one in scene.phenomena))


def manifest(chosen: Sequence[ExportedScene]) -> dict[str, Any]:
    """Return the manifest of a folder with scenes, JSON-ready."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "gauge_envs": versions()["gauge-envs"],
        "units": "SI; quaternions in the order w, x, y, z; z is up; body frames as in the URDF and MJCF files",
        "columns": list(COLUMNS),
        "scenes": [scene.entry() for scene in chosen],
    }


def _body(body: RigidBody, file: BodyFile, constants: Mapping[str, Mapping[str, float]]) -> dict[str, Any]:
    centre, inertia = body_mass_properties(body)
    volume = body.shape.volume_m3
    return {
        "name": body.name,
        "motion": {Motion.KINEMATIC: "driven"}.get(body.motion, body.motion.value),
        # Polyhedra are in the files alone.
        "shape": {name: value for name, value in asdict(body.shape).items() if name != "pieces_m"},
        "mass_kg": body.mass_kg,
        "density_kg_per_m3": body.mass_kg / volume if volume else 0.0,
        "center_of_mass_m": centre.tolist(),
        "inertia_kg_m2": inertia.tolist(),
        "position_m": body.pose.position_m,
        "quaternion_wxyz": body.pose.quaternion,
        "velocity_m_per_s": body.linear_velocity_m_per_s,
        "angular_velocity_rad_per_s": body.angular_velocity_rad_per_s,
        "friction_by_rule": constants.get("friction", {}),
        "restitution_by_rule": constants.get("restitution", {}),
        "urdf": f"urdf/{file.file}",
        "urdf_root_position_m": file.root_position_m,
        "urdf_root_quaternion_wxyz": file.root_quaternion,
        "urdf_root_is_fixed": file.is_root_fixed,
        "urdf_link": file.link,
        "urdf_origin_in_link_m": file.origin_in_link_m,
    }


def _body_constants(scene: Scene) -> dict[str, dict[str, dict[str, float]]]:
    """Return the constants of each body by name and rule of combination, where the rule can give those of all pairs."""
    alike: dict[tuple[bool, ...], list[str]] = {}
    for body in scene.bodies:
        sides = (side for contact in scene.contacts for side in (contact.first, contact.second))
        alike.setdefault(tuple(body.name in side for side in sides), []).append(body.name)
    # Two bodies of a kind stand for all of them: a wall has thousands of equal pairs.
    kinds = {name: names for names in alike.values() for name in names[:2]}
    found: dict[str, dict[str, dict[str, float]]] = {}
    for constant in CONSTANTS:
        pairs = {pair: value for pair, value in pair_values(scene, constant).items() if kinds.keys() >= set(pair)}
        for rule in Combination:
            try:
                values = body_values(pairs, rule)
            except UnsupportedSceneError:
                continue
            for one, value in values.items():
                for name in kinds[one]:
                    # The solution of the equations ends with rounding.
                    found.setdefault(name, {}).setdefault(constant, {})[rule.value] = round(value, 9)
    return found


def _phenomenon(one: Phenomenon) -> dict[str, Any]:
    described = {name: getattr(one, name) for name in ("id", "title", "quantity", "unit")}
    reality = {name: getattr(one.reality, name) for name in ("value", "tolerance", "source", "rationale")}
    return {**described, "kind": one.reality.kind.value, **reality}


# --- files -----------------------------------------------------------------------------------------------------------

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
