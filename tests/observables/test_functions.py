"""Curvature, turning angles, areas and marker proxies of nodes, against closed forms of geometry (Gauss-Bonnet)."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial import ConvexHull

from gauge_envs import load_experiment
from gauge_envs.errors import ShapeError
from gauge_envs.observables.functions import (
    AngleDeficits,
    assign_markers,
    face_areas_mm2,
    line_turning_angle,
)


def inner_curvature(markers, faces):
    """Curvature where all markers count as inside."""
    deficits = AngleDeficits(faces, markers.shape[1], corner=[], edge=[])
    return deficits(markers)


def fan(count, apex_height):
    """The mantle of a pyramid: apex marker 0 above a regular polygon."""
    angle = 2 * np.pi * np.arange(count) / count
    rim = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(count)))
    faces = [[0, 1 + k, 1 + (k + 1) % count] for k in range(count)]
    return np.vstack(([[0.0, 0.0, apex_height]], rim))[None], faces


def test_a_sheet_bent_about_one_axis_has_no_curvature():
    """A cylinder is developable. A corner is a quarter turn, and an edge a half turn."""
    sheet = load_experiment("TextileFlinging-satin").scene.markers
    flat = np.array(sheet.positions_m)
    # The sheet hangs upright, with rows of markers across it.
    bent = flat + 5.0 * np.abs(flat[:, 2:] - flat[:, 2].mean()) * [0.0, 1.0, 0.0]
    frames = np.stack([flat, bent])
    deficits = AngleDeficits(
        sheet.faces, len(flat), corner=sheet.corner, edge=sheet.edge
    )
    curvature = deficits(frames)
    np.testing.assert_allclose(curvature, 0.0, atol=1e-4)
    all_inner = inner_curvature(frames, sheet.faces)
    np.testing.assert_allclose(all_inner[:, sheet.corner], 1.5 * np.pi, atol=1e-4)
    np.testing.assert_allclose(all_inner[:, sheet.edge], np.pi, atol=1e-4)


@given(count=st.integers(3, 40), apex_height=st.floats(0.01, 5.0))
def test_a_pyramid_apex_has_the_deficit_of_its_mantle(count, apex_height):
    markers, faces = fan(count, apex_height)
    cosine = (np.cos(2 * np.pi / count) + apex_height**2) / (1 + apex_height**2)
    expected = 2 * np.pi - count * np.arccos(cosine)
    curvature = inner_curvature(markers, faces)[0, 0]
    assert curvature == pytest.approx(expected, abs=1e-6)


def test_a_closed_surface_has_two_full_turns_in_total():
    """Gauss-Bonnet: the sum is 4 pi for each surface with the topology of a sphere."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(200, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    rough = points + 0.02 * rng.normal(size=points.shape)
    frames = np.stack([points, points * [1.0, 2.0, 0.3], rough])
    curvature = inner_curvature(frames, ConvexHull(points).simplices)
    np.testing.assert_allclose(curvature.sum(axis=1), 4 * np.pi, rtol=1e-10)


def test_angles_of_missing_or_coincident_vertices_are_left_out():
    markers, faces = fan(6, 0.0)
    markers[0, 1] = np.nan
    curvature = inner_curvature(markers, faces)[0]
    assert curvature[0] == pytest.approx(2 * np.pi - 4 * np.pi / 3)
    assert np.isnan(curvature[1])
    assert np.isfinite(np.delete(curvature, 1)).all()
    markers, faces = fan(6, 0.0)
    markers[0, 1] = markers[0, 2]
    # Face (0, 1, 2) is a line and drops out; (0, 6, 1) spans two sixths of the turn instead of one.
    assert inner_curvature(markers, faces)[0, 0] == pytest.approx(0.0, abs=1e-12)
    markers[0, 3] = markers[0, 0]
    # Now (0, 2, 3) and (0, 3, 4) drop out too, a sixth of the turn each.
    assert inner_curvature(markers, faces)[0, 0] == pytest.approx(2 * np.pi / 3)


SIGNS = (-1.0, 0.0, 1.0)
DIRECTIONS = [
    (x, y, z) for x in SIGNS for y in SIGNS for z in SIGNS if (x, y, z) != (0, 0, 0)
]
"""Directions into each octant, along each edge between two octants, and along each axis."""


@pytest.mark.parametrize("coincident", [1, 2])
@pytest.mark.parametrize("direction", DIRECTIONS)
def test_the_angle_at_coincident_vertices_is_0_in_every_direction(
    direction, coincident
):
    """A zero vector times a negative number is -0.0, whose angle by atan2 would be pi."""
    markers = np.zeros((1, 3, 3))
    markers[0, 3 - coincident] = direction
    curvature = inner_curvature(markers, [[0, 1, 2]])
    # The two coincident vertices lie in one direction from the third one, too.
    assert curvature[0].tolist() == [2 * np.pi] * 3


def test_the_turning_angle_along_a_row_is_that_of_its_polygon():
    """Two rows, interleaved as in textile bending: one straight, one on a regular 12-gon."""
    angle = 2 * np.pi * np.arange(5) / 12
    markers = np.zeros((3, 10, 3))
    markers[:, 0::2, 0] = np.arange(5) * 0.1
    markers[:, 1::2, :2] = np.column_stack((np.cos(angle), np.sin(angle)))
    markers[1, 9] = np.nan
    markers[2, 0] = markers[2, 2]
    lines = [[0, 2], [2, 4], [4, 6], [6, 8], [1, 3], [3, 5], [5, 7], [7, 9]]
    expected = np.tile([0.0, np.pi / 6], (3, 3))
    # A missing or coincident neighbour.
    expected[1, 5] = expected[2, 0] = np.nan
    turning = line_turning_angle(markers, lines)
    np.testing.assert_allclose(turning, expected, atol=1e-12)
    for wrong in ([[0, 1]], [[0, 1], [0, 2]], [[0, 2], [1, 2]]):
        with pytest.raises(ShapeError, match="lines"):
            line_turning_angle(markers, wrong)


def test_the_area_of_a_right_triangle_in_space():
    """The legs (0.02, 0.02, 0.01) and (-0.02, 0.01, 0.02) m are 30 mm long."""
    corner = np.array([0.3, -0.1, 0.7])
    legs = np.array([[0.0, 0, 0], [0.02, 0.02, 0.01], [-0.02, 0.01, 0.02]])
    markers = np.stack([corner + legs, corner + 2.0 * legs])
    markers = np.append(markers, np.full((2, 1, 3), np.nan), axis=1)
    areas = face_areas_mm2(markers, [[0, 1, 2], [2, 1, 0], [1, 2, 3]])
    expected = [[450.0, 450.0, np.nan], [1800.0, 1800.0, np.nan]]
    np.testing.assert_allclose(areas, expected)


def test_markers_get_unique_nodes_with_the_smallest_total_distance():
    """Both markers are nearest to node 0; the second gets its next node, because that costs less."""
    nodes = np.array([[0.0, 0, 0], [0.004, 0, 0], [0.05, 0, 0]])
    markers = np.array([[-0.001, 0, 0], [0.0015, 0, 0]])
    assert assign_markers(markers, nodes).tolist() == [0, 1]
    with pytest.raises(ShapeError, match="3 nodes are too few for 4 markers"):
        assign_markers(np.zeros((4, 3)), nodes)
    far = [[0.0, 0, 0], [0.062, 0, 0]]
    message = r"marker 1 is 12\.0 mm from its node 2; the limit is 10\.0 mm"
    with pytest.raises(ShapeError, match=message):
        assign_markers(far, nodes)
