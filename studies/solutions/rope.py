"""Solve the start of RopeWinding: a rope over a beam pulls two balls off their posts.

    python studies/solutions/rope.py [FOLDER]

The scene is symmetric, so one half is solved, in a vertical plane. The rope is a chain of points between rods that
cannot stretch. Its first point stays on top of the beam, and the others do not enter the beam. Its last point is
fixed to a ball, which rolls on its post, and then turns about the edge of the post. The billiard touches the balls
after frame 12, where the solution ends.

Verlet's scheme with constraints (SHAKE; Ryckaert et al. 1977, J. Comput. Phys. 23, 327) has no damping. The script
prints the motion for chains of 20, 40, 80 and 160 rods, and writes the finest one into the reference.
"""

import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from store import store_solution

from gauge_envs import load_experiment
from gauge_envs.files import data_folder
from gauge_envs.scene import ConvexUnion, Cylinder, Rope, Scene, Sphere
from gauge_envs.scene.timing import FRAME_RATE_HZ

VARIANT = "RopeWinding-rubber"
FRAME_COUNT = 13
STEPS_PER_FRAME = 400
ROD_COUNTS = (20, 40, 80, 160)
TOLERANCE_M = 1e-13

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HalfScene:
    """One half of the scene; x [m] is from the axis of the beam to the ball, z [m] is upwards from this axis.

    Attributes:
        rope_m: Length of half of the rope.
        rope_kg: Mass of half of the rope.
        beam_m: Distance of the middle of the rope from the axis of the beam where both touch.
        ball_m: Radius of the ball.
        ball_kg: Mass of the ball.
        start_m: Place x of the centre of the ball at the start.
        edge_m: Distance from the start to the edge of the post.
        gravity_m_per_s2: Acceleration of gravity.
    """

    rope_m: float
    rope_kg: float
    beam_m: float
    ball_m: float
    ball_kg: float
    start_m: float
    edge_m: float
    gravity_m_per_s2: float

    @property
    def rolling_inertia_kg_m2(self) -> float:
        """Moment of inertia of the ball about the point on which it rolls."""
        return 1.4 * self.ball_kg * self.ball_m**2

    def beyond_edge_rad(self, turned_rad: float) -> float:
        """Return the angle by which the ball has turned about the edge of the post."""
        return max(turned_rad - self.edge_m / self.ball_m, 0.0)

    def centre_m(self, turned_rad: float) -> Array:
        """Return the centre of the ball (x, z) after it has turned by an angle."""
        beyond_rad = self.beyond_edge_rad(turned_rad)
        rolled_m = self.ball_m * (turned_rad - beyond_rad)
        inward_m = rolled_m + self.ball_m * math.sin(beyond_rad)
        sunk_m = self.ball_m * (1.0 - math.cos(beyond_rad))
        return np.array([self.start_m - inward_m, self.beam_m - sunk_m])

    def end_m(self, turned_rad: float) -> Array:
        """Return the point (x, z) of the ball that holds the rope."""
        arm = np.array([-math.cos(turned_rad), -math.sin(turned_rad)])
        return self.centre_m(turned_rad) + self.ball_m * arm

    def end_slope_m(self, turned_rad: float) -> Array:
        """Return the derivative of `end_m` by the angle."""
        beyond_rad = self.beyond_edge_rad(turned_rad)
        centre = np.array([-math.cos(beyond_rad), -math.sin(beyond_rad)])
        arm = np.array([math.sin(turned_rad), -math.cos(turned_rad)])
        return self.ball_m * (centre + arm)

    def weight_torque_n_m(self, turned_rad: float) -> float:
        """Return the torque of the ball's weight about the edge of the post."""
        arm_m = self.ball_m * math.sin(self.beyond_edge_rad(turned_rad))
        return self.ball_kg * self.gravity_m_per_s2 * arm_m


