"""Access to an opened USD stage: SI units with z up, typed values, and errors with file and prim."""

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
from gauge_envs.scene.geometry import FloatArray, Pose, length_of, vector
from gauge_envs.tools.usd.layer import FOLLOWS, WRITTEN, digest, wxyz

SINGLE_RELATIVE = 3e-7
"""Largest difference, relative to the largest number, at which numbers agree in single precision."""

ORTHOGONAL = 1e-6
"""Smallest cosine of the angle between axes at which a transform counts as sheared."""

SNAP = 1e-9
"""Largest deviation of a scale from 1 that counts as rounding of a product of rotations."""

UNIT_QUATERNION = 1e-3
"""Largest deviation of a quaternion from unit length that is normalized; a larger one is an error."""

LARGEST = 1e30
"""Largest valid number; products of several such numbers are finite."""

Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation of a stage with y up: y becomes z, z becomes -y."""

SINGLES = (
    "float",
    "GfHalf",
    "GfVec3f",
    "GfQuatf",
    "VtArray<float>",
    "VtArray<GfVec3f>",
)
"""C++ types with single precision or less."""


@dataclass(frozen=True, kw_only=True)
class Frame:
    """A prim's frame in the world, in SI units with z up; its scale is along its own axes and includes units."""

    position_m: FloatArray
    quaternion: FloatArray
    scale: FloatArray

    @property
    def pose(self) -> Pose:
        """The frame without its scale."""
        w, x, y, z = self.quaternion.tolist()
        return Pose(position_m=vector(self.position_m), quaternion=(w, x, y, z))

    def moved(self, offset_m: FloatArray, rotation: FloatArray) -> Frame:
        """Return a frame that is displaced [m] and rotated in the unscaled axes of this frame."""
        pose = self.pose
        combined = pose.rotation * Rotation.from_matrix(rotation)
        return Frame(
            position_m=pose.to_world(offset_m),
            quaternion=combined.as_quat(scalar_first=True),
            scale=self.scale,
        )


@dataclass(frozen=True, kw_only=True)
class StoredValue:
    """Value of a standard attribute in SI units.

    Attributes:
        place: Path of the attribute.
        raw: The stored value, for comparison with the written value.
        value: The value to use. A single-precision number becomes the shortest decimal that rounds to it.
    """

    place: str
    raw: FloatArray
    value: FloatArray


def single(values: FloatArray) -> FloatArray:
    """Return numbers rounded to single precision."""
    return np.asarray(values).astype(np.float32).astype(np.float64)


def usd_reason(error: Tf.ErrorException) -> str:
    """Return the message of an error of USD, first cause first."""
    try:
        return str(error.args[0].commentary).strip()
    except UnicodeDecodeError:
        # The message quotes the file, which may contain any bytes.
        return "it holds bytes that are not UTF-8 text"


