"""Common parts of the writer and the reader of USD layers: names, records of written values, driver motions as JSON."""

import hashlib
import json
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pxr import Gf, Usd
from pydantic import BaseModel, ConfigDict, NonNegativeInt
from scipy.spatial.transform import Rotation

from gauge_envs.scene.bodies import Cloth, Deformable, Rod, Rope, SoftBody
from gauge_envs.scene.drivers import DriverMotion
from gauge_envs.scene.geometry import FloatArray

WRITTEN = "written"
"""Custom data key of a `gauge:` attribute with the written value of its standard counterpart: a number, a vector, a
token, or the digest of an array."""

FOLLOWS = "follows"
"""Custom data key of a derived attribute with the names of the `gauge:` attributes to edit instead."""

TEXT = "text"
"""Custom data key of `gauge:driver` with the digest of its written motions."""

KINDS: dict[type[Deformable], str] = {
    Cloth: "cloth",
    SoftBody: "soft_body",
    Rope: "rope",
    Rod: "rod",
}
"""Values of `gauge:kind`."""

OMNI_MATERIAL = {
    "thickness_m": "surfaceThickness",
    "young_modulus_pa": "youngsModulus",
    "poisson_ratio": "poissonsRatio",
}
"""Attributes of Omniverse's deformable material, by the constants of a body that they hold in single precision."""

ARMS = ("torsion_m", "rolling_m")
"""Fields of a contact beyond UsdPhysics, written where they are not zero."""

AIR_KINDS = {"wind_m_per_s": "double3"}
"""Type in USD of the fields of the air that are no double."""

MARKER_INDICES = {
    "faces": "int3[]",
    "lines": "int2[]",
    "corner": "int[]",
    "edge": "int[]",
}
"""Type in USD of each kind of marker indices."""

DIGEST_DECIMALS = 9
"""Number of decimals in digests, so that the last digit of a sine, which differs between machines, has no effect."""


# --- records of written values ---------------------------------------------------------------------------------------


def digest(values: ArrayLike) -> str:
    """Return a short hash of numbers and their shape, rounded to nine decimals (m, rad, ...)."""
    # Adding zero turns -0.0 into 0.0.
    rounded = np.round(np.asarray(values, dtype=np.float64), DIGEST_DECIMALS) + 0.0
    return hashlib.sha256(
        repr(rounded.shape).encode() + rounded.astype("<f8").tobytes()
    ).hexdigest()[:16]


def _text_digest(text: str) -> str:
    """Return a short hash of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def motions_digest(text: str) -> str:
    """Return a short hash of JSON, whose numbers are rounded as in `digest`."""
    return _text_digest(
        json.dumps(
            json.loads(
                text, parse_float=lambda number: round(float(number), DIGEST_DECIMALS)
            )
        )
    )


def names_digest(pairs: set[frozenset[str]]) -> str:
    """Return a short hash of pairs of names."""
    return _text_digest(json.dumps(sorted(sorted(pair) for pair in pairs)))


def samples_digest(
    times_s: FloatArray, positions_m: FloatArray, quaternions: FloatArray
) -> str:
    """Return a short hash of poses at times; both quaternions of a rotation have the same hash.

    Args:
        times_s: Shape [sample_count].
        positions_m: Shape [sample_count, 3].
        quaternions: w, x, y, z, shape [sample_count, 4].
    """
    matrices = (
        Rotation.from_quat(quaternions, scalar_first=True).as_matrix().reshape(-1, 9)
    )
    return digest(np.column_stack([times_s, positions_m, matrices]))


def record_written(gauge: Usd.Attribute, written: Any) -> None:
    """Record the written value of the standard counterpart of a `gauge:` attribute."""
    gauge.SetCustomDataByKey(WRITTEN, written)


def record_follower(attribute: Usd.Attribute, source: str) -> None:
    """Record that an attribute is computed from others, so that the reader detects an edit.

    Args:
        attribute: The attribute, with its value.
        source: Names of the attributes that it is computed from.
    """
    value = attribute.Get()
    attribute.SetCustomDataByKey(
        WRITTEN, value if isinstance(value, float) else digest(value)
    )
    attribute.SetCustomDataByKey(FOLLOWS, source)


def hinge_frame(axis: tuple[float, float, float]) -> Gf.Quatf:
    """Return the orientation whose x axis is a hinge's world axis."""
    return Gf.Quatf(Gf.Rotation(Gf.Vec3d(1.0, 0.0, 0.0), Gf.Vec3d(*axis)).GetQuat())


def wxyz(quaternion: Gf.Quatf | Gf.Quatd | Gf.Quath) -> FloatArray:
    """Return a quaternion as four numbers w, x, y, z."""
    return np.array(
        [quaternion.GetReal(), *quaternion.GetImaginary()], dtype=np.float64
    )


def hinge_axis(quaternion: FloatArray, letter: str = "X") -> FloatArray:
    """Return the direction of an axis of an orientation w, x, y, z, shape [3]."""
    return Rotation.from_quat(quaternion, scalar_first=True).apply(
        np.eye(3)["XYZ".index(letter)]
    )


# --- driver motions as JSON ------------------------------------------------------------------------------------------


class _DriverRecord(BaseModel):
    """What `gauge:driver` of a body holds.

    Attributes:
        index: Place of the driver among those of its scene.
        motions: Motions in the order in which they apply.
    """

    model_config = ConfigDict(
        extra="forbid", frozen=True, allow_inf_nan=False, revalidate_instances="always"
    )

    index: NonNegativeInt
    motions: tuple[DriverMotion, ...]


def motions_to_json(motions: tuple[DriverMotion, ...], index: int) -> str:
    """Return the motions of a driver as JSON, which preserves doubles exactly.

    Args:
        motions: Motions in the order in which they apply.
        index: Index of the driver in its scene.
    """
    return json.dumps(
        _DriverRecord(index=index, motions=motions).model_dump(), allow_nan=False
    )


def motions_from_json(text: str) -> tuple[tuple[DriverMotion, ...], int]:
    """Return the motions of a driver and its index in the scene."""
    record = _DriverRecord.model_validate(json.loads(text))
    return record.motions, record.index
