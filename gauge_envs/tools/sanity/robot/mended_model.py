"""Say changes of settings in the words of a model's classes, and write the changed model with a comment at each."""

import difflib
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from gauge_envs.errors import TargetError, first_names
from gauge_envs.tools.sanity.model import Settings
from gauge_envs.tools.sanity.robot.mujoco_feet import geom_name
from gauge_envs.tools.sanity.robot.robot import (
    GEOM_FIELDS,
    PAIRED,
    Robot,
    of_one_geom,
    set_option,
)

MEMBERS = 2
"""Least elements of a class for which the class is named."""

MOST_NAMES = 12
"""Most elements that a text names one by one."""


def element_words(
    robot: Robot, kind: str, field: str, value: Any, several: Sequence[int]
) -> list[str]:
    """Return what elements that do not take an attribute from the default of all are to state.

    Args:
        robot: The robot before the change.
        kind: Kind of element, such as `geom`.
        field: Attribute of the element.
        value: Its new value.
        several: Ids of the elements.
    """
    return [
        text if text.startswith("<") else f"{text}, which the default does not reach"
        for text in _words(robot, (kind, field, _text(value)), several)
    ]


def _text(value: Any) -> str:
    return " ".join(f"{number:.4g}" for number in np.atleast_1d(value))


def _words(
    robot: Robot, key: tuple[str, str, str], several: Sequence[int]
) -> Iterator[str]:
    """Yield one line for each class whose elements all change, then the other elements by name."""
    kind, field, text = key
    left = list(several)
    if robot.spec is not None:
        for family, members in _classes(robot.spec, kind, field, several):
            if len(members) < MEMBERS:
                continue
            tag = f' class="{family.name}"' if family.name != "main" else ""
            yield f'<default{tag}><{kind} {field}="{text}"/></default>'
            left = [index for index in left if index not in members]
    if left:
        yield f'{field}="{text}" in {_listed(_element_names(robot, kind, left))}'


def _listed(names: Sequence[str]) -> str:
    """Return names in a row, and the number of those beyond the twelfth."""
    if len(names) > MOST_NAMES:
        return first_names(names, MOST_NAMES)
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def _element_names(robot: Robot, kind: str, several: Sequence[int]) -> list[str]:
    """Return the names of geoms or pairs; their number where they have none."""
    if kind == "geom":
        return [geom_name(robot.model, index) for index in several]
    names = [robot.model.pair(index).name or str(index) for index in several]
    return [f"pair {name.removeprefix('pair ')}" for name in names]


def _classes(
    spec: mujoco.MjSpec, kind: str, field: str, several: Sequence[int]
) -> Iterator[tuple[Any, list[int]]]:
    """Yield each class with the elements that take an attribute from it, where they are all among several."""
    families: dict[str, list[Any]] = {}
    for element in getattr(spec, f"{kind}s"):
        families.setdefault(element.classname.name, []).append(element)
    for elements in families.values():
        family = elements[0].classname
        default = getattr(getattr(family, kind), field, None)
        taking = [
            element.id
            for element in elements
            if default is not None and np.array_equal(getattr(element, field), default)
        ]
        if taking and set(taking) <= set(several):
            yield family, taking


# --- the mended file -------------------------------------------------------------------------------------------------


def mended_xml(
    robot: Robot, changes: Settings, words: Sequence[str], folder: Path
) -> str:
    """Return the model with changes as MJCF, with what changes them at the head and a comment at each change.

    Args:
        robot: The robot before the changes, whose spec is known.
        changes: The changes, as `Robot.changed` takes them.
        words: Lines of text for the head.
        folder: Folder of the file; paths of meshes and textures are written as seen from it.
    """
    if robot.spec is None:
        raise TargetError(
            "the model's file is not known, only the compiled model: give the file as the target"
        )
    before = _compiled(robot.spec)
    after = _compiled(robot.spec)
    _, geoms = robot.changed(changes)
    # Two passes, since ids of a copy are known only after it was compiled.
    _write(robot, after, changes, geoms)
    after.compile()
    trees = []
    for spec in (before, after):
        trees.append(ET.fromstring(spec.to_xml()))
        _restore_pictures(trees[-1], spec)
    _add_comments(*trees)
    _set_folders(trees[1], robot.spec, folder)
    head = ET.Comment(
        " ".join(f" gauge sanity: {_plain(line)}" for line in words) + " "
    )
    trees[1].insert(0, head)
    ET.indent(trees[1])
    return ET.tostring(trees[1], encoding="unicode") + "\n"


