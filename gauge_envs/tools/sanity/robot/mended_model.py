"""Say changes of a model in the words of its default classes, and write the mended model with a comment at each."""

import difflib
import os
import re
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
    COMPILER,
    ELEMENT,
    GEOM_FIELDS,
    LENGTHS,
    PAIRED,
    Robot,
    set_option,
)

CLASSED = ("joint", "actuator", "geom", "pair", "equality")
"""Elements of MJCF that have classes."""

KINDS = {"dof": "joint", "jnt": "joint", "eq": "equality"}
"""Elements of MJCF by the first word of an array of the compiled model, where they differ."""

SPEC_FIELDS = {("jnt", "solref"): "solref_limit", ("jnt", "solimp"): "solimp_limit"}
"""Attributes of a spec by array of the compiled model, where they differ. MJCF writes them without `_`."""

MEMBERS = 2
"""Least elements of a class for which the class is named."""

MOST_NAMES = 12
"""Most elements that a text names one by one."""


def class_words(robot: Robot, changes: Settings) -> str:
    """Return changes of rows of arrays as elements of MJCF.

    An attribute that all elements of a class take from it is one element of `<default>`; others are named.

    Args:
        robot: The robot before the changes.
        changes: New values by names such as `dof_armature[3]`.
    """
    groups: dict[tuple[str, str, str], list[int]] = {}
    for name, value in changes.items():
        found = ELEMENT.fullmatch(name)
        if found is None:
            continue
        kind, field, index = _place(robot.model, found)
        in_degrees = robot.spec is not None and bool(robot.spec.compiler.degree)
        if in_degrees and name.startswith("jnt_range") and _is_hinge(robot, index):
            value = np.degrees(value)
        several = groups.setdefault((kind, field, _text(value)), [])
        if index not in several:
            several.append(index)
    return " and ".join(
        text for key, several in groups.items() for text in _words(robot, key, several)
    )


def _is_hinge(robot: Robot, joint: int) -> bool:
    return bool(robot.model.jnt_type[joint] == int(mujoco.mjtJoint.mjJNT_HINGE))


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


def _place(model: mujoco.MjModel, found: re.Match[str]) -> tuple[str, str, int]:
    """Return the kind of element, its attribute and its id for a row of an array."""
    first, _, field = found[1].partition("_")
    index = int(found[2])
    if first == "dof":
        index = int(model.dof_jntid[index])
    return KINDS.get(first, first), SPEC_FIELDS.get((first, field), field), index


def _elements(spec: mujoco.MjSpec, kind: str) -> list[Any]:
    """Return the elements of a kind."""
    plurals = {"body": "bodies", "equality": "equalities"}
    return list(getattr(spec, plurals.get(kind, f"{kind}s")))


def _text(value: Any) -> str:
    return " ".join(f"{number:.4g}" for number in np.atleast_1d(value))


def _words(
    robot: Robot, key: tuple[str, str, str], several: Sequence[int]
) -> Iterator[str]:
    """Yield one line for each class whose elements all change, then the other elements by name."""
    kind, field, text = key
    attribute = field.replace("_", "")
    if (kind, field) == ("equality", "data"):
        attribute, text = "polycoef", " ".join(text.split()[:5])
    if field == "biastype":
        text = "affine"
    left = list(several)
    if robot.spec is not None and kind in CLASSED:
        for family, members in _classes(robot.spec, kind, field, several):
            if len(members) < MEMBERS:
                continue
            tag = f' class="{family.name}"' if family.name != "main" else ""
            element = "general" if kind == "actuator" else kind
            yield f'<default{tag}><{element} {attribute}="{text}"/></default>'
            left = [index for index in left if index not in members]
    if left:
        word = "in" if kind in ("geom", "pair") else "for"
        yield f'{attribute}="{text}" {word} {listed(element_names(robot, kind, left))}'


def listed(names: Sequence[str]) -> str:
    """Return names in a row, and the number of those beyond the twelfth."""
    if len(names) > MOST_NAMES:
        return first_names(names, MOST_NAMES)
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def element_names(robot: Robot, kind: str, several: Sequence[int]) -> list[str]:
    """Return the names of elements of a kind; their number where they have none."""
    if kind == "geom":
        return [geom_name(robot.model, index) for index in several]
    look = getattr(robot.model, kind)
    names = [look(index).name or f"{kind} {index}" for index in several]
    if kind == "pair":
        names = [f"pair {name.removeprefix('pair ')}" for name in names]
    return names


