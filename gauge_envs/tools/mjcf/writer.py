"""Writer of MJCF files that plain MuJoCo loads and replays as the MuJoCo backend does.

MuJoCo's public XML writer prints six significant digits and omits the compiled tables that the backend overwrites. This
module restores the digits from the editable model and adds the tables as custom numbers.
"""

import re
from collections.abc import Iterable, Iterator
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.flex import flex_table
from gauge_envs.backends.mujoco.model import START_KEY
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray, IntArray
from gauge_envs.scene.prescribed_motion import prescribed_motions
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S
from gauge_envs.tools.mjcf.drivers import DRIVER_PREFIX, driver_rows

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?")

TABLES = ("flex_stiffness", "flex_bending")
"""Compiled tables of a flex that the backend overwrites."""

SAME_TABLE = 1e-9
"""Relative difference below which a compiled table equals the backend's: sums in another order differ by rounding."""

KINDS = re.compile(
    r'<numeric name="(?P<name>[^"]+)/kinds" size="\d+" data="(?P<kinds>[^"]*)" />\s*'
    r'<numeric name="(?P=name)/kind" size="\d+" data="(?P<kind>[^"]*)" />'
)


# --- scenes ----------------------------------------------------------------------------------------------------------


def scene_mjcf_text(
    scene: Scene, name: str, frame_count: int, notes: Iterable[str] = ()
) -> str:
    """Return a scene as the text of an MJCF file.

    Args:
        scene: The scene.
        name: Name of the model, and of the scene in messages.
        frame_count: Frames of the motion of its driven bodies, including the first.
        notes: Lines of the comment at the top.
    """
    if scene.air is not None:
        raise UnsupportedSceneError(
            f"{name}: MJCF cannot express the air around the cloth: write a USD layer, or export without air"
        )
    simulation = BackendMuJoCo().build(scene)
    lines = [*notes, *start_notes(simulation)]
    if scene.deformables:
        lines += add_stiffness_tables(simulation)
    motions = prescribed_motions(scene, scene.duration_s)
    intervals = round(scene.duration_s / SAMPLE_INTERVAL_S)
    for driver, motion in zip(scene.drivers, motions, strict=True):
        rows = driver_rows(simulation, motion, intervals)
        moving = without_rest(rows)
        title = f"{DRIVER_PREFIX}{driver.body}"
        simulation.spec.add_numeric(
            name=title, size=moving.size, data=moving.ravel().tolist()
        )
        lines.append(
            replay_note(driver.body, driver.provenance, simulation, moving, len(rows))
        )
    lines += add_grips(simulation)
    return described_xml(simulation, name, lines)


# --- start velocities ------------------------------------------------------------------------------------------------


def start_notes(simulation: SimulationMuJoCo) -> list[str]:
    """Return instructions for a start with velocities; empty for a start at rest."""
    if not simulation.model.nkey:
        return []
    return [
        f"Start velocities: keyframe {START_KEY!r}. Call mj_resetDataKeyframe(model, data, key) with its id before the "
        "first step.",
    ]


# --- driven bodies ---------------------------------------------------------------------------------------------------


def without_rest(rows: FloatArray) -> FloatArray:
    """Return the rows of driven motion without the repetitions of the last row."""
    changes = np.flatnonzero((rows[1:] != rows[:-1]).any(axis=1))
    return rows[: changes[-1] + 2] if changes.size else rows[:1]


def replay_note(
    body: str,
    provenance: str,
    simulation: SimulationMuJoCo,
    rows: FloatArray,
    intervals: int,
) -> str:
    """Return instructions for replaying the rows of a driven body.

    Args:
        body: Name of the driven body.
        provenance: Provenance of its motion.
        simulation: The simulation that the file reproduces.
        rows: Rows of driven motion in the file, shape [row_count, 19].
        intervals: Number of intervals of the experiment.
    """
    steps = round(SAMPLE_INTERVAL_S / simulation.model.opt.timestep)
    return (
        f"Driven body {body!r} (motion: {provenance}): custom numeric 'driver/{body}' holds {len(rows)} rows of "
        f"{rows.shape[1]} numbers.\n    Before every {steps} steps write the next row: [0:7] to the qpos of free joint "
        f"{body!r}, [7:13] to its qvel,\n    [13:19] to xfrc_applied of body {body!r}; the last row again and again, "
        f"until {intervals} are written."
    )