class Source:
    """An opened stage.

    Args:
        path: File to open, of any kind that USD reads.
    """

    def __init__(self, path: Path) -> None:
        self.file = path
        self.stage = self._open()
        if not UsdGeom.StageHasAuthoredMetersPerUnit(self.stage):
            raise self.fault(
                "", "metersPerUnit is not given, so no length is known: set it"
            )
        if not self.stage.HasAuthoredMetadata(UsdGeom.Tokens.upAxis):
            raise self.fault("", "upAxis is not given: set Y or Z")
        self.metres = self._unit(
            "metersPerUnit", UsdGeom.GetStageMetersPerUnit(self.stage)
        )
        self.kilograms = self._unit(
            "kilogramsPerUnit", UsdPhysics.GetStageKilogramsPerUnit(self.stage)
        )
        up = UsdGeom.GetStageUpAxis(self.stage)
        if up not in (UsdGeom.Tokens.y, UsdGeom.Tokens.z):
            raise self.fault("", f"upAxis is {up!r}: Y or Z is expected")
        self.up: FloatArray = np.eye(3) if up == UsdGeom.Tokens.z else Y_UP
        self.rate = self._unit("timeCodesPerSecond", self.stage.GetTimeCodesPerSecond())
        self.start = self.stage.GetStartTimeCode()
        if not abs(self.start) <= LARGEST:
            raise self.fault(
                "startTimeCode", f"is {self.start}: a finite number is expected"
            )

    def _open(self) -> Usd.Stage:
        if not self.file.is_file():
            raise self.fault("", "there is no such file")
        try:
            stage = Usd.Stage.Open(str(self.file))
            for layer in stage.GetUsedLayers():
                if layer.anonymous:
                    continue
                if layer.dirty:
                    raise self.fault(
                        "",
                        f"{layer.GetDisplayName()} is open in this process with edits: save them",
                    )
                # A layer that is already open in this process may be older than its file.
                layer.Reload()
        except Tf.ErrorException as error:
            raise self.fault(
                "", f"is not a readable USD file: {usd_reason(error)}"
            ) from None
        broken = stage.GetCompositionErrors()
        if broken:
            raise self.fault("", str(broken[0]))
        return stage

    def _unit(self, name: str, value: float) -> float:
        if not 1.0 / LARGEST <= value <= LARGEST:
            raise self.fault("", f"{name} is {value}: a positive number is expected")
        return float(value)

    def fault(self, place: Usd.Object | Sdf.Path | str, reason: str) -> AssetError:
        """Return the error to raise for a prim, attribute or path of the file."""
        path = place.GetPath() if isinstance(place, Usd.Object) else place
        return AssetError(self.file, str(path), reason)

    def used_files(self) -> tuple[Path, ...]:
        """Return the other files of the stage, sorted by their path relative to the main file."""
        main = self.file.resolve()
        layers = [layer for layer in self.stage.GetUsedLayers() if not layer.anonymous]
        # A layer in a package belongs to the package's file.
        files = {
            Path(Ar.SplitPackageRelativePathOuter(layer.realPath)[0]).resolve()
            for layer in layers
        } - {main}
        return tuple(sorted(files, key=lambda file: os.path.relpath(file, main.parent)))

    def prims(self) -> Iterator[Usd.Prim]:
        """Return an iterator over all active, defined prims in the stage's order, including prims in instances."""
        return iter(Usd.PrimRange.Stage(self.stage, Usd.TraverseInstanceProxies()))

    # --- values ---

    def numbers(
        self,
        attribute: Usd.Attribute,
        shape: tuple[int, ...] = (),
        time: Usd.TimeCode | None = None,
    ) -> FloatArray | None:
        """Return the numbers of an attribute, or None if it has no value.

        Args:
            attribute: The attribute; it need not exist.
            shape: Expected shape; -1 stands for any length.
            time: Time code; the default value by default, then the value at the start.
        """
        value = (
            attribute.Get(Usd.TimeCode.Default() if time is None else time)
            if attribute
            else None
        )
        if value is None and attribute and time is None:
            value = attribute.Get(self.start)
        if value is None:
            return None
        array = _array(value)
        if array is not None and not array.size and -1 in shape:
            # An empty array of vectors has no width of its own.
            return np.zeros([max(length, 0) for length in shape])
        sizes = array.shape if array is not None and array.ndim == len(shape) else None
        if (
            array is None
            or sizes is None
            or any(n not in (-1, m) for n, m in zip(shape, sizes, strict=True))
        ):
            wanted = " x ".join("any" if n < 0 else str(n) for n in shape)
            raise self.fault(
                attribute,
                f"holds {value!r}: {f'{wanted} numbers are' if shape else 'a number is'} expected",
            )
        if not (np.abs(array) <= LARGEST).all():
            raise self.fault(
                attribute,
                f"holds {value}: finite numbers, none above {LARGEST:g}, are expected",
            )
        return array

    def number(self, attribute: Usd.Attribute) -> float | None:
        """Return the number of an attribute, or None if it has no value; errors as in `numbers`."""
        array = self.numbers(attribute)
        return None if array is None else float(array)

    def text(self, attribute: Usd.Attribute, known: Sequence[str] = ()) -> str | None:
        """Return the string or token of an attribute, or None if it has no value."""
        value = attribute.Get() if attribute else None
        if value is None:
            return None
        if not isinstance(value, str) or (known and value not in known):
            expected = f"one of {', '.join(known)}" if known else "a text"
            raise self.fault(attribute, f"holds {value!r}: {expected} is expected")
        return value

    def flag(self, attribute: Usd.Attribute, *, default: bool) -> bool:
        """Return the boolean of an attribute, or the default if it has no value."""
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
        """Return an authored standard value in SI units, or None if the attribute has no authored value.

        Args:
            attribute: The standard attribute.
            shape: Expected shape as in `numbers`.
            convert: Conversion from the stage's units to SI units.
        """
        if not attribute or not attribute.HasAuthoredValue():
            return None
        raw = self.numbers(attribute, shape)
        if raw is None:
            return None
        is_single = attribute.GetTypeName().cppTypeName in SINGLES
        return StoredValue(
            place=str(attribute.GetPath()),
            raw=convert(raw),
            value=convert(_decimals(raw) if is_single else raw),
        )

    def counted(
        self,
        gauge: Usd.Attribute,
        readings: Sequence[StoredValue | None],
        shape: tuple[int, ...] = (),
        rounded: Callable[[FloatArray], FloatArray] = single,
    ) -> FloatArray | None:
        """Return the edited one of two values of a quantity: a `gauge:` double and its standard attributes.

        The double counts if its standard counterparts have their written values. An edited standard value replaces the
        double, element by element in an array. If only one of both exists, it counts.

        Args:
            gauge: The double; it need not exist.
            readings: Standard values of the same quantity.
            shape: Expected shape as in `numbers`.
            rounded: Conversion of the double to the standard attribute, as in the writer.

        Returns:
            The value, or None if neither exists.
        """
        double = self.numbers(gauge, shape)
        present = [reading for reading in readings if reading is not None]
        if not present:
            return double
        if double is None:
            return self._agreed(present).value
        as_single = rounded(double)
        written = gauge.GetCustomDataByKey(WRITTEN)
        if written is None:
            for reading in present:
                self._check_agree(
                    gauge,
                    double,
                    as_single,
                    reading,
                    "it is unknown which of them was edited",
                )
            return double
        edited = [reading for reading in present if not _is(reading.raw, written)]
        if not edited:
            return double
        standard = self._agreed(edited)
        if not _is(as_single, written, nearly=True):
            self._check_agree(gauge, double, as_single, standard, "both were edited")
            return double
        if standard.raw.shape != double.shape:
            return standard.value
        return np.where(as_single == standard.raw, double, standard.value)

    def _check_agree(
        self,
        gauge: Usd.Attribute,
        double: FloatArray,
        as_single: FloatArray,
        other: StoredValue,
        why: str,
    ) -> None:
        """Raise an error unless a double and a standard value agree in single precision."""
        if not _agree(as_single, other.raw):
            values = f"is {_shown(double)} but {other.place} is {_shown(other.value)}"
            raise self.fault(
                gauge, f"{values}: {why}; make them agree, or delete the first"
            )

    def _agreed(self, readings: Sequence[StoredValue]) -> StoredValue:
        first = readings[0]
        for other in readings[1:]:
            if not _agree(first.raw, other.raw):
                raise self.fault(
                    first.place,
                    f"is {_shown(first.value)} but {other.place} is {_shown(other.value)}: make them agree",
                )
        return first

    def check_followers(self, prim: Usd.Prim) -> None:
        """Check that no derived attribute of a prim was edited."""
        for attribute in prim.GetAuthoredAttributes():
            follows = attribute.GetCustomDataByKey(FOLLOWS)
            if follows is not None:
                value, written = attribute.Get(), attribute.GetCustomDataByKey(WRITTEN)
                array = None if value is None else _array(value)
                if array is not None and not _is(array, written):
                    raise self.fault(
                        attribute,
                        f"was edited, but it follows from {follows}: edit that",
                    )

    def material(self, prim: Usd.Prim) -> Usd.Prim | None:
        """Return the physics material that is bound to a prim or to a prim above it, or None if there is none."""
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        return (
            material.GetPrim()
            if material and material.GetPrim().HasAPI(UsdPhysics.MaterialAPI)
            else None
        )

    def collides(self, prim: Usd.Prim) -> bool:
        """Return whether a collider is enabled."""
        return self.flag(
            UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr(), default=True
        )

    def is_rigid(self, prim: Usd.Prim) -> bool:
        """Return whether a prim is an enabled rigid body of UsdPhysics."""
        enabled = UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr()
        return bool(prim.HasAPI(UsdPhysics.RigidBodyAPI)) and self.flag(
            enabled, default=True
        )

    def body_of(self, prim: Usd.Prim) -> Usd.Prim | None:
        """Return the rigid body that a prim is or belongs to, or None if there is none."""
        while prim and not prim.IsPseudoRoot():
            if self.is_rigid(prim) or prim.HasAttribute("gauge:name"):
                return prim
            prim = prim.GetParent()
        return None

    # --- frames ---

    def seconds(self, code: float) -> float:
        """Return the time of a time code since the start of the stage [s]."""
        return (code - self.start) / self.rate

    def sample_codes(self, prim: Usd.Prim) -> list[float]:
        """Return the ascending time codes of transform samples of a prim and of all prims above it."""
        codes: set[float] = set()
        for one in self._chain(prim):
            for op in UsdGeom.Xformable(one).GetOrderedXformOps():
                codes.update(op.GetTimeSamples())
        return sorted(codes)

    def frame(self, prim: Usd.Prim, time: Usd.TimeCode) -> Frame:
        """Return the frame of a prim in the world at a time."""
        chain = self._chain(prim)
        ops = (
            UsdGeom.Xformable(chain[-1]).GetOrderedXformOps()
            if chain and chain[-1] == prim
            else []
        )
        kinds = [UsdGeom.XformOp.TypeTranslate, UsdGeom.XformOp.TypeOrient]
        above = self._product(chain[:-1], time)
        is_plain = (
            self.metres == 1.0
            and np.array_equal(self.up, np.eye(3))
            and np.array_equal(above, np.eye(4))
        )
        if (
            is_plain
            and [op.GetOpType() for op in ops] == kinds
            and not any(op.IsInverseOp() for op in ops)
        ):
            # The exact written values: a conversion through matrices would lose the last digits.
            position = self._op_value(ops[0], (3,), time, np.zeros(3))
            return Frame(
                position_m=position,
                quaternion=self._quaternion(ops[1], time),
                scale=np.ones(3),
            )
        matrix = self._product(chain, time)
        rotation, scale = self.decomposed(prim, self.metres * self.up @ matrix[:3, :3])
        relative = scale / self.metres
        scale = np.where(
            np.abs(np.abs(relative) - 1.0) < SNAP,
            np.sign(relative) * self.metres,
            scale,
        )
        quaternion = Rotation.from_matrix(rotation).as_quat(
            canonical=True, scalar_first=True
        )
        return Frame(
            position_m=self.metres * (self.up @ matrix[:3, 3]),
            quaternion=quaternion,
            scale=scale,
        )

    def to_world(self, prim: Usd.Prim, points: FloatArray) -> FloatArray:
        """Return points in a prim's space, shape [..., 3], in world coordinates [m]."""
        matrix = self._product(self._chain(prim), Usd.TimeCode(self.start))
        return self.world_m(points @ matrix[:3, :3].T + matrix[:3, 3])

    def world_m(self, points: FloatArray) -> FloatArray:
        """Return points in the stage's world space, shape [..., 3], in metres with z up."""
        if self.metres == 1.0 and np.array_equal(self.up, np.eye(3)):
            return points
        return self.metres * points @ self.up.T

    def below(self, body: Usd.Prim, prim: Usd.Prim) -> FloatArray:
        """Return the transform from a prim's space to its body's space in the stage's units, shape [4, 4]."""
        chain = [
            one
            for one in self._chain(prim)
            if one.GetPath().HasPrefix(body.GetPath()) and one != body
        ]
        depth = prim.GetPath().pathElementCount - body.GetPath().pathElementCount
        for one in chain:
            if any(
                op.MightBeTimeVarying()
                for op in UsdGeom.Xformable(one).GetOrderedXformOps()
            ):
                raise self.fault(
                    one, f"moves within its body {body.GetPath()}: bodies are rigid"
                )
        if (
            depth
            and UsdGeom.Xformable(prim)
            and UsdGeom.Xformable(prim).GetResetXformStack()
        ):
            raise self.fault(
                prim, f"resets its transform, but belongs to the body {body.GetPath()}"
            )
        return self._product(chain, Usd.TimeCode(self.start))

    def decomposed(
        self, prim: Usd.Prim, matrix: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the rotation [3, 3] and the scale [3] of a linear map that scales along the axes and then rotates."""
        scale = np.sqrt(np.square(matrix).sum(axis=0))
        if not np.isfinite(matrix).all() or not (scale > 0.0).all():
            raise self.fault(
                prim,
                f"its transform scales by {_shown(scale)}: positive numbers are expected",
            )
        rotation = matrix / scale
        if np.linalg.det(rotation) < 0.0:
            rotation, scale = rotation * [-1.0, 1.0, 1.0], scale * [-1.0, 1.0, 1.0]
        if np.abs(rotation.T @ rotation - np.eye(3)).max() > ORTHOGONAL:
            raise self.fault(
                prim, "its transform is sheared: rigid bodies must not be sheared"
            )
        return rotation, scale

    def _chain(self, prim: Usd.Prim) -> list[Usd.Prim]:
        """Return the prims whose transforms determine the frame of a prim, outermost first."""
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
        self,
        op: UsdGeom.XformOp,
        shape: tuple[int, ...],
        time: Usd.TimeCode,
        default: FloatArray,
    ) -> FloatArray:
        value = self.numbers(op.GetAttr(), shape, time)
        return default if value is None else value

    def _quaternion(self, op: UsdGeom.XformOp, time: Usd.TimeCode) -> FloatArray:
        quaternion = self._op_value(op, (4,), time, np.array([1.0, 0.0, 0.0, 0.0]))
        length = length_of(quaternion)
        if abs(length - 1.0) < 1e-12:
            return quaternion
        if abs(length - 1.0) > UNIT_QUATERNION:
            raise self.fault(
                op.GetAttr(),
                f"holds {_shown(quaternion)}: a unit quaternion is expected",
            )
        return quaternion / length


def _array(value: Any) -> FloatArray | None:
    """Return a value of USD as numbers, or None if it is not numeric."""
    if isinstance(value, Gf.Quatd | Gf.Quatf | Gf.Quath):
        return wxyz(value)
    if isinstance(value, str | bool):
        return None
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        return None


def _decimals(values: FloatArray) -> FloatArray:
    """Return single-precision numbers as the shortest decimals that round to them."""
    flat = [
        float(str(number)) for number in np.asarray(values, dtype=np.float32).ravel()
    ]
    return np.array(flat).reshape(values.shape)


def _is(values: ArrayLike, written: Any, *, nearly: bool = False) -> bool:
    """Return whether a standard value equals its written value, to nine decimals if that is a digest.

    Args:
        values: The value.
        written: The written value.
        nearly: Whether numbers that agree in single precision are equal.
    """
    if isinstance(written, str):
        return digest(values) == written
    as_written = None if written is None else _array(written)
    if as_written is None:
        return False
    return np.array_equal(values, as_written) or (
        nearly and _agree(np.asarray(values), as_written)
    )


def _agree(one: FloatArray, other: FloatArray) -> bool:
    if one.shape != other.shape:
        return False
    size = float(np.abs(one).max(initial=0.0))
    return bool(np.abs(one - other).max(initial=0.0) <= SINGLE_RELATIVE * size)


def _shown(values: FloatArray) -> str:
    listed = np.asarray(values).ravel().tolist()
    text = ", ".join(f"{number:.9g}" for number in listed[:4])
    return f"({text}{', ...' if len(listed) > 4 else ''})" if len(listed) > 1 else text
