"""A USD stage opened for reading: SI units with z up, typed values, and errors that name file and prim."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pxr import Ar, Gf, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdShade
from scipy.spatial.transform import Rotation

from gauge_envs.errors import AssetError
from gauge_envs.scene.geometry import Pose
from gauge_envs.scene.usd.layer import FOLLOWS, WRITTEN, FloatArray, digest, wxyz

__all__ = [
    "LARGEST",
    "Frame",
    "Source",
    "StoredValue",
    "single",
    "usd_reason",
    "vector",
]

SINGLE_RELATIVE = 3e-7
"""Numbers that differ by less, relative to the largest of them, agree in single precision."""

ORTHOGONAL = 1e-6
"""Cosine of an angle from which axes count as sheared, and relative difference from which scales count as unequal."""

SNAP = 1e-9
"""A scale this close to 1 is 1: what differs is the rounding of a product of rotations."""

UNIT_QUATERNION = 1e-3
"""A quaternion this close to unit length is normalized; another is an error."""

LARGEST = 1e30
"""Larger numbers are none of a scene; products of several of these are still finite."""

Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Turns a stage whose y axis points up: y becomes z, z becomes -y."""

SINGLES = ("float", "GfHalf", "GfVec3f", "GfQuatf", "VtArray<float>", "VtArray<GfVec3f>")
"""C++ types of single precision, or less."""


@dataclass(frozen=True, kw_only=True)
class Frame:
    """A prim's frame in the world, in SI units with z up; scale along its own axes, units included."""

    position_m: FloatArray
    quaternion: FloatArray
    scale: FloatArray

    @property
    def pose(self) -> Pose:
        """The frame without its scale."""
        w, x, y, z = self.quaternion.tolist()
        return Pose(position_m=vector(self.position_m), quaternion=(w, x, y, z))

    def moved(self, offset_m: FloatArray, rotation: FloatArray) -> Frame:
        """A frame fixed to this one at an offset [m] and turned by a matrix, both in unscaled axes of this one."""
        pose = self.pose
        combined = pose.rotation * Rotation.from_matrix(rotation)
        return Frame(
            position_m=pose.to_world(offset_m), quaternion=combined.as_quat(scalar_first=True), scale=self.scale
        )


@dataclass(frozen=True, kw_only=True)
class StoredValue:
    """A standard value in SI units.

    Attributes:
        place: Path of its attribute.
        raw: As stored, so that it can be compared with what was written.
        value: What it counts as: single precision as the shortest decimal that rounds to it, as it was typed.
    """

    place: str
    raw: FloatArray
    value: FloatArray


def single(values: FloatArray) -> FloatArray:
    """Numbers as single precision keeps them."""
    return np.asarray(values).astype(np.float32).astype(np.float64)


def vector(values: FloatArray) -> tuple[float, float, float]:
    """Three numbers as a scene keeps them."""
    x, y, z = values.tolist()
    return x, y, z


def usd_reason(error: Tf.ErrorException) -> str:
    """What USD says of an error of its own, first cause first."""
    try:
        return str(error.args[0].commentary).strip()
    except UnicodeDecodeError:
        # It quotes the file, which need not be text.
        return "it holds bytes that are no UTF-8 text"


