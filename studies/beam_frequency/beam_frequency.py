"""Frequencies that beams must have by their stated constants: the benchmark's of foam and rubber, and the silicone one.

    python studies/beam_frequency/beam_frequency.py [--only silicone | benchmark] [--fine]

Printed are closed forms, converged elements, and the large swings of a chain.

The chain is a beam of Euler and Bernoulli that may bend as far as it likes: rigid segments of each block of foam on
springs, and rigid blocks of rubber. Its foam is linear, or has the plateau stress of open-cell foam.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from scipy.optimize import brentq, curve_fit, fsolve
from scipy.sparse import coo_array
from scipy.sparse.linalg import eigsh, spsolve

from gauge_envs import load_experiment
from gauge_envs.scene import SoftBody

FloatArray = NDArray[np.float64]
G = 9.80665
PLATEAU_STRAIN = 0.05
"""Strain at which open cells collapse elastically: plateau stress over modulus (Gibson and Ashby, Cellular solids)."""

RUBBER_PA = 1e6
"""Modulus above which a block counts as rigid: the rubber is a hundred times as stiff as the foam."""


@dataclass(frozen=True)
class Piece:
    """A block of a beam: length, width of the square section [m], mass [kg], modulus [Pa], Poisson's ratio."""

    length_m: float
    width_m: float
    mass_kg: float
    modulus_pa: float
    poisson: float

    @property
    def bending_n_m2(self) -> float:
        """Modulus times second moment of the section."""
        return self.modulus_pa * self.width_m**4 / 12.0

    @property
    def shear_n(self) -> float:
        """Shear modulus times shear area, with Cowper's factor of a rectangle."""
        factor = 10.0 * (1.0 + self.poisson) / (12.0 + 11.0 * self.poisson)
        return factor * self.modulus_pa / (2.0 + 2.0 * self.poisson) * self.width_m**2


def pieces(name: str) -> list[Piece]:
    """Return the soft bodies of an experiment in their order along the beam."""
    found = []
    for body in load_experiment(name).scene.deformables:
        assert isinstance(body, SoftBody)
        size = sorted(body.shape.size_m)
        found.append(
            Piece(
                size[2],
                size[0],
                body.mass_kg,
                body.young_modulus_pa,
                body.poisson_ratio,
            )
        )
    return found


def line_frequency_hz(
    beam: Sequence[Piece], *, shear: bool, tip_kg: float = 0.0, count: int = 24
) -> float:
    """Return the lowest bending frequency of straight beam elements, of Timoshenko or of Euler and Bernoulli."""
    nodes = 2 * (count * len(beam) + 1)
    stiffness, mass = np.zeros((nodes, nodes)), np.zeros((nodes, nodes))
    for number, piece in enumerate(beam):
        length = piece.length_m / count
        soft = 12.0 * piece.bending_n_m2 / (piece.shear_n * length**2) if shear else 0.0
        a = length
        local = np.array(
            [
                [12.0, 6.0 * a, -12.0, 6.0 * a],
                [6.0 * a, (4.0 + soft) * a**2, -6.0 * a, (2.0 - soft) * a**2],
                [-12.0, -6.0 * a, 12.0, -6.0 * a],
                [6.0 * a, (2.0 - soft) * a**2, -6.0 * a, (4.0 + soft) * a**2],
            ]
        )
        local *= piece.bending_n_m2 / ((1.0 + soft) * a**3)
        each = piece.mass_kg / count
        lumped = (
            np.diag([0.5, piece.width_m**2 / 24.0, 0.5, piece.width_m**2 / 24.0]) * each
        )
        for element in range(count):
            first = 2 * (number * count + element)
            stiffness[first : first + 4, first : first + 4] += local
            mass[first : first + 4, first : first + 4] += lumped
    mass[-2, -2] += tip_kg
    return float(
        np.sqrt(eigh(stiffness[2:, 2:], mass[2:, 2:], eigvals_only=True)[0])
        / (2.0 * np.pi)
    )


