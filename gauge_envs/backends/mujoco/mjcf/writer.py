"""Writer of MJCF files that plain MuJoCo loads and replays as the MuJoCo backend does.

MuJoCo's public XML writer prints six significant digits and omits the compiled tables that the backend overwrites. This
module restores the digits from the editable model and adds the tables as custom numbers.
"""

from collections.abc import Iterable, Iterator
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import NDArray

from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.cloth import ClothPartMuJoCo
from gauge_envs.backends.mujoco.flex import flex_table
from gauge_envs.backends.mujoco.model import START_KEY
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.errors import UnsupportedSceneError
from gauge_envs.scene import Scene
from gauge_envs.scene.geometry import FloatArray
from gauge_envs.scene.prescribed_motion import PrescribedMotion, prescribed_motions
from gauge_envs.scene.timing import SAMPLE_INTERVAL_S

DRIVER_PREFIX = "driver/"
"""Prefix of the custom numeric with the motion of a driven body; the name of the body follows."""

DRIVER_COLUMNS = 19
"""Number of columns of driven motion: qpos 7, qvel 6, xfrc_applied 6."""

TABLE_TOLERANCE = 1e-9
"""Relative difference below which a compiled table equals the backend's: sums in another order differ by rounding."""


def scene_mjcf_text(
    scene: Scene, name: str, frame_count: int, notes: Iterable[str] = ()
) -> str:
    """Return a scene as the text of an MJCF file.

    Args:
        scene: The scene.
        name: Name of the model, and of the scene in messages.
        frame_count: Frames of the motion of its driven bodies, including the first.
        notes: Lines of the comment at the top.

    Raises:
        UnsupportedSceneError: The scene has air.
    """
    if scene.air is not None:
        raise UnsupportedSceneError(
            f"{name}: MJCF cannot express the air around the cloth: write a USD layer, or export without air"
        )
    simulation = BackendMuJoCo().build(scene)
    comment = [*notes]
    if simulation.model.nkey:
        comment.append(
            f"Start velocities: keyframe {START_KEY!r}. Call mj_resetDataKeyframe(model, data, key) with its id "
            "before the first step."
        )
    if scene.deformables:
        comment += _add_flex_tables(simulation)
    comment += _add_drivers(simulation, scene)
    for grip in simulation.grips:
        ids = [simulation.model.body(node).id for node in grip.names]
        _add_numeric(simulation, f"grip/{grip.body}", ids)
        comment.append(
            f"Nodes that move with {grip.body!r}: custom numeric 'grip/{grip.body}' holds the ids of their bodies."
            f"\n    After each row of {grip.body!r} write their qpos, qvel and xfrc_applied as assets/README.md says."
        )
    root = _exact_xml(simulation)
    root.set("model", name)
    element = ElementTree.Comment("\n    " + "\n    ".join(comment) + "\n  ")
    element.tail = "\n\n  "
    root.insert(0, element)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _add_numeric(
    simulation: SimulationMuJoCo, name: str, values: Iterable[float]
) -> None:
    data = [*values]
    simulation.spec.add_numeric(name=name, size=len(data), data=data)


# --- driven bodies ---------------------------------------------------------------------------------------------------


def driver_rows(
    simulation: SimulationMuJoCo, motion: PrescribedMotion, count: int
) -> FloatArray:
    """Return the numbers that the backend writes to drive a body, interval by interval.

    Args:
        simulation: A simulation of the scene; its driven body moves.
        motion: Motion of the driven body.
        count: Number of intervals.

    Returns:
        qpos (7), qvel (6) and xfrc_applied (6) before each interval, shape [count, 19].
    """
    data = simulation.data
    joint, body = data.joint(motion.body), data.body(motion.body)
    zero_action = np.zeros((1, motion.motion_count))
    rows = np.empty((count, DRIVER_COLUMNS))
    for interval in range(count):
        simulation.drive(motion.body, motion.targets(interval, zero_action)[0])
        rows[interval] = np.concatenate([joint.qpos, joint.qvel, body.xfrc_applied])
    return rows


def _add_drivers(simulation: SimulationMuJoCo, scene: Scene) -> Iterator[str]:
    """Add the motion of driven bodies as custom numbers; yield instructions for replaying it."""
    intervals = round(scene.duration_s / SAMPLE_INTERVAL_S)
    steps = round(SAMPLE_INTERVAL_S / simulation.model.opt.timestep)
    motions = prescribed_motions(scene, scene.duration_s)
    for driver, motion in zip(scene.drivers, motions, strict=True):
        body = driver.body
        rows = driver_rows(simulation, motion, intervals)
        # The last row holds until the end, so repetitions of it are left out.
        changes = np.flatnonzero((rows[1:] != rows[:-1]).any(axis=1))
        rows = rows[: changes[-1] + 2] if changes.size else rows[:1]
        _add_numeric(simulation, f"{DRIVER_PREFIX}{body}", rows.ravel().tolist())
        yield (
            f"Driven body {body!r} (motion: {driver.provenance}): custom numeric 'driver/{body}' holds {len(rows)} "
            f"rows of {rows.shape[1]} numbers.\n    Before every {steps} steps write the next row: [0:7] to the qpos "
            f"of free joint {body!r}, [7:13] to its qvel,\n    [13:19] to xfrc_applied of body {body!r}; the last row "
            f"again and again, until {intervals} are written."
        )


# --- compiled tables of deformable bodies ----------------------------------------------------------------------------


