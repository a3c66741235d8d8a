"""Values and frames of an open USD stage, in SI units with z up. Errors name the file and the prim."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdPhysics, UsdShade
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from gauge_envs.errors import AssetError
from gauge_envs.files import is_regular_file
from gauge_envs.formats.usd.layer import FOLLOWS, WRITTEN, as_array, digest
from gauge_envs.reading import one_line
from gauge_envs.scene import Pose
from gauge_envs.scene.geometry import FloatArray, length_of
from gauge_envs.validation import first_fault

Value = TypeVar("Value")

SINGLE_RELATIVE = 3e-7
"""Largest difference of numbers that are equal in single precision, relative to the largest number."""

MAX_SKEW = 1e-6
"""Largest cosine of the angle between the axes of a transform, and largest deviation of a scale that counts as 1."""

MAX_NUMBER = 1e30
"""Largest valid number; products of several such numbers are finite."""

Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation of a stage with y up: y becomes z, z becomes -y."""

EXACT_OPERATIONS = ["xformOp:translate", "xformOp:orient"]
"""Transform of a body as this package writes it."""


class StoredValue(NamedTuple):
    """Value of a standard attribute in SI units.

    Attributes:
        raw: The stored value, for comparison with the written value.
        value: The value to use. A single-precision number becomes the shortest decimal that rounds to it.
    """

    raw: FloatArray
    value: FloatArray


def single(values: FloatArray) -> FloatArray:
    """Return numbers rounded to single precision."""
    return np.asarray(values).astype(np.float32).astype(np.float64)