class Source:
    """An opened stage.

    Args:
        path: File to open, of any kind that USD reads.

    Raises:
        AssetError: The file cannot be read, refers to files that cannot, is open in this process with edits that were
            not saved, or does not say its units and which way is up.
    """

    def __init__(self, path: Path) -> None:
        self.file = path
        self.stage = self._open()
        if not UsdGeom.StageHasAuthoredMetersPerUnit(self.stage):
            raise self.fault("", "metersPerUnit is not given, so no length is known")
        if not self.stage.HasAuthoredMetadata(UsdGeom.Tokens.upAxis):
            raise self.fault("", "upAxis is not given: Y or Z")
        self.metres = self._unit("metersPerUnit", UsdGeom.GetStageMetersPerUnit(self.stage))
        self.kilograms = self._unit("kilogramsPerUnit", UsdPhysics.GetStageKilogramsPerUnit(self.stage))
        up = UsdGeom.GetStageUpAxis(self.stage)
        if up not in (UsdGeom.Tokens.y, UsdGeom.Tokens.z):
            raise self.fault("", f"upAxis is {up!r}: Y or Z is expected")
        self.up: FloatArray = np.eye(3) if up == UsdGeom.Tokens.z else Y_UP
        self.rate = self._unit("timeCodesPerSecond", self.stage.GetTimeCodesPerSecond())
        self.start = self.stage.GetStartTimeCode()
        if not abs(self.start) <= LARGEST:
            raise self.fault("startTimeCode", f"is {self.start}: a finite number is expected")

    def _open(self) -> Usd.Stage:
        if not self.file.is_file():
            raise self.fault("", "there is no such file")
        try:
            stage = Usd.Stage.Open(str(self.file))
            for layer in stage.GetUsedLayers():
                if layer.anonymous:
                    continue
                if layer.dirty:
                    raise self.fault("", f"{layer.GetDisplayName()} is open in this process with edits: save them")
                # One that is still open elsewhere in this process may be older than its file.
                layer.Reload()
        except Tf.ErrorException as error:
            raise self.fault("", f"is no readable USD file: {usd_reason(error)}") from None
        broken = stage.GetCompositionErrors()
        if broken:
            raise self.fault("", str(broken[0]))
        return stage

    def _unit(self, name: str, value: float) -> float:
        if not 1.0 / LARGEST <= value <= LARGEST:
            raise self.fault("", f"{name} is {value}: a positive number is expected")
        return float(value)

    def fault(self, place: Usd.Object | Sdf.Path | str, reason: str) -> AssetError:
        """The error to raise for a place in the file."""
        path = place.GetPath() if isinstance(place, Usd.Object) else place
        return AssetError(self.file, str(path), reason)

    def used_files(self) -> tuple[Path, ...]:
        """Files beside its own that the stage is composed of, in the order of their paths relative to its own."""
        own = self.file.resolve()
        layers = [layer for layer in self.stage.GetUsedLayers() if not layer.anonymous]
        # A layer inside of a package is part of the package's file.
        files = {Path(Ar.SplitPackageRelativePathOuter(layer.realPath)[0]).resolve() for layer in layers} - {own}
        return tuple(sorted(files, key=lambda file: os.path.relpath(file, own.parent)))

    def prims(self) -> Iterator[Usd.Prim]:
        """Every active, defined prim in the stage's order, those inside of instances included."""
        return iter(Usd.PrimRange.Stage(self.stage, Usd.TraverseInstanceProxies()))

    # --- values ---

    def numbers(
        self, attribute: Usd.Attribute, shape: tuple[int, ...] = (), time: Usd.TimeCode | None = None
    ) -> FloatArray | None:
        """Numbers of an attribute; None where it has no value.

        Args:
            attribute: Any attribute, also one that does not exist.
            shape: Expected shape; -1 stands for any length.
            time: When; by default where there is no time.

        Raises:
            AssetError: It holds something else, or what is not finite.
        """
        value = attribute.Get(Usd.TimeCode.Default() if time is None else time) if attribute else None
        if value is None and attribute and time is None:
            value = attribute.Get(self.start)
        if value is None:
            return None
        array = _array(value)
        if array is not None and not array.size and -1 in shape:
            # An empty array of vectors has no width of its own.
            return np.zeros([max(length, 0) for length in shape])
        if array is None or len(array.shape) != len(shape) or not _fits(array.shape, shape):
            wanted = " x ".join("any" if n < 0 else str(n) for n in shape)
            raise self.fault(
                attribute, f"holds {value!r}: {f'{wanted} numbers are' if shape else 'a number is'} expected"
            )
        if not (np.abs(array) <= LARGEST).all():
            raise self.fault(attribute, f"holds {value}: finite numbers, none above {LARGEST:g}, are expected")
        return array

    def number(self, attribute: Usd.Attribute) -> float | None:
        """A number; None where there is none. Raises as `numbers`."""
        array = self.numbers(attribute)
        return None if array is None else float(array)

    def text(self, attribute: Usd.Attribute, known: Sequence[str] = ()) -> str | None:
        """A string or token; None where there is none.

        Raises:
            AssetError: It holds something else, or none of the known ones.
        """
        value = attribute.Get() if attribute else None
        if value is None:
            return None
        if not isinstance(value, str) or (known and value not in known):
            expected = f"one of {', '.join(known)}" if known else "a text"
            raise self.fault(attribute, f"holds {value!r}: {expected} is expected")
        return value

    def flag(self, attribute: Usd.Attribute, *, default: bool) -> bool:
        """A truth value. Raises AssetError where it is something else."""
        value = attribute.Get() if attribute else None
        if value is None:
            return default
        if not isinstance(value, bool):
            raise self.fault(attribute, f"holds {value!r}: true or false is expected")
        return value

    def reading(
        self,
        attribute: Usd.Attribute,
        shape: tuple[int, ...] = (),
        convert: Callable[[FloatArray], FloatArray] = lambda values: values,
    ) -> StoredValue | None:
        """An authored standard value in SI units; None where it is not authored.

        Args:
            attribute: Where it stands.
            shape: As of `numbers`.
            convert: From the stage's units to SI.
        """
        if not attribute or not attribute.HasAuthoredValue():
            return None
        raw = self.numbers(attribute, shape)
        if raw is None:
            return None
        is_single = attribute.GetTypeName().cppTypeName in SINGLES
        return StoredValue(
            place=str(attribute.GetPath()), raw=convert(raw), value=convert(_decimals(raw) if is_single else raw)
        )

    def counted(
        self,
        gauge: Usd.Attribute,
        readings: Sequence[StoredValue | None],
        shape: tuple[int, ...] = (),
        rounded: Callable[[FloatArray], FloatArray] = single,
    ) -> FloatArray | None:
        """The value that counts of one that stands twice: the edited one.

        The double counts while its standard counterparts are as they were written beside it; one that was edited
        counts in its place, in an array element by element. Without a double the standard value counts, and without
        a standard value the double.

        Args:
            gauge: The double; need not exist.
            readings: Standard values of the same quantity.
            shape: As of `numbers`.
            rounded: What the writer makes of the double for the standard attribute.

        Returns:
            The value, or None where it stands nowhere.

        Raises:
            AssetError: Both were edited and disagree; names both.
        """
        own, present = self.numbers(gauge, shape), [reading for reading in readings if reading is not None]
        if own is None or not present:
            return own if own is not None else self._agreed(present).value if present else None
        written = gauge.GetCustomDataByKey(WRITTEN)
        if written is None:
            disagree = next((one for one in present if not _agree(rounded(own), one.raw)), None)
            if disagree is not None:
                raise self._both(gauge, own, disagree, "nothing tells which of the two was edited")
            return own
        edited = [reading for reading in present if not _is(reading.raw, written)]
        if not edited:
            return own
        standard = self._agreed(edited)
        if not _is(rounded(own), written) and not _near(rounded(own), written):
            if not _agree(rounded(own), standard.raw):
                raise self._both(gauge, own, standard, "both were edited")
            return own
        if standard.raw.shape != own.shape:
            return standard.value
        return np.where(rounded(own) == standard.raw, own, standard.value)

    def _both(self, gauge: Usd.Attribute, own: FloatArray, other: StoredValue, why: str) -> AssetError:
        return self.fault(
            gauge,
            f"is {_shown(own)} and {other.place} {_shown(other.value)}: {why}; make them agree, or delete the first",
        )

    def _agreed(self, readings: Sequence[StoredValue]) -> StoredValue:
        first = readings[0]
        for other in readings[1:]:
            if not _agree(first.raw, other.raw):
                raise self.fault(
                    first.place, f"is {_shown(first.value)} and {other.place} {_shown(other.value)}: they must agree"
                )
        return first

    def check_followers(self, prim: Usd.Prim) -> None:
        """See that what is computed from other attributes was not edited itself.

        Raises:
            AssetError: It was; names what to edit in its place.
        """
        for attribute in prim.GetAuthoredAttributes():
            follows = attribute.GetCustomDataByKey(FOLLOWS)
            if follows is not None:
                value, written = attribute.Get(), attribute.GetCustomDataByKey(WRITTEN)
                array = None if value is None else _array(value)
                if array is not None and not _is(array, written):
                    raise self.fault(attribute, f"was edited, but it follows from {follows}: edit that")

    def material(self, prim: Usd.Prim) -> Usd.Prim | None:
        """The physics material that is bound to a prim, directly or above it; None where there is none."""
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        return material.GetPrim() if material and material.GetPrim().HasAPI(UsdPhysics.MaterialAPI) else None

    def is_rigid(self, prim: Usd.Prim) -> bool:
        """Whether a prim is an enabled rigid body of UsdPhysics."""
        enabled = UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr()
        return bool(prim.HasAPI(UsdPhysics.RigidBodyAPI)) and self.flag(enabled, default=True)

    def body_of(self, prim: Usd.Prim) -> Usd.Prim | None:
        """The rigid body that a prim belongs to: the nearest one above it, or itself; None where there is none."""
        while prim and not prim.IsPseudoRoot():
            if self.is_rigid(prim) or prim.HasAttribute("gauge:name"):
                return prim
            prim = prim.GetParent()
        return None

    # --- frames ---

    def seconds(self, code: float) -> float:
        """Time since the start of the stage [s]."""
        return (code - self.start) / self.rate

    def sample_codes(self, prim: Usd.Prim) -> list[float]:
        """Time codes at which the transform of a prim, or of one above it, has samples; ascending."""
        codes: set[float] = set()
        for one in self._chain(prim):
            for op in UsdGeom.Xformable(one).GetOrderedXformOps():
                codes.update(op.GetTimeSamples())
        return sorted(codes)

    def frame(self, prim: Usd.Prim, time: Usd.TimeCode) -> Frame:
        """Frame of a prim in the world at a time.

        Raises:
            AssetError: It is sheared, scaled to nothing, or not finite.
        """
        chain = self._chain(prim)
        ops = UsdGeom.Xformable(chain[-1]).GetOrderedXformOps() if chain and chain[-1] == prim else []
        kinds = [UsdGeom.XformOp.TypeTranslate, UsdGeom.XformOp.TypeOrient]
        above = self._product(chain[:-1], time)
        is_plain = self.metres == 1.0 and np.array_equal(self.up, np.eye(3)) and np.array_equal(above, np.eye(4))
        if is_plain and [op.GetOpType() for op in ops] == kinds and not any(op.IsInverseOp() for op in ops):
            # To the bit as written: a way through matrices would lose the last digits.
            position = self._op_value(ops[0], (3,), time, np.zeros(3))
            return Frame(position_m=position, quaternion=self._quaternion(ops[1], time), scale=np.ones(3))
        matrix = self._product(chain, time)
        rotation, scale = self.decomposed(prim, self.metres * self.up @ matrix[:3, :3])
        relative = scale / self.metres
        scale = np.where(np.abs(np.abs(relative) - 1.0) < SNAP, np.sign(relative) * self.metres, scale)
        quaternion = Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)
        return Frame(position_m=self.metres * (self.up @ matrix[:3, 3]), quaternion=quaternion, scale=scale)

    def to_world(self, prim: Usd.Prim, points: FloatArray) -> FloatArray:
        """Points in a prim's own space, shape [..., 3], in the world [m]."""
        matrix = self._product(self._chain(prim), Usd.TimeCode(self.start))
        return self.world_m(points @ matrix[:3, :3].T + matrix[:3, 3])

    def world_m(self, points: FloatArray) -> FloatArray:
        """Points of the stage's world, shape [..., 3], in metres with z up."""
        if self.metres == 1.0 and np.array_equal(self.up, np.eye(3)):
            return points
        return self.metres * points @ self.up.T

    def below(self, body: Usd.Prim, prim: Usd.Prim) -> FloatArray:
        """Transform from a prim's space to that of a prim above it, or its own, in the stage's units, shape [4, 4].

        Raises:
            AssetError: It moves between the two.
        """
        chain = [one for one in self._chain(prim) if one.GetPath().HasPrefix(body.GetPath()) and one != body]
        depth = prim.GetPath().pathElementCount - body.GetPath().pathElementCount
        for one in chain:
            if any(op.MightBeTimeVarying() for op in UsdGeom.Xformable(one).GetOrderedXformOps()):
                raise self.fault(one, f"moves within its body {body.GetPath()}: bodies are rigid")
        if depth and UsdGeom.Xformable(prim) and UsdGeom.Xformable(prim).GetResetXformStack():
            raise self.fault(prim, f"resets its transform, but belongs to the body {body.GetPath()}")
        return self._product(chain, Usd.TimeCode(self.start))

    def decomposed(self, prim: Usd.Prim, matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A linear map as a rotation after a scale along the axes: rotation [3, 3] and scale [3].

        Raises:
            AssetError: It is sheared, or scales to nothing.
        """
        scale = np.sqrt(np.square(matrix).sum(axis=0))
        if not np.isfinite(matrix).all() or not (scale > 0.0).all():
            raise self.fault(prim, f"its transform scales by {_shown(scale)}: positive numbers are expected")
        rotation = matrix / scale
        if np.linalg.det(rotation) < 0.0:
            rotation, scale = rotation * [-1.0, 1.0, 1.0], scale * [-1.0, 1.0, 1.0]
        if np.abs(rotation.T @ rotation - np.eye(3)).max() > ORTHOGONAL:
            raise self.fault(prim, "its transform is sheared: a rigid body cannot be")
        return rotation, scale

    def _chain(self, prim: Usd.Prim) -> list[Usd.Prim]:
        """Prims whose transforms lead to a prim, outermost first."""
        chain: list[Usd.Prim] = []
        while prim and not prim.IsPseudoRoot():
            xformable = UsdGeom.Xformable(prim)
            if xformable:
                chain.insert(0, prim)
                if xformable.GetResetXformStack():
                    break
            prim = prim.GetParent()
        return chain

    def _product(self, chain: Sequence[Usd.Prim], time: Usd.TimeCode) -> FloatArray:
        matrix = np.eye(4)
        for prim in chain:
            for op in UsdGeom.Xformable(prim).GetOrderedXformOps():
                matrix = matrix @ self._op_matrix(op, time)
        return matrix

    def _op_matrix(self, op: UsdGeom.XformOp, time: Usd.TimeCode) -> FloatArray:
        if op.GetOpType() != UsdGeom.XformOp.TypeOrient:
            # USD's vectors are rows.
            matrix = np.array(op.GetOpTransform(time)).T
            if not (np.abs(matrix) <= LARGEST).all():
                raise self.fault(op.GetAttr(), f"is not finite, or above {LARGEST:g}")
            return matrix
        rotation = Rotation.from_quat(self._quaternion(op, time), scalar_first=True)
        matrix = np.eye(4)
        matrix[:3, :3] = (rotation.inv() if op.IsInverseOp() else rotation).as_matrix()
        return matrix

    def _op_value(
        self, op: UsdGeom.XformOp, shape: tuple[int, ...], time: Usd.TimeCode, default: FloatArray
    ) -> FloatArray:
        value = self.numbers(op.GetAttr(), shape, time)
        return default if value is None else value

    def _quaternion(self, op: UsdGeom.XformOp, time: Usd.TimeCode) -> FloatArray:
        quaternion = self._op_value(op, (4,), time, np.array([1.0, 0.0, 0.0, 0.0]))
        length = float(np.linalg.norm(quaternion))
        if abs(length - 1.0) < 1e-12:
            return quaternion
        if abs(length - 1.0) > UNIT_QUATERNION:
            raise self.fault(op.GetAttr(), f"holds {_shown(quaternion)}, which is no unit quaternion")
        return quaternion / length


def _array(value: Any) -> FloatArray | None:
    """A value of USD as numbers; None where it is none."""
    if isinstance(value, Gf.Quatd | Gf.Quatf | Gf.Quath):
        return wxyz(value)
    if isinstance(value, str | bool):
        return None
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None


def _fits(shape: tuple[int, ...], expected: tuple[int, ...]) -> bool:
    return all(wanted < 0 or wanted == n for n, wanted in zip(shape, expected, strict=True))


def _decimals(values: FloatArray) -> FloatArray:
    """Single-precision numbers as the shortest decimals that round to them."""
    flat = [float(str(number)) for number in np.asarray(values, dtype=np.float32).ravel()]
    return np.array(flat).reshape(values.shape)


def _is(values: ArrayLike, written: Any) -> bool:
    """Whether a standard value is as written, to the bit, or to nine decimals where a digest stands for an array."""
    if isinstance(written, str):
        return digest(values) == written
    as_written = None if written is None else _array(written)
    return as_written is not None and np.array_equal(values, as_written)


def _near(values: FloatArray, written: Any) -> bool:
    """Whether numbers are as written in single precision."""
    as_written = None if isinstance(written, str) else _array(written)
    return as_written is not None and as_written.shape == values.shape and _agree(values, as_written)


def _agree(one: FloatArray, other: FloatArray) -> bool:
    if one.shape != other.shape:
        return False
    size = float(np.abs(one).max(initial=0.0))
    return bool(np.abs(one - other).max(initial=0.0) <= SINGLE_RELATIVE * size)


def _shown(values: FloatArray) -> str:
    listed = np.asarray(values).ravel().tolist()
    text = ", ".join(f"{number:.9g}" for number in listed[:4])
    return f"({text}{', ...' if len(listed) > 4 else ''})" if len(listed) > 1 else text