def solid(beam: Sequence[Piece], along: int, across: int) -> tuple[float, float]:
    """Return lowest frequency [Hz] and droop [m] of elements of 27 nodes, linear, for `along` cells a block.

    The elements are those of second order with 27 points of integration, as MuJoCo's.
    """
    gauss = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
    weight = np.array([5.0, 8.0, 5.0]) / 9.0
    corner = list(itertools.product(range(3), repeat=3))

    def shape(x: float) -> tuple[FloatArray, FloatArray]:
        return np.array([x * (x - 1) / 2, 1 - x * x, x * (x + 1) / 2]), np.array(
            [x - 0.5, -2 * x, x + 0.5]
        )

    width = beam[0].width_m
    counts = (2 * along * len(beam) + 1, 2 * across + 1, 2 * across + 1)
    number = np.arange(np.prod(counts)).reshape(counts)
    rows, columns, stiff, weights = [], [], [], []
    for block, piece in enumerate(beam):
        size = np.array([piece.length_m / along, width / across, width / across])
        lame = (
            piece.modulus_pa
            * piece.poisson
            / ((1 + piece.poisson) * (1 - 2 * piece.poisson))
        )
        shear = piece.modulus_pa / (2 + 2 * piece.poisson)
        elastic = np.diag([2 * shear] * 3 + [shear] * 3)
        elastic[:3, :3] += lame
        local, mass = np.zeros((81, 81)), np.zeros((27, 27))
        for i, j, k in corner:
            parts = [shape(gauss[m]) for m in (i, j, k)]
            value = np.array(
                [parts[0][0][a] * parts[1][0][b] * parts[2][0][c] for a, b, c in corner]
            )
            slope = np.array(
                [
                    np.prod(
                        [
                            [parts[e][int(e == d)][n[e]] for n in corner]
                            for e in range(3)
                        ],
                        axis=0,
                    )
                    * 2.0
                    / size[d]
                    for d in range(3)
                ]
            )
            factor = weight[i] * weight[j] * weight[k] * np.prod(size) / 8.0
            strain = np.zeros((6, 27, 3))
            for d in range(3):
                strain[d, :, d] = slope[d]
            for row, (d, e) in enumerate(((0, 1), (1, 2), (0, 2)), start=3):
                strain[row, :, d], strain[row, :, e] = slope[e], slope[d]
            flat = strain.reshape(6, 81)
            local += factor * flat.T @ elastic @ flat
            mass += (
                factor
                * piece.mass_kg
                / (piece.length_m * width**2)
                * np.outer(value, value)
            )
        for cell in itertools.product(range(along), range(across), range(across)):
            start = (2 * (block * along + cell[0]), 2 * cell[1], 2 * cell[2])
            nodes = number[
                start[0] : start[0] + 3,
                start[1] : start[1] + 3,
                start[2] : start[2] + 3,
            ].ravel()
            dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
            rows.append(np.repeat(dofs, 81))
            columns.append(np.tile(dofs, 81))
            stiff.append(local.ravel())
            weights.append(np.kron(mass, np.eye(3)).ravel())
    places = np.concatenate(rows), np.concatenate(columns)
    total = 3 * number.size
    free = np.setdiff1d(
        np.arange(total), (3 * number[0].ravel()[:, None] + np.arange(3)).ravel()
    )
    stiffness = coo_array(
        (np.concatenate(stiff), places), shape=(total, total)
    ).tocsc()[free][:, free]
    inertia = coo_array(
        (np.concatenate(weights), places), shape=(total, total)
    ).tocsc()[free][:, free]
    down = np.zeros(total)
    down[2::3] = G
    droop = spsolve(stiffness, inertia @ down[free])
    full = np.zeros(total)
    full[free] = droop
    square = eigsh(
        stiffness, k=1, M=inertia, sigma=0.0, which="LM", return_eigenvectors=False
    )[0]
    return float(np.sqrt(square) / (2.0 * np.pi)), float(
        full[3 * number[-1, across, across] + 2]
    )


Law = Callable[[FloatArray], FloatArray]
"""Bending moments [N m] of curvatures [1/m]."""


def linear_law(piece: Piece) -> Law:
    """Return the law of linear foam."""
    return lambda curvature: piece.bending_n_m2 * curvature


def plateau_law(piece: Piece) -> Law:
    """Return the law of foam whose compressive stress stays at 5 % of the modulus, without axial force."""
    height = np.linspace(-0.5, 0.5, 401) * piece.width_m
    strip = piece.width_m * (height[1] - height[0])
    curvatures = np.linspace(0.0, 80.0, 161)

    def stress(strain: FloatArray) -> FloatArray:
        return piece.modulus_pa * np.maximum(strain, -PLATEAU_STRAIN)

    moments = []
    for curvature in curvatures:
        most = 0.5 * curvature * piece.width_m + 1.0

        def force(middle: float, bent: float = curvature) -> float:
            return float(stress(middle + bent * height).sum())

        middle = float(brentq(force, -most, most))
        moments.append(
            float((stress(middle + curvature * height) * height).sum() * strip)
        )
    table = np.array(moments)
    return lambda curvature: (
        np.sign(curvature) * np.interp(np.abs(curvature), curvatures, table)
    )


FACTORS = {
    ("soft", "linear"): (1.0, 0.5, 0.35, 0.25, 0.18, 0.12),
    ("soft", "plateau"): (1.0, 0.7, 0.5),
    ("hard", "linear"): (1.0,),
}
"""Factors on the modulus of the foam."""


