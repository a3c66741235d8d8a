import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial import ConvexHull

from gauge_envs.errors import ShapeError
from gauge_envs.observables.functions import (
    angle_deficit_curvature,
    assign_markers,
    face_areas_mm2,
    line_turning_angle,
)


def sheet(rows, columns, height=lambda x, y: 0 * x):
    """A rectangular sheet of triangles: markers [rows * columns, 3], faces, corner and edge markers."""
    x, y = np.meshgrid(np.arange(columns) * 0.03, np.arange(rows) * 0.02)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    faces = np.concatenate(
        [np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (a, c, d))]
    )
    corner = index[[0, 0, -1, -1], [0, -1, 0, -1]].tolist()
    border = np.concatenate((index[0], index[-1], index[:, 0], index[:, -1])).tolist()
    markers = np.stack((x, y, height(x, y)), axis=-1).reshape(-1, 3)
    return markers, faces, corner, sorted(set(border) - set(corner))


def fan(count, apex_height):
    """A pyramid's mantle: apex marker 0 above a regular polygon."""
    angle = 2 * np.pi * np.arange(count) / count
    rim = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(count)))
    faces = [[0, 1 + k, 1 + (k + 1) % count] for k in range(count)]
    return np.vstack(([[0.0, 0.0, apex_height]], rim))[None], faces


# Curvature


def test_corners_count_a_quarter_turn_and_edges_a_half():
    markers, faces, corner, edge = sheet(3, 3)
    flat = angle_deficit_curvature(markers[None], faces, corner=corner, edge=edge)
    np.testing.assert_allclose(flat, 0.0, atol=1e-12)
    all_inner = angle_deficit_curvature(markers[None], faces, corner=[], edge=[])
    np.testing.assert_allclose(all_inner[0, corner], 1.5 * np.pi)
    np.testing.assert_allclose(all_inner[0, edge], np.pi)


def test_a_sheet_bent_about_one_axis_keeps_no_curvature():
    """A cylinder is developable: the angle deficit of its triangles is 0, however strong the bend."""
    markers, faces, corner, edge = sheet(4, 9, lambda x, y: np.abs(x - 0.12))
    curvature = angle_deficit_curvature(markers[None], faces, corner=corner, edge=edge)
    np.testing.assert_allclose(curvature, 0.0, atol=1e-12)


def test_a_cube_corner_has_a_quarter_turn_of_curvature():
    markers = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]], dtype=float)
    curvature = angle_deficit_curvature(
        markers, [[0, 1, 2], [0, 2, 3], [0, 3, 1]], corner=[], edge=[]
    )
    assert curvature[0, 0] == pytest.approx(np.pi / 2)


@given(count=st.integers(3, 40), apex_height=st.floats(0.01, 5.0))
def test_a_pyramid_apex_has_the_deficit_of_its_mantle(count, apex_height):
    markers, faces = fan(count, apex_height)
    cosine = (np.cos(2 * np.pi / count) + apex_height**2) / (1 + apex_height**2)
    expected = 2 * np.pi - count * np.arccos(cosine)
    assert angle_deficit_curvature(markers, faces, corner=[], edge=[])[
        0, 0
    ] == pytest.approx(expected, abs=1e-6)