class Source:
    """An open stage.

    Args:
        path: File of any format that USD reads.
    """

    def __init__(self, path: Path) -> None:
        self.file = path
        with self.errors_at(""):
            self.stage = self._open()
        for key in (UsdGeom.Tokens.metersPerUnit, UsdGeom.Tokens.upAxis):
            if not self.stage.HasAuthoredMetadata(key):
                raise self.fault("", f"{key} is not given: set it")
        self.metres = UsdGeom.GetStageMetersPerUnit(self.stage)
        self.kilograms = UsdPhysics.GetStageKilogramsPerUnit(self.stage)
        self.rate_hz = self.stage.GetTimeCodesPerSecond()
        is_z_up = UsdGeom.GetStageUpAxis(self.stage) == UsdGeom.Tokens.z
        self.up: FloatArray = np.eye(3) if is_z_up else Y_UP
        self.is_si = is_z_up and self.metres == 1.0
        self.start = self.stage.GetStartTimeCode()

    def _open(self) -> Usd.Stage:
        if not is_regular_file(self.file):
            raise self.fault("", "there is no such file")
        stage = Usd.Stage.Open(str(self.file))
        if any(layer.dirty for layer in stage.GetUsedLayers()):
            raise self.fault("", "is open in this process with edits: save them")
        # A layer that is already open in this process may be older than its file.
        stage.Reload()
        if broken := stage.GetCompositionErrors():
            raise self.fault("", str(broken[0]))
        return stage

    def fault(self, place: Usd.Object | Sdf.Path | str, reason: str) -> AssetError:
        """Return the error to raise for a prim, attribute or path of the file."""
        path = place.GetPath() if isinstance(place, Usd.Object) else place
        return AssetError(self.file, str(path), reason)

    @contextmanager
    def errors_at(self, place: Usd.Object | str) -> Iterator[None]:
        """Convert errors at a prim or attribute to AssetError.

        Such errors come from USD, from NumPy if an attribute has an unexpected type, and from a scene whose parts
        contradict each other.
        """
        try:
            yield
        except AssetError:
            raise
        except (
            ArithmeticError,
            LookupError,
            RuntimeError,
            TypeError,
            ValueError,
        ) as error:
            raise self.fault(place, _reason(error)) from None

    def read_each(
        self, prims: Iterable[Usd.Prim], read: Callable[[Usd.Prim], Value]
    ) -> list[Value]:
        """Return the value of a function for each prim; errors name the prim."""
        values = []
        for prim in prims:
            with self.errors_at(prim):
                values.append(read(prim))
        return values

    def used_files(self) -> tuple[Path, ...]:
        """Return the other files of the stage, sorted."""
        # A layer in a package belongs to the package's file, which is listed itself.
        paths = {Path(layer.realPath) for layer in self.stage.GetUsedLayers()}
        files = {path.resolve() for path in paths if path.is_file()}
        return tuple(sorted(files - {self.file.resolve()}))

    def prims(self) -> Iterator[Usd.Prim]:
        """Return an iterator over all active, defined prims in the stage's order, including prims in instances."""
        return iter(Usd.PrimRange.Stage(self.stage, Usd.TraverseInstanceProxies()))

    # --- values ---

    def numbers(
        self, attribute: Usd.Attribute, shape: tuple[int, ...] = ()
    ) -> FloatArray | None:
        """Return the numbers of an attribute at the start, or None if it has no value.

        Args:
            attribute: The attribute; it need not exist.
            shape: Expected shape; -1 stands for any length.
        """
        value = attribute.Get(self.start)
        if value is None:
            return None
        with self.errors_at(attribute):
            array = as_array(value).reshape(shape)
        if not (np.abs(array) <= MAX_NUMBER).all():
            raise self.fault(attribute, f"holds {value}: finite numbers are expected")
        return array

    def number(self, attribute: Usd.Attribute) -> float | None:
        """Return the number of an attribute, or None if it has no value."""
        array = self.numbers(attribute)
        return None if array is None else float(array)

    def text(self, attribute: Usd.Attribute, known: Sequence[str] = ()) -> str | None:
        """Return the string or token of an attribute, one of the known texts, or None if it has no value."""
        value = attribute.Get()
        if value is None or (isinstance(value, str) and (not known or value in known)):
            return value
        expected = f"one of {', '.join(known)}" if known else "a text"
        raise self.fault(attribute, f"holds {value!r}: {expected} is expected")

    def stored(
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
        raw = self.numbers(attribute, shape)
        if raw is None or not attribute.HasAuthoredValue():
            return None
        is_single = np.array_equal(raw, single(raw))
        decimals = raw.astype(np.float32).astype(str).astype(np.float64)
        return StoredValue(convert(raw), convert(decimals if is_single else raw))

    def edited(
        self,
        exact: Usd.Attribute,
        stored: Sequence[StoredValue | None],
        shape: tuple[int, ...] = (),
    ) -> FloatArray | None:
        """Return a quantity that is stored as a `gauge:` double and in standard attributes: the edited value applies.

        The double applies if its standard counterparts have their written values. An edited standard value replaces the
        double, element by element in an array.

        Args:
            exact: The double; it need not exist.
            stored: Standard values of the same quantity.
            shape: Expected shape as in `numbers`.

        Returns:
            The value, or None if there is none.

        Raises:
            AssetError: Two edited values differ.
        """
        double = self.numbers(exact, shape)
        values = [value for value in stored if value is not None]
        if double is not None:
            values.insert(0, StoredValue(single(double), double))
        written = exact.GetCustomDataByKey(WRITTEN)
        edited = [value for value in values if not is_written(value.raw, written)]
        if not edited:
            return double
        first = edited[0]
        for value in edited[1:]:
            if not is_written(first.raw, value.raw):
                raise self.fault(
                    exact,
                    f"was edited to {first.value}, and to {value.value} in a standard attribute: make them agree",
                )
        if double is None or first.raw.shape != double.shape:
            return first.value
        return np.where(single(double) == first.raw, double, first.value)

    def check_derived(self, prim: Usd.Prim) -> None:
        """Check that no derived attribute of a prim was edited."""
        for attribute in prim.GetAuthoredAttributes():
            follows = attribute.GetCustomDataByKey(FOLLOWS)
            value = attribute.Get()
            if follows is None or value is None or isinstance(value, str):
                continue
            if not is_written(as_array(value), attribute.GetCustomDataByKey(WRITTEN)):
                raise self.fault(
                    attribute, f"was edited, but it follows from {follows}: edit that"
                )

    # --- prims ---

    def targets(
        self, prim: Usd.Prim, relationship: str, names: Mapping[Sdf.Path, str]
    ) -> tuple[str, ...]:
        """Return the names of the bodies that a relationship targets, of the given names by path."""
        paths = prim.GetRelationship(relationship).GetTargets()
        if not paths or not names.keys() >= set(paths):
            listed = ", ".join(map(str, paths)) or "nothing"
            raise self.fault(
                prim, f"{relationship} names {listed}: bodies are expected"
            )
        return tuple(names[path] for path in paths)

    def material(self, prim: Usd.Prim) -> Usd.Prim | None:
        """Return the physics material that is bound to a prim or to a prim above it, or None if there is none."""
        bound, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")
        material = bound.GetPrim()
        return (
            material if material and material.HasAPI(UsdPhysics.MaterialAPI) else None
        )

    def is_rigid(self, prim: Usd.Prim) -> bool:
        """Return whether a prim is an enabled rigid body of UsdPhysics."""
        api = UsdPhysics.RigidBodyAPI(prim)
        return bool(api) and api.GetRigidBodyEnabledAttr().Get() is not False

    def body_of(self, prim: Usd.Prim | None) -> Usd.Prim | None:
        """Return the rigid body that a prim is or belongs to, or None if there is none."""
        while prim and not prim.IsPseudoRoot():
            if self.is_rigid(prim) or prim.HasAttribute("gauge:name"):
                return prim
            prim = prim.GetParent()
        return None

    # --- frames ---

    def seconds(self, code: float) -> float:
        """Return the time of a time code since the start of the stage [s]."""
        return (code - self.start) / self.rate_hz

    def sample_codes(self, prim: Usd.Prim) -> list[float]:
        """Return the ascending time codes of transform samples of a prim and of all prims above it."""
        codes: set[float] = set()
        while prim:
            if prim.IsA(UsdGeom.Xformable):
                codes.update(UsdGeom.Xformable(prim).GetTimeSamples())
            prim = prim.GetParent()
        return sorted(codes)

    def frame(self, prim: Usd.Prim, time: Usd.TimeCode) -> tuple[Pose, FloatArray]:
        """Return the pose of a prim in the world at a time, and the scale along its axes [m per unit], shape [3]."""
        xform = UsdGeom.Xformable(prim)
        matrix = np.array(xform.ComputeLocalToWorldTransform(time)).T
        if not (np.abs(matrix) <= MAX_NUMBER).all():
            raise self.fault(prim, "its transform is not finite")
        rotation, scale = self.decomposed(prim, self.up @ matrix[:3, :3])
        if np.allclose(scale, 1.0, rtol=0.0, atol=MAX_SKEW):
            scale = np.ones(3)
        position_m = self.metres * (self.up @ matrix[:3, 3])
        quaternion = Rotation.from_matrix(rotation).as_quat(
            canonical=True, scalar_first=True
        )
        values = {
            operation.GetOpName(): operation.Get(time)
            for operation in xform.GetOrderedXformOps()
        }
        is_placed = list(values) == EXACT_OPERATIONS and None not in values.values()
        above = xform.ComputeParentToWorldTransform(time)
        if is_placed and self.is_si and above == Gf.Matrix4d(1.0):
            # A conversion through matrices would lose the last digits of the written values.
            position_m, quaternion = map(as_array, values.values())
            length = length_of(quaternion)
            if abs(length - 1.0) > 1e-12:
                quaternion = quaternion / length
        pose = Pose.of_state(np.concatenate([position_m, quaternion]))
        return pose, self.metres * scale

    def decomposed(
        self, prim: Usd.Prim, matrix: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the rotation [3, 3] and the scale [3] of a linear map that scales along the axes and then rotates."""
        scale = np.linalg.norm(matrix, axis=0)
        if np.linalg.det(matrix) <= 0.0:
            raise self.fault(
                prim,
                f"its transform scales by {scale} or mirrors: scale by positive numbers",
            )
        rotation = matrix / scale
        if np.abs(rotation.T @ rotation - np.eye(3)).max() > MAX_SKEW:
            raise self.fault(
                prim, "its transform is sheared: rigid bodies must not be sheared"
            )
        return rotation, scale

    def to_world(self, prim: Usd.Prim | None, points: FloatArray) -> FloatArray:
        """Return points in a prim's space, or in the stage's space, in world coordinates [m], shape [..., 3]."""
        if prim is not None:
            xform = UsdGeom.Imageable(prim)
            matrix = np.array(xform.ComputeLocalToWorldTransform(self.start))
            points = points @ matrix[:3, :3] + matrix[3, :3]
        return points if self.is_si else self.metres * points @ self.up.T


def is_written(values: FloatArray, written: Any) -> bool:
    """Return whether numbers equal a written value, or a digest of it, in single precision."""
    if isinstance(written, str):
        return digest(values) == written
    if written is None:
        return False
    expected = as_array(written)
    if values.shape != expected.shape:
        return False
    largest = np.abs(expected).max(initial=0.0)
    return bool(np.abs(values - expected).max(initial=0.0) <= SINGLE_RELATIVE * largest)


def _reason(error: Exception) -> str:
    """Return the message of an error."""
    if isinstance(error, ValidationError):
        return " ".join(first_fault(error)).strip()
    if not isinstance(error, Tf.ErrorException):
        return str(error)
    return one_line(f"USD cannot read it: {error.args[0].commentary}")
