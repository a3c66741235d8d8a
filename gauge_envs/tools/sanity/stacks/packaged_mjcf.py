"""Compile a model of an installed package from its XML files, also when files that it refers to are not there.

Packages of environments keep XML files in their wheel and download meshes at the first start. Options, joints, masses
and primitive geoms are in the XML files. A small tetrahedron stands for each mesh that is not there, and a grey pixel
for each picture, so that names and classes of geoms stay as they are.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import mujoco

from gauge_envs.errors import TargetError
from gauge_envs.files import MEGABYTE
from gauge_envs.tools.sanity.stacks.documents import file_content

MOST_ASSET_BYTES = 256 * MEGABYTE
"""Largest size of a mesh or a picture."""

CORNERS_M = ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1))
"""Corners of the tetrahedron that stands for a mesh [m]; MuJoCo refuses smaller ones where a mesh is in millimetres."""

FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
"""Faces of that tetrahedron, by the numbers of their corners."""

ABSENT = "is not in the package: start the environment once, so that it downloads its robots"


@dataclass(frozen=True, kw_only=True)
class PackagedModel:
    """A compiled model of a package.

    Attributes:
        model: The compiled model.
        missing: Names of files that are not there and that a substitute stands for.
        missing_geoms: Numbers of the colliding geoms whose shape is a substitute.
    """

    model: mujoco.MjModel
    missing: tuple[str, ...] = ()
    missing_geoms: tuple[int, ...] = ()


def packaged_model(path: Path, folders: Sequence[Path] = ()) -> PackagedModel:
    """Compile a model file of a package.

    Args:
        path: The model file. Files beside and below it are found by their name, as the packages do it.
        folders: Further folders in which files are found by their name.
    """
    found = (file for folder in (path.parent, *folders) for file in sorted(folder.rglob("*")) if file.is_file())
    places = {file.name: file for file in found}
    if not path.is_file():
        raise TargetError(f"{path.name} {ABSENT}")
    text = file_content(path, MOST_ASSET_BYTES)
    assets: dict[str, bytes] = {}
    missing: list[str] = []
    waiting = [(path.name, text)]
    while waiting:
        origin, content = waiting.pop()
        for name in _references(content, origin):
            if name in assets:
                continue
            if name in places:
                assets[name] = file_content(places[name], MOST_ASSET_BYTES)
                if name.endswith(".xml"):
                    waiting.append((name, assets[name]))
            elif name.endswith(".xml"):
                raise TargetError(f"{path.name} includes {name}, which {ABSENT}")
            else:
                assets[name] = _substitute(name)
                missing.append(name)
    try:
        model = mujoco.MjModel.from_xml_string(text.decode(), assets)
    except (ValueError, UnicodeDecodeError) as error:
        raise TargetError(f"{path}: MuJoCo cannot load it: {' '.join(str(error).split())}") from None
    return PackagedModel(model=model, missing=tuple(missing), missing_geoms=tuple(_substituted(model, missing)))


def _references(content: bytes, origin: str) -> Iterator[str]:
    """Yield names of the files that an XML text refers to, without their folders."""
    try:
        root = ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        raise TargetError(f"{origin}: is no XML: {error}") from None
    for element in root.iter():
        for attribute, value in element.attrib.items():
            if attribute.startswith("file"):
                yield Path(value).name


def _substitute(name: str) -> bytes:
    """Return a tetrahedron for a mesh, and a grey pixel for a picture."""
    suffix = Path(name).suffix.lower()
    if suffix in (".stl", ".obj"):
        import trimesh

        content = trimesh.Trimesh(CORNERS_M, FACES, process=False).export(file_type=suffix[1:])
        return content.encode() if isinstance(content, str) else bytes(content)
    if suffix == ".png":
        from PIL import Image

        stream = BytesIO()
        Image.new("RGB", (1, 1), (128, 128, 128)).save(stream, format="png")
        return stream.getvalue()
    raise TargetError(f"{name} is not in the package, and nothing can stand for a file of the kind {suffix or 'none'}")


def _substituted(model: mujoco.MjModel, missing: Sequence[str]) -> Iterator[int]:
    """Yield numbers of geoms that can collide and whose mesh or height field is a substitute."""
    for geom in range(model.ngeom):
        if not model.geom_contype[geom] and not model.geom_conaffinity[geom]:
            continue
        data = int(model.geom_dataid[geom])
        kind = model.geom_type[geom]
        is_mesh, is_field = kind == mujoco.mjtGeom.mjGEOM_MESH, kind == mujoco.mjtGeom.mjGEOM_HFIELD
        if data < 0 or not (is_mesh or is_field):
            continue
        paths, start = model.paths, int((model.mesh_pathadr if is_mesh else model.hfield_pathadr)[data])
        if start >= 0 and Path(paths[start:].split(b"\0", 1)[0].decode()).name in missing:
            yield geom