def test_a_closed_surface_has_two_full_turns_in_total():
    """Gauss-Bonnet: 4 pi for anything of a sphere's topology, moved or not, in every frame."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(200, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    frames = np.stack(
        [
            points,
            points * [1.0, 2.0, 0.3],
            points + 0.02 * rng.normal(size=points.shape),
        ]
    )
    curvature = angle_deficit_curvature(
        frames, ConvexHull(points).simplices, corner=[], edge=[]
    )
    np.testing.assert_allclose(curvature.sum(axis=1), 4 * np.pi, rtol=1e-10)


def test_frames_are_independent():
    markers, faces, corner, edge = sheet(4, 5, lambda x, y: 40 * x * y)
    flat, *_ = sheet(4, 5)
    both = angle_deficit_curvature(
        np.stack((markers, flat)), faces, corner=corner, edge=edge
    )
    alone = angle_deficit_curvature(markers[None], faces, corner=corner, edge=edge)
    np.testing.assert_allclose(both[:1], alone, atol=1e-12)
    assert np.abs(both[0]).max() > 0.01 > np.abs(both[1]).max()


def test_angles_with_a_missing_vertex_are_left_out():
    markers, faces = fan(6, 0.0)
    markers[0, 1] = np.nan
    curvature = angle_deficit_curvature(markers, faces, corner=[], edge=[])[0]
    assert curvature[0] == pytest.approx(2 * np.pi - 4 * np.pi / 3)
    assert np.isnan(curvature[1])
    assert np.isfinite(np.delete(curvature, 1)).all()


def test_angles_of_degenerate_triangles_are_left_out():
    markers, faces = fan(6, 0.0)
    markers[0, 1] = markers[0, 2]
    # Face (0, 1, 2) is a line now and drops out; (0, 6, 1) spans two sixths of the turn instead of one.
    assert angle_deficit_curvature(markers, faces, corner=[], edge=[])[
        0, 0
    ] == pytest.approx(0.0, abs=1e-12)
    markers[0, 3] = markers[0, 0]
    # Now (0, 2, 3) and (0, 3, 4) drop out too, a sixth of the turn each.
    assert angle_deficit_curvature(markers, faces, corner=[], edge=[])[
        0, 0
    ] == pytest.approx(2 * np.pi / 3)


# Turning angle along lines


def test_turning_angle_of_a_regular_polygon_row():
    """Two rows, interleaved as in textile bending: one straight, one on a regular 12-gon."""
    angle = 2 * np.pi * np.arange(5) / 12
    markers = np.zeros((1, 10, 3))
    markers[0, 0::2, 0] = np.arange(5) * 0.1
    markers[0, 1::2, :2] = np.column_stack((np.cos(angle), np.sin(angle)))
    lines = [[0, 2], [2, 4], [4, 6], [6, 8], [1, 3], [3, 5], [5, 7], [7, 9]]
    turning = line_turning_angle(markers, lines)
    assert turning.shape == (1, 6)
    np.testing.assert_allclose(turning[0, 0::2], 0.0, atol=1e-12)
    np.testing.assert_allclose(turning[0, 1::2], np.pi / 6)


def test_turning_angle_is_nan_where_a_neighbour_is_missing_or_coincides():
    markers = np.zeros((3, 4, 3))
    markers[..., 0] = np.arange(4)
    markers[1, 0] = np.nan
    markers[2, 3] = markers[2, 2]
    np.testing.assert_array_equal(
        line_turning_angle(markers, [[0, 1], [1, 2], [2, 3]]),
        [[0.0, 0.0], [np.nan, 0.0], [0.0, np.nan]],
    )


@pytest.mark.parametrize("lines", [[[0, 1]], [[0, 1], [0, 2]], [[0, 2], [1, 2]]])
def test_turning_angle_refuses_lines_that_are_no_rows(lines):
    with pytest.raises(ShapeError, match="lines"):
        line_turning_angle(np.zeros((1, 4, 3)), lines)


# Areas


def test_area_of_a_right_triangle():
    markers = np.array([[[0, 0, 0], [0.03, 0, 0], [0, 0.04, 0]]])
    np.testing.assert_allclose(
        face_areas_mm2(markers, [[0, 1, 2], [2, 1, 0]]), [[600.0, 600.0]]
    )


def test_area_is_nan_where_a_vertex_is_missing():
    markers = np.random.default_rng(0).normal(size=(2, 4, 3))
    markers[1, 3, 2] = np.nan
    np.testing.assert_array_equal(
        np.isnan(face_areas_mm2(markers, [[0, 1, 2], [1, 2, 3]])),
        [[False, False], [False, True]],
    )


# Markers on nodes


def test_markers_get_unique_nodes_of_least_total_distance():
    """Both markers are nearest to node 0; the second has the better alternative and yields."""
    nodes = np.array([[0.0, 0, 0], [0.004, 0, 0], [0.05, 0, 0]])
    markers = np.array([[-0.001, 0, 0], [0.0015, 0, 0]])
    assert assign_markers(markers, nodes).tolist() == [0, 1]


def test_markers_find_their_own_nodes_in_any_order():
    rng = np.random.default_rng(1)
    nodes = rng.uniform(size=(80, 3))
    wanted = rng.permutation(80)[:25]
    markers = nodes[wanted] + rng.uniform(-1e-4, 1e-4, size=(25, 3))
    assert assign_markers(markers, nodes).tolist() == wanted.tolist()


def test_markers_without_a_node_near_by_are_refused_by_name():
    nodes = np.array([[0.0, 0, 0], [0.1, 0, 0]])
    with pytest.raises(
        ShapeError, match=r"marker 1 is 12\.0 mm from its node 1; the limit is 10\.0 mm"
    ):
        assign_markers([[0.0, 0, 0], [0.112, 0, 0]], nodes)
    assert assign_markers(
        [[0.0, 0, 0], [0.112, 0, 0]], nodes, max_distance_m=0.02
    ).tolist() == [0, 1]
    with pytest.raises(ShapeError, match="2 nodes are too few for 3 markers"):
        assign_markers(np.zeros((3, 3)), nodes)
