"""Convex pieces as a file, the only form in which PyBullet takes a body of several convex hulls."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gauge_envs.scene.meshes import hull_faces


def write_convex_pieces(path: Path, pieces: Sequence[NDArray[np.float64]]) -> Path:
    """Write an OBJ file with one object for each convex piece, and return its path.

    Args:
        path: The file.
        pieces: Vertices of each piece in units, shape [vertex_count, 3].
    """
    lines, first = [], 1
    for index, piece in enumerate(pieces):
        lines.append(f"o piece{index}")
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in piece.tolist()]
        lines += ["f " + " ".join(str(first + vertex) for vertex in face) for face in hull_faces(piece)]
        first += len(piece)
    path.write_text("\n".join(lines) + "\n")
    return path