def add_grips(simulation: SimulationMuJoCo) -> list[str]:
    """Add the nodes that move with driven bodies as custom numbers; return instructions for their use."""
    notes = []
    for grip in simulation.grips:
        ids = [simulation.model.body(name).id for name in grip.names]
        simulation.spec.add_numeric(name=f"grip/{grip.body}", size=len(ids), data=ids)
        notes.append(
            f"Nodes that move with {grip.body!r}: custom numeric 'grip/{grip.body}' holds the ids of their bodies."
            f"\n    After each row of {grip.body!r} write their qpos, qvel and xfrc_applied as assets/README.md says."
        )
    return notes


# --- compiled tables of deformable bodies ----------------------------------------------------------------------------


def add_stiffness_tables(simulation: SimulationMuJoCo) -> list[str]:
    """Add flex tables that MuJoCo does not compile from XML as custom numbers; return instructions for their use."""
    model = simulation.model
    plain = mujoco.MjModel.from_xml_string(
        ElementTree.tostring(exact_xml(simulation), encoding="unicode")
    )
    notes = []
    for index in range(model.nflex):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, index)
        for table in TABLES:
            values, compiled = (flex_table(one, table, index) for one in (model, plain))
            if np.allclose(
                values,
                compiled,
                rtol=0.0,
                atol=SAME_TABLE * np.abs(values).max(initial=0.0),
            ):
                continue
            values = values.reshape(_row_count(model, table, index), -1)
            title, start = f"{table}/{name}", int(getattr(model, f"{table}adr")[index])
            place, width = (
                f"model.{table}[{start} : {start + values.size}]",
                values.shape[1],
            )
            if table == "flex_bending":
                numbers: dict[str, NDArray[Any]] = {
                    "weight": _weights(values, compiled.reshape(values.shape))
                }
                recipe = (
                    f"Cloth {name!r}: weigh the folds about the diagonals of its mesh, after loading:\n"
                    f"        rows = {place}.reshape(-1, {width})\n"
                    f'        rows *= model.numeric("{title}/weight").data[:, None]'
                )
            else:
                first, kind = _distinct(values)
                numbers = {"kinds": values[first].ravel(), "kind": kind}
                recipe = (
                    f"Deformable body {name!r}: set the stiffness of each element, after loading:\n"
                    f'        kind = model.numeric("{title}/kind").data.astype(int)\n'
                    f'        kinds = model.numeric("{title}/kinds").data.reshape(-1, {width})\n'
                    f"        {place} = kinds[kind].ravel()"
                )
            notes.append(recipe)
            for part, data in numbers.items():
                simulation.spec.add_numeric(
                    name=f"{title}/{part}", size=data.size, data=data.tolist()
                )
    return notes


def _row_count(model: mujoco.MjModel, table: str, index: int) -> int:
    """Return the number of rows of a table of one flex, which has one row per edge, cell or element."""
    if table == "flex_bending":
        return int(model.flex_edgenum[index])
    return int(
        np.prod(model.flex_cellnum[index])
        if model.flex_interp[index]
        else model.flex_elemnum[index]
    )