def _classes(
    spec: mujoco.MjSpec, kind: str, field: str, several: Sequence[int]
) -> Iterator[tuple[Any, list[int]]]:
    """Yield each class with the elements that take an attribute from it, where they are all among several."""
    families: dict[str, list[Any]] = {}
    for element in _elements(spec, kind):
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
    if LENGTHS in changes:
        robot = robot.scaled(changes[LENGTHS])
        changes = {k: v for k, v in changes.items() if k != LENGTHS}
    assert robot.spec is not None
    after = _compiled(robot.spec)
    model, geoms = robot.changed(changes)
    # Two passes, since ids of a copy are known only after it was compiled.
    _write(robot, after, changes, model, geoms)
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
    model: mujoco.MjModel,
    geoms: Mapping[str, Sequence[int]],
) -> None:
    """Write changes into a compiled spec; `geoms` are those that do not take an attribute from the default."""
    bodies = set()
    rows: dict[tuple[str, bytes], tuple[str, str, Any, list[int]]] = {}
    for name, value in changes.items():
        if name in GEOM_FIELDS:
            reached = [*robot.reached_by_default(name), *geoms.get(name, [])]
            # The margins and gaps of two geoms add up, as in `Robot.changed`.
            is_sum = name in ("contact_margin_m", "contact_gap_m")
            _set_elements(
                spec, "geom", GEOM_FIELDS[name], reached, value / 2 if is_sum else value
            )
            _set_pairs(robot, spec, name, value)
        elif found := ELEMENT.fullmatch(name):
            kind, field, index = _place(robot.model, found)
            if kind == "body" and field in ("mass", "inertia"):
                bodies.add(index)
            else:
                alike = (found[1], np.asarray(value).tobytes())
                rows.setdefault(alike, (kind, field, value, []))[-1].append(index)
        elif name in COMPILER:
            setattr(spec.compiler, COMPILER[name], value)
        else:
            set_option(spec.option, name, value)
    for kind, field, value, several in rows.values():
        _set_elements(spec, kind, field, several, value)
    for body in sorted(bodies):
        _set_inertial(robot, spec, body, model)


def _set_elements(
    spec: mujoco.MjSpec, kind: str, field: str, several: Sequence[int], value: Any
) -> None:
    """Set an attribute of elements, and of each class all of whose elements are among them."""
    if kind in CLASSED:
        for family, _ in _classes(spec, kind, field, several):
            _set(getattr(family, kind), field, value)
    for element in _elements(spec, kind):
        if element.id in several:
            _set(element, field, value)


def _set(element: Any, field: str, value: Any) -> None:
    """Set an attribute of an element; a number is the first one of an array."""
    was = getattr(element, field)
    if isinstance(was, np.ndarray) and np.ndim(value) == 0:
        # MuJoCo 4 has coefficients of a polynomial in the velocity, earlier versions one number.
        first = np.zeros(was.shape)
        first.flat[0] = value
        value = first
    elif isinstance(was, np.ndarray):
        # A compiled row may be shorter or longer than what a spec states.
        width = min(was.size, np.size(value))
        filled = was.copy()
        filled.flat[:width] = np.ravel(value)[:width]
        value = filled
    elif isinstance(was, int | mujoco.mjtLimited):
        value = int(value)
    setattr(element, field, value)


def _set_pairs(robot: Robot, spec: mujoco.MjSpec, name: str, value: Any) -> None:
    """Set a contact attribute of explicit pairs with the ground, or of their default where it holds for all."""
    pairs = robot.explicit_ground_pairs
    if name in PAIRED and pairs:
        _set_elements(spec, "pair", GEOM_FIELDS[name], pairs, value)


def _set_inertial(
    robot: Robot, spec: mujoco.MjSpec, index: int, model: mujoco.MjModel
) -> None:
    """Give a body the mass and inertia of a model: through the density of its geoms where both scale, else itself."""
    (body,) = [one for one in spec.bodies if one.id == index]
    was, now = robot.model, model
    share = float(now.body_mass[index] / was.body_mass[index])
    scaled = share * was.body_inertia[index]
    if not body.explicitinertial and np.allclose(now.body_inertia[index], scaled):
        for geom in body.geoms:
            if np.isnan(geom.mass):
                geom.density *= share
            else:
                geom.mass *= share
        return
    body.explicitinertial = True
    body.mass = float(now.body_mass[index])
    body.ipos, body.iquat = was.body_ipos[index], was.body_iquat[index]
    body.inertia = now.body_inertia[index]
    body.fullinertia = np.full(6, np.nan)


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
