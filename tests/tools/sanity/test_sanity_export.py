"""Scenes of a sanity check for other simulators: complete files that other engines load as the same scene."""

from __future__ import annotations

import ast
import csv
import json
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from places import ROOT
from pxr import Usd
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from gauge_envs.cli.app import app
from gauge_envs.errors import ParameterError, ResultFileError, UnknownNameError
from gauge_envs.scene import Motion
from gauge_envs.tools.sanity import export
from gauge_envs.tools.sanity.exchange.scenes import MANIFEST, scenes
from gauge_envs.tools.sanity.phenomena import RELEASE_ID, phenomena

RUNNER = CliRunner()
EXAMPLES = ROOT / "examples" / "sanity_export"


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export") / "engine"
    export(folder)
    return folder


@pytest.fixture(scope="module")
def manifest(exported: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((exported / MANIFEST).read_text(encoding="utf-8"))
    return content


def test_every_rigid_phenomenon_is_exported_with_its_reality(manifest: dict[str, Any]) -> None:
    listed = {one["id"]: one for scene in manifest["scenes"] for one in scene["phenomena"]}
    # In files a body starts where it touches, so that a release is the rest.
    expected = [one for one in phenomena() if not one.needs_foot and one.id != RELEASE_ID]
    assert len(expected) >= 20 and set(listed) == {one.id for one in expected}
    for one in expected:
        entry = listed[one.id]
        assert (entry["value"], entry["tolerance"], entry["unit"]) == (
            one.reality.value,
            one.reality.tolerance,
            one.unit,
        )
        assert entry["kind"] == one.reality.kind.value and entry["source"] and entry["rationale"]


def test_every_named_file_exists_and_no_other(exported: Path, manifest: dict[str, Any]) -> None:
    named = {"README.md", "gauge_loop.py", MANIFEST}
    for scene in manifest["scenes"]:
        place = scene["name"]
        named |= {f"{place}/{scene[key]}" for key in ("mjcf", "usd", "drivers") if scene[key]}
        named |= {f"{place}/{body['urdf']}" for body in scene["bodies"]}
    found = {str(path.relative_to(exported)) for path in exported.rglob("*") if path.is_file()}
    assert found - named == {name for name in found if "/urdf/meshes/" in name}
    assert named <= found


def test_mjcf_and_urdf_have_the_masses_and_the_start_of_the_scene(exported: Path, manifest: dict[str, Any]) -> None:
    for entry, exported_scene in zip(manifest["scenes"], scenes(), strict=True):
        scene = exported_scene.scenario.scene
        folder = exported / entry["name"]
        model = mujoco.MjModel.from_xml_path(str(folder / entry["mjcf"]))
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        checked = set()
        for body in entry["bodies"]:
            start = scene.body(body["name"]).pose
            np.testing.assert_allclose(data.body(body["name"]).xpos, start.position_m, atol=1e-12)
            assert (body["position_m"], body["quaternion_wxyz"]) == (list(start.position_m), list(start.quaternion))
            if body["mass_kg"] == 0.0 or body["urdf"] in checked:
                continue
            checked.add(body["urdf"])
            _check_urdf(folder / body["urdf"], body)


def _check_urdf(path: Path, body: dict[str, Any]) -> None:
    """Check a URDF file against the manifest: mass, inertia, centre of mass, and the place of a hinged body."""
    robot = ElementTree.parse(path).getroot()
    link = next(one for one in robot.findall("link") if one.get("name") == body["urdf_link"])
    inertial = link.find("inertial")
    assert inertial is not None
    mass, origin, inertia = (inertial.find(tag) for tag in ("mass", "origin", "inertia"))
    assert mass is not None and origin is not None and inertia is not None
    assert float(mass.get("value", "")) == body["mass_kg"]
    names = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
    np.testing.assert_array_equal([[float(inertia.get(n, "")) for n in row] for row in names], body["inertia_kg_m2"])
    centre = np.add(body["center_of_mass_m"], body["urdf_origin_in_link_m"])
    np.testing.assert_allclose(_numbers(origin, "xyz"), centre, atol=1e-15)
    for piece in link.findall("collision"):
        mesh = piece.find("geometry/mesh")
        assert mesh is None or (path.parent / mesh.get("filename", "")).is_file()
    if robot.find("joint") is None:
        assert body["urdf_root_position_m"] == body["position_m"]
        assert body["urdf_root_quaternion_wxyz"] == body["quaternion_wxyz"]
        return
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.fusestatic = False
    model = spec.compile()
    data = mujoco.MjData(model)
    for angle in (0.0, 0.7):
        data.qpos[0] = angle
        mujoco.mj_kinematics(model, data)
        turned = Rotation.from_rotvec(angle * data.xaxis[0])
        expected = data.xanchor[0] + turned.apply(np.subtract(body["position_m"], data.xanchor[0]))
        place = data.body(body["urdf_link"])
        np.testing.assert_allclose(
            place.xpos + place.xmat.reshape(3, 3) @ body["urdf_origin_in_link_m"], expected, atol=1e-9
        )
        start = Rotation.from_quat(body["quaternion_wxyz"], scalar_first=True)
        np.testing.assert_allclose(place.xmat.reshape(3, 3), (turned * start).as_matrix(), atol=1e-9)


def _numbers(element: ElementTree.Element, name: str) -> list[float]:
    return [float(number) for number in element.get(name, "").split()]


def test_hinges_of_urdf_are_those_of_the_scene(exported: Path, manifest: dict[str, Any]) -> None:
    hinges = [(entry, hinge) for entry in manifest["scenes"] for hinge in entry["hinges"]]
    assert len(hinges) == 6
    for entry, hinge in hinges:
        body = next(one for one in entry["bodies"] if one["name"] == hinge["body"])
        joint = ElementTree.parse(exported / entry["name"] / body["urdf"]).getroot().find("joint")
        assert joint is not None and joint.get("type") == "continuous"
        origin, axis = joint.find("origin"), joint.find("axis")
        assert origin is not None and axis is not None
        turn = Rotation.from_euler("xyz", _numbers(origin, "rpy"))
        np.testing.assert_allclose(_numbers(origin, "xyz"), hinge["anchor_m"])
        np.testing.assert_allclose(turn.apply(_numbers(axis, "xyz")), hinge["axis"], atol=1e-9)


def test_driven_motion_is_that_of_the_driver(exported: Path) -> None:
    scene = next(one for one in scenes() if one.name == "stop")
    with (exported / "stop" / "drivers.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    (driver,) = scene.scenario.scene.drivers
    start = scene.scenario.scene.body(driver.body).pose
    for row in rows[::97]:
        pose = driver.pose(start, float(row["time_s"]))
        np.testing.assert_allclose([float(row[name]) for name in ("x_m", "y_m", "z_m")], pose.position_m, atol=1e-12)
        np.testing.assert_allclose(
            [float(row[name]) for name in ("qw", "qx", "qy", "qz")], pose.quaternion, rtol=0.0, atol=1e-12
        )
    assert float(rows[-1]["time_s"]) >= scene.scenario.seconds
    assert any(float(row["wz_rad_per_s"]) for row in rows)


def test_usd_has_all_bodies_and_the_gravity(exported: Path, manifest: dict[str, Any]) -> None:
    for entry in manifest["scenes"]:
        stage = Usd.Stage.Open(str(exported / entry["name"] / entry["usd"]))
        named = {prim.GetAttribute("gauge:name").Get() for prim in stage.Traverse() if prim.HasAttribute("gauge:name")}
        assert {body["name"] for body in entry["bodies"]} <= named
        magnitude = stage.GetPrimAtPath("/World/PhysicsScene").GetAttribute("physics:gravityMagnitude").Get()
        assert magnitude == pytest.approx(9.80665)


def test_constants_of_bodies_give_those_of_the_pairs(manifest: dict[str, Any]) -> None:
    rules = {
        "product": lambda a, b: a * b,
        "mean": lambda a, b: 0.5 * (a + b),
        "max": max,
        "min": min,
        "geometric": lambda a, b: (a * b) ** 0.5,
    }
    checked = 0
    for entry in manifest["scenes"]:
        bodies = {body["name"]: body for body in entry["bodies"]}
        moving = {name for name, body in bodies.items() if body["motion"] == "dynamic"}
        for contact in entry["contacts"]:
            for one in contact["first"][:3]:
                for other in contact["second"][-3:]:
                    if one == other or not {one, other} & moving:
                        continue
                    for constant in ("friction", "restitution"):
                        for rule, value in bodies[one][f"{constant}_by_rule"].items():
                            combined = rules[rule](value, bodies[other][f"{constant}_by_rule"][rule])
                            assert combined == pytest.approx(contact[constant], abs=1e-6), (entry["name"], rule)
                            checked += 1
    assert checked > 100


def test_recorded_bodies_are_those_that_move(manifest: dict[str, Any]) -> None:
    for entry, exported_scene in zip(manifest["scenes"], scenes(), strict=True):
        moving = [one.name for one in exported_scene.scenario.scene.bodies if one.motion is not Motion.FIXED]
        assert entry["recorded"] == moving


# --- what a user runs ------------------------------------------------------------------------------------------------


def test_the_readme_shows_the_loop_that_runs(exported: Path) -> None:
    readme, loop = ((exported / name).read_text(encoding="utf-8") for name in ("README.md", "gauge_loop.py"))
    block = next(part for part in readme.split("```") if part.startswith("python\ndef run("))
    assert block.removeprefix("python\n") in loop
    body = ast.parse(block.removeprefix("python\n")).body[0]
    code = [line for line in ast.unparse(body).splitlines() if line.strip()]
    docstring = ast.get_docstring(body) or ""  # type: ignore[arg-type]
    assert len(code) - len([line for line in docstring.splitlines() if line.strip()]) <= 24


@pytest.mark.parametrize("program", [*sorted(EXAMPLES.glob("*.py")), "gauge_loop.py"], ids=str)
def test_no_program_of_the_user_needs_this_package(exported: Path, program: Path | str) -> None:
    tree = ast.parse((exported / program).read_text(encoding="utf-8"))
    imported = {
        name.split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""])
    }
    allowed = set(sys.stdlib_module_names) | {"numpy", "mujoco", "pybullet", "gauge_loop"}
    assert imported <= (set(sys.stdlib_module_names) if program == "gauge_loop.py" else allowed)