PICTURE = "picture "
"""Begin of the note of a texture whose file was dropped."""


def drop_pictures(spec: mujoco.MjSpec) -> None:
    """Replace the pictures of textures by one pixel, which no row reads: they can be 30 times as large as the model."""
    for texture in spec.textures:
        if texture.file:
            texture.info, texture.file = f"{PICTURE}{texture.file}", ""
            texture.builtin = mujoco.mjtBuiltin.mjBUILTIN_FLAT
            texture.width = texture.height = 1


def _restore_pictures(tree: ET.Element, spec: mujoco.MjSpec) -> None:
    """Give the textures of the elements of a model their files again."""
    for element, texture in zip(
        tree.findall("asset/texture"), spec.textures, strict=True
    ):
        if texture.info.startswith(PICTURE):
            for name in ("builtin", "width", "height"):
                element.attrib.pop(name, None)
            element.set("file", texture.info.removeprefix(PICTURE))


def _compiled(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    copied = spec.copy()
    copied.compile()
    return copied


def _write(
    robot: Robot,
    spec: mujoco.MjSpec,
    changes: Settings,
    geoms: Mapping[str, Sequence[int]],
) -> None:
    """Write changes into a compiled spec; `geoms` are those that do not take an attribute from the default."""
    for name, value in changes.items():
        if name not in GEOM_FIELDS:
            set_option(spec.option, name, value)
            continue
        field = GEOM_FIELDS[name]
        reached = [*robot.reached_by_default(name), *geoms.get(name, [])]
        _set_elements(spec, "geom", field, reached, of_one_geom(name, value))
        if name in PAIRED and robot.explicit_ground_pairs:
            _set_elements(spec, "pair", field, robot.explicit_ground_pairs, value)


def _set_elements(
    spec: mujoco.MjSpec, kind: str, field: str, several: Sequence[int], value: Any
) -> None:
    """Set an attribute of elements, and of each class all of whose elements are among them."""
    for family, _ in _classes(spec, kind, field, several):
        setattr(getattr(family, kind), field, value)
    for element in getattr(spec, f"{kind}s"):
        if element.id in several:
            setattr(element, field, value)


def _set_folders(tree: ET.Element, spec: mujoco.MjSpec, folder: Path) -> None:
    """State folders of meshes and textures as seen from the folder of the mended file."""
    source = Path(spec.modelfiledir or ".").resolve()
    if not (spec.meshes or spec.textures or spec.hfields or spec.skins):
        return
    if source == folder.resolve():
        return
    compiler = tree.find("compiler")
    assert compiler is not None, "a written model states the unit of its angles"
    for key in ("meshdir", "texturedir"):
        stated = compiler.attrib.get(key, compiler.attrib.get("assetdir", ""))
        compiler.set(key, os.path.relpath(source / stated, folder.resolve()))


def _plain(text: str) -> str:
    """Return text that may stand in a comment."""
    return text.replace("--", "- -").strip()


def _add_comments(before: ET.Element, after: ET.Element) -> None:
    """Insert a comment in front of each child that differs from its counterpart, at every depth."""
    keys = [
        [(one.tag, one.get("name"), one.get("class")) for one in tree]
        for tree in (before, after)
    ]
    matcher = difflib.SequenceMatcher(None, keys[0], keys[1], autojunk=False)
    partners: dict[int, ET.Element] = {}
    for block in matcher.get_matching_blocks():
        for step in range(block.size):
            partners[block.b + step] = before[block.a + step]
    for place in reversed(range(len(after))):
        child, partner = after[place], partners.get(place)
        if partner is None:
            after.insert(place, ET.Comment(" gauge sanity: added "))
            continue
        differing = [
            f"{key} was {partner.get(key, 'not stated')}"
            for key in {**partner.attrib, **child.attrib}
            if partner.get(key) != child.get(key)
        ]
        _add_comments(partner, child)
        if differing:
            text = f" gauge sanity: {_plain(', '.join(differing))} "
            after.insert(place, ET.Comment(text))
