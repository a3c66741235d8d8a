"""Compile a model of an installed package from its XML files, also when files that it refers to are not there.

Packages of environments keep XML files in their wheel and download meshes at the first start. Options, joints, masses
and primitive geoms are in the XML files. A small tetrahedron stands for each mesh that is not there, and a grey pixel
for each picture, so that names and classes of geoms stay as they are.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ElementTree
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco

from gauge_envs.errors import TargetError
from gauge_envs.files import MEGABYTE, read_regular

MOST_ASSET_BYTES = 256 * MEGABYTE
"""Largest size of a mesh or a picture."""

CORNERS_M = ((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1))
"""Corners of the tetrahedron that stands for a mesh [m]; MuJoCo refuses smaller ones where a mesh is in millimetres."""

FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
"""Faces of that tetrahedron, by the numbers of their corners."""


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
    places = {file.name: file for folder in (path.parent, *folders) for file in _files(folder)}
    assets: dict[str, bytes] = {}
    missing: list[str] = []
    text = _text(path)
    waiting = [(path.name, text)]
    while waiting:
        origin, content = waiting.pop()
        for name in _references(content, origin):
            if name in assets:
                continue
            place = places.get(name)
            if place is not None:
                assets[name] = _read(place)
                if name.endswith(".xml"):
                    waiting.append((name, assets[name]))
            elif name.endswith(".xml"):
                raise TargetError(
                    f"{path.name} includes {name}, which is not in the package: start the environment once, so that "
                    "it downloads its robots"
                )
            else:
                assets[name] = _substitute(name)
                missing.append(name)
    try:
        model = mujoco.MjModel.from_xml_string(text.decode(), assets)
    except (ValueError, UnicodeDecodeError) as error:
        raise TargetError(f"{path}: MuJoCo cannot load it: {' '.join(str(error).split())}") from None
    return PackagedModel(model=model, missing=tuple(missing), missing_geoms=tuple(_substituted(model, missing)))


def _files(folder: Path) -> Iterator[Path]:
    return (file for file in sorted(folder.rglob("*")) if file.is_file())


def _text(path: Path) -> bytes:
    try:
        return read_regular(path, MOST_ASSET_BYTES)
    except OSError:
        raise TargetError(
            f"{path.name} is not in the package: start the environment once, so that it downloads its robots"
        ) from None


def _read(path: Path) -> bytes:
    try:
        return read_regular(path, MOST_ASSET_BYTES)
    except OSError as error:
        raise TargetError(f"{path}: cannot be read: {error.strerror or error}") from None


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
    suffix = Path(name).suffix.lower()
    if suffix == ".stl":
        return _stl()
    if suffix == ".obj":
        return _obj()
    if suffix == ".png":
        return _png()
    raise TargetError(f"{name} is not in the package, and nothing can stand for a file of the kind {suffix or 'none'}")


def _obj() -> bytes:
    lines = ["v {:g} {:g} {:g}".format(*corner) for corner in CORNERS_M]
    lines += ["f {} {} {}".format(*(number + 1 for number in face)) for face in FACES]
    return "\n".join(lines).encode()


def _stl() -> bytes:
    triangles = [
        struct.pack("<12fH", 0.0, 0.0, 0.0, *(value for number in face for value in CORNERS_M[number]), 0)
        for face in FACES
    ]
    return bytes(80) + struct.pack("<I", len(FACES)) + b"".join(triangles)


def _png() -> bytes:
    """Return a grey picture of one pixel."""
    chunks = {
        b"IHDR": struct.pack(">IIBBBBB", 1, 1, 8, 2, 0, 0, 0),
        b"IDAT": zlib.compress(b"\x00\x80\x80\x80"),
        b"IEND": b"",
    }
    parts = [
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks.items()
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


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