class Chain:
    """Rigid segments of foam on springs, and rigid blocks of rubber; angles are below the level, in radians."""

    def __init__(
        self, beam: Sequence[Piece], law: Callable[[Piece], Law], count: int
    ) -> None:
        lengths, masses, inertias, soft = [], [], [], []
        for piece in beam:
            parts = 1 if piece.modulus_pa > RUBBER_PA else count
            length, mass = piece.length_m / parts, piece.mass_kg / parts
            lengths += [length] * parts
            masses += [mass] * parts
            inertias += [mass * (length**2 + piece.width_m**2) / 12.0] * parts
            soft += [0.0 if parts == 1 else length] * parts
        # Soft segments bend between their middles, half as far beside a rigid block. All foam of a beam is alike.
        self.bends_m = 0.5 * (np.array(soft) + np.array([0.0, *soft[:-1]]))
        self.law = law(next(piece for piece in beam if piece.modulus_pa <= RUBBER_PA))
        size = len(lengths)
        levers = np.tril(np.tile(lengths, (size, 1)), -1) + 0.5 * np.diag(lengths)
        self.lengths, self.inertias = np.array(lengths), np.diag(inertias)
        self.couplings = levers.T @ (np.array(masses)[:, None] * levers)
        self.weights = G * levers.T @ np.array(masses)

    def torques(self, angles: FloatArray) -> FloatArray:
        """Return generalized forces of elasticity and weight [N m]."""
        moments = self.law(np.diff(angles, prepend=0.0) / self.bends_m)
        return self.weights * np.cos(angles) - moments + np.append(moments[1:], 0.0)

    def hang(self) -> FloatArray:
        """Return the angles at rest; the weight is raised in steps."""
        angles = np.zeros(len(self.lengths))
        for share in np.linspace(0.1, 1.0, 10):
            full, self.weights = self.weights, share * self.weights
            angles = np.asarray(fsolve(self.torques, angles))
            self.weights = full
        return angles

    def frequency_hz(self, angles: FloatArray) -> float:
        """Return the lowest frequency of small swings about angles at rest."""
        step = 1e-4
        unit = step * np.eye(len(angles))
        stiffness = -np.array(
            [self.torques(angles + one) - self.torques(angles - one) for one in unit]
        ) / (2 * step)
        mass = self.couplings * np.cos(angles[:, None] - angles) + self.inertias
        return float(
            np.sqrt(eigh(0.5 * (stiffness + stiffness.T), mass, eigvals_only=True)[0])
            / (2 * np.pi)
        )

    def line_angle(self, angles: FloatArray) -> FloatArray:
        """Return the angle from hanging straight down of the line from the root to the middle of the last block."""
        reach = np.append(self.lengths[:-1], 0.5 * self.lengths[-1])
        return np.asarray(
            np.arctan2(
                (reach * np.cos(angles.T)).sum(-1), (reach * np.sin(angles.T)).sum(-1)
            )
        )

    def release(self, decay_per_s: float) -> tuple[float, float, float]:
        """Return frequency [Hz], middle and first low of the line's angle [rad] of a release from the level.

        Fitted as the recording was, from 0.25 s to 1.41 s. The drag is proportional to inertia and velocity.
        """

        def rate(_: float, state: FloatArray) -> FloatArray:
            angles, speeds = np.split(state, 2)
            apart = angles[:, None] - angles
            mass = self.couplings * np.cos(apart) + self.inertias
            pull = self.torques(angles) - (self.couplings * np.sin(apart)) @ speeds**2
            return np.concatenate(
                [speeds, np.linalg.solve(mass, pull) - 2.0 * decay_per_s * speeds]
            )

        times = np.arange(0.0, 1.41, 0.005)
        start = np.zeros(2 * len(self.lengths))
        found = solve_ivp(
            rate,
            (0.0, times[-1]),
            start,
            t_eval=times,
            method="LSODA",
            rtol=1e-6,
            atol=1e-8,
        )
        angle = self.line_angle(found.y[: len(self.lengths)])

        def swing(
            t: FloatArray,
            mean: float,
            size: float,
            decay: float,
            hz: float,
            phase: float,
        ) -> FloatArray:
            return np.asarray(
                mean + size * np.exp(-decay * t) * np.cos(2 * np.pi * hz * t + phase)
            )

        late = times >= 0.25
        guesses = (
            [angle.mean(), 0.5, decay_per_s, hz, phase]
            for hz in (1.5, 2.5, 3.5)
            for phase in (0.0, 2.0, 4.0)
        )
        fits = []
        for guess in guesses:
            try:
                constants, _ = curve_fit(
                    swing, times[late], angle[late], guess, maxfev=4000
                )
            except RuntimeError:
                continue
            fits.append(
                (
                    float(np.sum((swing(times[late], *constants) - angle[late]) ** 2)),
                    constants,
                )
            )
        best = min(fits, key=lambda fit: fit[0])[1]
        return abs(float(best[3])), float(best[0]), float(angle.min())