# --- folder ----------------------------------------------------------------------------------------------------------


def test_a_folder_with_other_files_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("mine", encoding="utf-8")
    with pytest.raises(ResultFileError, match="choose a new folder"):
        export(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_second_export_keeps_motion_and_equals_the_first(tmp_path: Path) -> None:
    first = {path: path.read_bytes() for path in export(tmp_path / "a", only=["creep-wood"])}
    motion = tmp_path / "a" / "hold-wood" / "motion.csv"
    motion.write_text("mine", encoding="utf-8")
    export(tmp_path / "a", only=["creep-wood"])
    assert motion.read_text(encoding="utf-8") == "mine"
    assert {path: path.read_bytes() for path in first} == first


def test_an_unknown_phenomenon_is_an_error_before_a_file_is_written(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="crep-wood"):
        export(tmp_path / "a", only=["crep-wood"])
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("row", ["gravity", "foot-*"])
def test_rows_without_a_scene_cannot_be_exported(tmp_path: Path, row: str) -> None:
    with pytest.raises(ParameterError, match="no scene to export"):
        export(tmp_path / "a", only=[row])
    assert not (tmp_path / "a").exists()


def test_the_command_counts_scenes_and_lists_files(tmp_path: Path) -> None:
    folder = tmp_path / "engine"
    done = RUNNER.invoke(app, ["sanity", "export", str(folder), "--only", "creep-wood,rebound"])
    assert done.exit_code == 0 and "2 scenes" in " ".join(done.output.split())
    done = RUNNER.invoke(app, ["sanity", "export", str(folder), "--only", "creep-wood", "--json"])
    assert {Path(json.loads(line)["file"]).name for line in done.stdout.splitlines()} >= {"scene.xml", MANIFEST}
    done = RUNNER.invoke(app, ["sanity", "export", str(ROOT / "docs")])
    assert done.exit_code == 2 and "choose a new folder" in done.output