def _distinct(rows: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the index of the first occurrence of each distinct row, and each row's number among the distinct rows."""
    _, first, kind = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[kind.ravel()]


def _weights(rows: FloatArray, compiled: FloatArray) -> FloatArray:
    """Return the factor on each compiled row that gives the desired row bit for bit."""
    largest = np.abs(compiled).argmax(axis=1)[:, None]
    wanted, given = (
        np.take_along_axis(one, largest, axis=1)[:, 0] for one in (rows, compiled)
    )
    weights = np.divide(wanted, given, out=np.ones(len(rows)), where=given != 0.0)
    for weight in np.unique(weights):
        weights[(compiled * weight == rows).all(axis=1)] = weight
    return weights


def expanded(text: str) -> str:
    """Return a file's text with all table rows written out, since bitwise equality of rows depends on the machine."""

    def rows(match: re.Match[str]) -> str:
        kind = [int(index) for index in match["kind"].split()]
        numbers = match["kinds"].split()
        width = len(numbers) // (max(kind) + 1)
        return "\n".join(
            " ".join(numbers[index * width : (index + 1) * width]) for index in kind
        )

    return KINDS.sub(rows, text)


# --- exact XML -------------------------------------------------------------------------------------------------------


def described_xml(simulation: SimulationMuJoCo, name: str, notes: Iterable[str]) -> str:
    """Return MuJoCo's XML with all digits, with the name of the model and a comment of some lines at the top."""
    root = exact_xml(simulation)
    root.set("model", name)
    comment = ElementTree.Comment("\n    " + "\n    ".join(notes) + "\n  ")
    comment.tail = "\n\n  "
    root.insert(0, comment)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def exact_xml(simulation: SimulationMuJoCo) -> ElementTree.Element:
    """Return MuJoCo's XML with all digits; MuJoCo's writer drops those after the sixth."""
    spec = simulation.spec
    root = ElementTree.fromstring(spec.to_xml())
    for element, source in _sources(root, spec):
        _restore_digits(element, source)
    if simulation.model.nflex:
        _shorten(root)
    for element in root.findall("custom/numeric"):
        element.set(
            "data", _digits(np.asarray(spec.numeric(element.get("name", "")).data))
        )
    return root


def _shorten(root: ElementTree.Element) -> None:
    """Make slides the default joint and write each point body on one line, since deformable bodies have hundreds."""
    for element in root.iter("joint"):
        if element.get("type") == "slide":
            del element.attrib["type"]
        else:
            element.set("type", element.get("type", "hinge"))
    for element in root.iter("body"):
        if element.find("joint") is not None and element.find("geom") is None:
            element.text = None
            for child in element:
                child.tail = None
    default = ElementTree.Element("default")
    default.tail = root[0].tail
    ElementTree.SubElement(default, "joint", type="slide")
    root.insert(1, default)


def _sources(
    root: ElementTree.Element, spec: mujoco.MjSpec
) -> Iterator[tuple[ElementTree.Element, Any]]:
    """Yield each element with numbers and its object in the editable model."""
    for element in root.findall("option"):
        yield element, spec.option
    # Elements that have a name.
    for path, find in (("asset/mesh", spec.mesh), ("tendon/spatial", spec.tendon)):
        for element in root.findall(path):
            yield element, find(element.get("name", ""))
    for element in root.findall("deformable/flex"):
        for part in (element, *element):
            yield part, spec.flex(element.get("name", ""))
    # Elements in the order of the editable model.
    ordered = {
        "contact/pair": spec.pairs,
        "keyframe/key": spec.keys,
        "equality/*": spec.equalities,
        "actuator/*": spec.actuators,
    }
    for path, objects in ordered.items():
        yield from zip(root.findall(path), objects, strict=True)
    for element in (*root.findall("worldbody"), *root.iter("body")):
        body = spec.body(element.get("name", "world"))
        yield element, body
        for inertial in element.findall("inertial"):
            yield inertial, body
        for tag, parts in (
            ("geom", body.geoms),
            ("joint", body.joints),
            ("site", body.sites),
        ):
            yield from zip(element.findall(tag), parts, strict=True)


ALIASES = {
    "mesh": {"vertex": "uservert"},
    "spatial": {"solreflimit": "solref_limit", "solimplimit": "solimp_limit"},
    "inertial": {"pos": "ipos", "diaginertia": "inertia"},
    "flex": {"vertex": "vert", "nodecoord": "node", "node": "nodebody"},
}
"""Attribute names of the editable model that differ from those of the XML, by XML element."""


def _restore_digits(element: ElementTree.Element, source: Any) -> None:
    """Replace the numbers of an element, which have six digits, by the exact numbers of the editable model."""
    aliases = ALIASES.get(element.tag, {})
    for key, text in element.items():
        exact = getattr(source, aliases.get(key, key), None)
        if exact is None or not NUMBER.fullmatch(text.split(" ")[0]):
            continue
        written = np.array(text.split(), dtype=np.float64)
        # MuJoCo omits trailing defaults.
        values = np.atleast_1d(
            np.asarray(
                exact, np.float32 if key == "vertex" and element.tag == "mesh" else None
            )
        )
        values = values[: written.size]
        # Deformable bodies have thousands of elements, and np.allclose takes most of the time.
        if (
            written.shape == values.shape
            and (np.abs(written - values) <= 1e-12 + 1e-5 * np.abs(values)).all()
        ):
            element.set(key, _digits(values))


def _digits(values: float | NDArray[Any]) -> str:
    """Return the shortest decimals that parse to the same numbers in their precision, which is single for meshes."""
    return " ".join(str(value).removesuffix(".0") for value in np.atleast_1d(values))