def silicone(fine: bool) -> None:
    """Print what the constants of the silicone beam give."""
    (beam,) = pieces("SiliconeBeam-0g-silicone")
    for label, tip_kg in (("0 g", 0.0), ("52 g", 0.052), ("101 g", 0.101)):
        values = [
            line_frequency_hz([beam], shear=shear, tip_kg=tip_kg)
            for shear in (False, True)
        ]
        print(
            f"silicone, {label}: Euler and Bernoulli {values[0]:.2f} Hz, Timoshenko {values[1]:.2f} Hz"
        )
    for poisson in (0.3, beam.poisson):
        one = Piece(beam.length_m, beam.width_m, beam.mass_kg, beam.modulus_pa, poisson)
        for along, across in (
            (4, 2),
            (8, 2),
            (8, 4),
            (16, 4),
            *(((16, 6),) if fine else ()),
        ):
            hz, droop_m = solid([one], along, across)
            print(
                f"silicone, 0 g, nu {poisson}, {along} x {across} x {across} cells: {hz:.2f} Hz, {1e3 * droop_m:.2f} mm"
            )


def scaled(beam: Sequence[Piece], factor: float) -> list[Piece]:
    """Return a beam whose soft blocks have a modulus times a factor."""
    return [
        Piece(
            p.length_m,
            p.width_m,
            p.mass_kg,
            p.modulus_pa * (factor if p.modulus_pa < RUBBER_PA else 1.0),
            p.poisson,
        )
        for p in beam
    ]


def benchmark(fine: bool) -> None:
    """Print what the constants of the benchmark's beam give."""
    for name in ("soft", "hard"):
        beam = pieces(f"CantileverBeam-{name}")
        values = [line_frequency_hz(beam, shear=shear) for shear in (False, True)]
        print(
            f"{name}, straight: Euler and Bernoulli {values[0]:.2f} Hz, Timoshenko {values[1]:.2f} Hz"
        )
        for along, across in ((2, 1), (2, 2), (4, 3), *(((6, 5),) if fine else ())):
            hz, droop_m = solid(beam, along, across)
            print(
                f"{name}, straight, {along} x {across} x {across} cells a block: {hz:.2f} Hz, {1e3 * droop_m:.1f} mm"
            )
        chains = [("linear", linear_law), ("plateau", plateau_law)]
        for label, law in chains[: 2 if name == "soft" else 1]:
            chain = Chain(beam, law, 16)
            hung = chain.hang()
            curvature = float(hung[15] - hung[0]) / (15.0 / 16.0 * beam[0].length_m)
            angle, strain = chain.line_angle(hung), 0.5 * curvature * beam[0].width_m
            print(
                f"{name}, {label}: hangs at {angle:.2f} rad, {chain.frequency_hz(hung):.2f} Hz; curvature of the first "
                f"block {curvature:.1f} 1/m, strain of its surface {strain:.2f}"
            )
            for factor in FACTORS[name, label]:
                hz, middle, low = Chain(scaled(beam, factor), law, 6).release(0.93)
                print(
                    f"{name}, {label}, modulus x {factor}: {hz:.2f} Hz about {middle:.2f} rad, first low {low:.2f} rad"
                )


def pressed(depth_m: float = 0.038, span_m: float = 0.1743) -> None:
    """Print force and local strain of the clamped foam of FoamBending, whose middle is pressed down by a cube.

    Central load on a clamped beam of Timoshenko. The strain under the cube does not depend on the modulus.
    """
    for name in ("soft", "hard"):
        (foam,) = pieces(f"FoamBending-{name}")
        give = span_m**3 / (192.0 * foam.bending_n_m2) + span_m / (4.0 * foam.shear_n)
        force = depth_m / give
        stress = force / foam.width_m**2
        strain = stress / foam.modulus_pa
        print(
            f"FoamBending-{name}: {force:.0f} N, {1e-3 * stress:.1f} kPa under the cube: strain {strain:.2f}"
        )


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(
        description="Frequencies that beams must have by their stated constants."
    )
    parser.add_argument("--fine", action="store_true")
    parser.add_argument("--only", choices=("silicone", "benchmark"))
    options = parser.parse_args()
    if options.only != "benchmark":
        silicone(options.fine)
    if options.only != "silicone":
        pressed()
        benchmark(options.fine)


if __name__ == "__main__":
    main()