def half_scene(scene: Scene) -> HalfScene:
    """Return one half of the scene of the task file."""
    ball, beam, support = (scene.body(name) for name in ("ball-2", "beam", "support"))
    (rope,) = scene.deformables
    assert isinstance(rope, Rope)
    assert isinstance(ball.shape, Sphere)
    assert isinstance(beam.shape, Cylinder)
    assert isinstance(support.shape, ConvexUnion)
    start_m = ball.pose.position_m[0] - beam.pose.position_m[0]
    corners_m = [np.array(piece) for piece in support.shape.pieces_m]
    (post_m,) = (piece for piece in corners_m if piece[:, 0].min() > 0.1)
    return HalfScene(
        rope_m=0.5 * rope.length_m,
        rope_kg=0.5 * rope.mass_kg,
        beam_m=beam.shape.radius_m + rope.radius_m,
        ball_m=ball.shape.radius_m,
        ball_kg=ball.mass_kg,
        start_m=start_m,
        edge_m=start_m - float(post_m[:, 0].min()),
        gravity_m_per_s2=scene.gravity_m_per_s2,
    )


class Chain:
    """A chain of rods from the top of the beam to the ball.

    A state is the vector (x, z of each free point, angle of the ball), shape [2 N - 1] for N rods.
    """

    def __init__(self, half: HalfScene, rod_count: int) -> None:
        self.half, self.rod_count = half, rod_count
        self.rod_m = half.rope_m / rod_count
        point_kg = half.rope_kg / rod_count
        masses = np.full(2 * rod_count - 1, point_kg)
        masses[-1] = half.rolling_inertia_kg_m2
        self.inverse_masses = 1.0 / masses

    def start(self) -> Array:
        """Return the state of the straight rope."""
        x_m = self.rod_m * np.arange(1, self.rod_count)
        points_m = np.column_stack([x_m, np.full_like(x_m, self.half.beam_m)])
        return np.append(points_m.ravel(), 0.0)

    def points_m(self, state: Array) -> Array:
        """Return all points of the chain (x, z), shape [N + 1, 2]."""
        first_m = [0.0, self.half.beam_m]
        last_m = self.half.end_m(state[-1])
        return np.vstack([first_m, state[:-1].reshape(-1, 2), last_m])

    def accelerations(self, state: Array) -> Array:
        """Return the accelerations without constraints, shape [2 N - 1]."""
        found = np.zeros_like(state)
        found[1:-1:2] = -self.half.gravity_m_per_s2
        torque_n_m = self.half.weight_torque_n_m(state[-1])
        found[-1] = torque_n_m * self.inverse_masses[-1]
        return found

    def stretches_m2(self, state: Array) -> tuple[Array, Array]:
        """Return half the change of the squared length of each rod, shape [N], and its slopes, shape [N, 2 N - 1]."""
        rods_m = np.diff(self.points_m(state), axis=0)
        stretches_m2 = 0.5 * (np.square(rods_m).sum(axis=1) - self.rod_m**2)
        slopes = np.zeros((self.rod_count, len(state)))
        for rod in range(self.rod_count - 1):
            slopes[rod, 2 * rod : 2 * rod + 2] = rods_m[rod]
            slopes[rod + 1, 2 * rod : 2 * rod + 2] = -rods_m[rod + 1]
        slopes[-1, -1] = rods_m[-1] @ self.half.end_slope_m(state[-1])
        return stretches_m2, slopes

    def gaps_m(self, state: Array, touching: Array) -> tuple[Array, Array]:
        """Return the gaps of some points to the beam, shape [K], and their slopes, shape [K, 2 N - 1]."""
        points_m = state[:-1].reshape(-1, 2)[touching]
        distances_m = np.linalg.norm(points_m, axis=1)
        slopes = np.zeros((len(touching), len(state)))
        rows = np.arange(len(touching))
        slopes[rows, 2 * touching] = points_m[:, 0] / distances_m
        slopes[rows, 2 * touching + 1] = points_m[:, 1] / distances_m
        return distances_m - self.half.beam_m, slopes

    def constraints(self, state: Array, touching: Array) -> tuple[Array, Array]:
        """Return stretches and gaps, shape [N + K], and their slopes."""
        stretches_m2, of_stretches = self.stretches_m2(state)
        gaps_m, of_gaps = self.gaps_m(state, touching)
        values = np.concatenate([stretches_m2 / self.rod_m, gaps_m])
        return values, np.vstack([of_stretches / self.rod_m, of_gaps])

    def projected(
        self, guess: Array, before: Array, touching: Array
    ) -> tuple[Array, Array]:
        """Return the state on the constraints, and the multipliers of the gaps."""
        _, directions = self.constraints(before, touching)
        moves = self.inverse_masses[:, None] * directions.T
        multipliers = np.zeros(len(directions))
        state = guess
        values, slopes = self.constraints(state, touching)
        while np.abs(values).max() > TOLERANCE_M:
            change = np.linalg.solve(slopes @ moves, -values)
            multipliers += change
            state = guess + moves @ multipliers
            values, slopes = self.constraints(state, touching)
        return state, multipliers[self.rod_count :]

    def step(self, guess: Array, before: Array, touching: Array) -> tuple[Array, Array]:
        """Return the next state and the points that touch the beam, which pushes and never pulls."""
        while True:
            state, pushes = self.projected(guess, before, touching)
            distances_m = np.linalg.norm(state[:-1].reshape(-1, 2), axis=1)
            entered = np.flatnonzero(distances_m < self.half.beam_m - 1e-12)
            needed = np.union1d(touching[pushes >= 0.0], entered)
            if np.array_equal(needed, touching):
                return state, touching
            touching = needed