def _add_flex_tables(simulation: SimulationMuJoCo) -> Iterator[str]:
    """Add flex tables that MuJoCo does not compile from XML as custom numbers; yield instructions for their use."""
    model = simulation.model
    plain = mujoco.MjModel.from_xml_string(
        ElementTree.tostring(_exact_xml(simulation), encoding="unicode")
    )
    for index in range(model.nflex):
        body = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, index)
        for table, row_count in _row_counts(model, index).items():
            values = flex_table(model, table, index)
            compiled = flex_table(plain, table, index)
            tolerance = TABLE_TOLERANCE * np.abs(values).max(initial=0.0)
            if np.allclose(values, compiled, rtol=0.0, atol=tolerance):
                continue
            start = int(getattr(model, f"{table}adr")[index])
            place = f"model.{table}[{start} : {start + values.size}]"
            title = f"{table}/{body}"
            rows = values.reshape(row_count, -1)
            part = simulation.parts[body]
            if table == "flex_bending" and isinstance(part, ClothPartMuJoCo):
                weights = part.fold_weights(model).tolist()
                _add_numeric(simulation, f"{title}/weight", weights)
                yield (
                    f"Cloth {body!r}: weigh the folds about the diagonals of its mesh, after loading:\n"
                    f"        rows = {place}.reshape(-1, {rows.shape[1]})\n"
                    f'        rows *= model.numeric("{title}/weight").data[:, None]'
                )
            else:
                numbers: dict[bytes, int] = {}
                kind = [numbers.setdefault(row.tobytes(), len(numbers)) for row in rows]
                _, first = np.unique(kind, return_index=True)
                _add_numeric(simulation, f"{title}/kinds", rows[first].ravel().tolist())
                _add_numeric(simulation, f"{title}/kind", kind)
                yield (
                    f"Deformable body {body!r}: set the stiffness of each element, after loading:\n"
                    f'        kind = model.numeric("{title}/kind").data.astype(int)\n'
                    f'        kinds = model.numeric("{title}/kinds").data.reshape(-1, {rows.shape[1]})\n'
                    f"        {place} = kinds[kind].ravel()"
                )


def _row_counts(model: mujoco.MjModel, index: int) -> dict[str, int]:
    """Return the number of rows of the tables of a flex: one per cell or element, and one per edge."""
    elements = model.flex_elemnum[index]
    cells = np.prod(model.flex_cellnum[index])
    return {
        "flex_stiffness": int(cells if model.flex_interp[index] else elements),
        "flex_bending": int(model.flex_edgenum[index]),
    }


# --- exact XML -------------------------------------------------------------------------------------------------------

LISTS = {
    "asset/mesh": "meshes",
    "tendon/spatial": "tendons",
    "deformable/flex": "flexes",
    "contact/pair": "pairs",
    "keyframe/key": "keys",
    "equality/*": "equalities",
    "actuator/*": "actuators",
}
"""Lists of the editable model that have the order of the elements, by the path of the elements."""

ALIASES = {
    "mesh": {"vertex": "uservert"},
    "spatial": {"solreflimit": "solref_limit", "solimplimit": "solimp_limit"},
    "inertial": {"pos": "ipos", "diaginertia": "inertia"},
    "flex": {"vertex": "vert", "nodecoord": "node", "node": "nodebody"},
}
"""Attribute names of the editable model that differ from those of the XML, by XML element."""


def _exact_xml(simulation: SimulationMuJoCo) -> ElementTree.Element:
    """Return MuJoCo's XML with all digits; MuJoCo's writer drops all digits after the sixth."""
    root = ElementTree.fromstring(simulation.spec.to_xml())
    for element, source in _sources(root, simulation.spec):
        _restore_digits(element, source)
    if simulation.model.nflex:
        _shorten(root)
    numerics = simulation.spec.numerics
    for element, numeric in zip(root.findall("custom/numeric"), numerics, strict=True):
        element.set("data", _digits(np.asarray(numeric.data)))
    return root


def _sources(
    root: ElementTree.Element, spec: mujoco.MjSpec
) -> Iterator[tuple[ElementTree.Element, Any]]:
    """Yield each element with numbers and its object in the editable model."""
    for element in root.findall("option"):
        yield element, spec.option
    for path, name in LISTS.items():
        for element, source in zip(
            root.findall(path), getattr(spec, name), strict=True
        ):
            yield element, source
            # The contact, edges and elasticity of a flex are elements inside of it.
            yield from ((part, source) for part in element)
    for element in (*root.findall("worldbody"), *root.iter("body")):
        body = spec.body(element.get("name", "world"))
        yield element, body
        yield from ((inertial, body) for inertial in element.findall("inertial"))
        for tag in ("geom", "joint", "site"):
            yield from zip(element.findall(tag), getattr(body, f"{tag}s"), strict=True)


def _restore_digits(element: ElementTree.Element, source: Any) -> None:
    """Replace the numbers of an element, which have six digits, by the exact numbers of the editable model."""
    aliases = ALIASES.get(element.tag, {})
    for key, text in element.items():
        exact = getattr(source, aliases.get(key, key), None)
        if exact is None or isinstance(exact, str):
            continue
        try:
            written = np.array(text.split(), dtype=np.float64)
        except ValueError:
            # These are words, such as `true` or names.
            continue
        is_mesh = element.tag == "mesh" and key == "vertex"
        # MuJoCo omits trailing defaults.
        values = np.atleast_1d(np.asarray(exact, np.float32 if is_mesh else None))
        values = values[: written.size]
        # Deformable bodies have thousands of elements, and np.allclose takes most of the time.
        if (
            written.shape == values.shape
            and (np.abs(written - values) <= 1e-12 + 1e-5 * np.abs(values)).all()
        ):
            element.set(key, _digits(values))


def _digits(values: NDArray[Any]) -> str:
    """Return the shortest decimals that parse to the same numbers in their precision, which is single for meshes."""
    return " ".join(str(value).removesuffix(".0") for value in values)


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