def centres_m(half: HalfScene, rod_count: int, steps_per_frame: int) -> Array:
    """Return the centre of the ball (x, z) at each frame [m], shape [FRAME_COUNT, 2]."""
    chain = Chain(half, rod_count)
    step_s = 1.0 / (FRAME_RATE_HZ * steps_per_frame)
    state = chain.start()
    # A motion from rest is symmetric in time: the state before the start is that of a free step.
    before = state + 0.5 * step_s**2 * chain.accelerations(state)
    touching = np.array([], dtype=int)
    found = [half.centre_m(state[-1])]
    for count in range(1, (FRAME_COUNT - 1) * steps_per_frame + 1):
        guess = 2.0 * state - before + step_s**2 * chain.accelerations(state)
        before, (state, touching) = state, chain.step(guess, state, touching)
        if count % steps_per_frame == 0:
            found.append(half.centre_m(state[-1]))
    return np.array(found)


def main(folder: Path) -> None:
    """Print the convergence, and write the reference."""
    scene = load_experiment(VARIANT).scene
    half = half_scene(scene)
    paths_mm = []
    for rod_count in ROD_COUNTS:
        path_mm = 1e3 * centres_m(half, rod_count, STEPS_PER_FRAME)
        paths_mm.append(path_mm)
        inward_mm = path_mm[0, 0] - path_mm[:, 0]
        print(f"{rod_count:4} rods, inward [mm]:", *np.round(inward_mm, 4))
    finest_mm = paths_mm[-1]
    # The motion does not converge monotonically: the largest change from coarser chains is the uncertainty.
    changes_mm = [np.abs(finest_mm - path_mm) for path_mm in paths_mm[-3:-1]]
    u_mm = np.maximum(*changes_mm)
    print("uncertainty [mm]:", *np.round(np.hypot(*u_mm.T), 4))
    moved_mm = finest_mm - finest_mm[0]
    count = load_experiment(VARIANT).frame_count
    mean_mm = np.full((count, 6), np.nan)
    uncertainty_mm = np.full((count, 6), np.nan)
    for number, (name, inward) in enumerate((("ball-1", 1.0), ("ball-2", -1.0))):
        place_mm = 1e3 * np.array(scene.body(name).pose.position_m)
        moves_mm = np.column_stack(
            [-inward * moved_mm[:, 0], np.zeros(FRAME_COUNT), moved_mm[:, 1]]
        )
        columns = slice(3 * number, 3 * number + 3)
        mean_mm[:FRAME_COUNT, columns] = place_mm + moves_mm
        uncertainty_mm[:FRAME_COUNT, columns] = np.column_stack(
            [u_mm[:, 0], np.zeros(FRAME_COUNT), u_mm[:, 1]]
        )
    store_solution(
        folder / VARIANT,
        kind="numerical",
        coordinates=[f"ball-{n}.{axis}" for n in (1, 2) for axis in "xyz"],
        source=(
            "balls: a chain of 160 rods over the beam pulls balls that roll on their posts and turn about the edge, "
            "until the billiard touches them; u is the largest change from 40 and 80 rods"
        ),
        mean=mean_mm,
        uncertainty=uncertainty_mm,
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else data_folder("scoring") / "bands")
