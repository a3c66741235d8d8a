"""Energy ledger of driven scenes in MuJoCo: no material gains energy that the driver did not supply.

Kinetic, potential and elastic energy of all that moves freely, less the work of the driven body, may only fall:
friction, impacts and the implicit integrator take energy away, and nothing else may add any.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import pytest
from cloths import FABRICS
from numpy.typing import NDArray

from gauge_envs import load_experiment
from gauge_envs.backends.mujoco import BackendMuJoCo
from gauge_envs.backends.mujoco.cloth import BENDING_PER_EDGE, STIFFNESS_PER_TRIANGLE
from gauge_envs.scene.prescribed_motion import prescribed_motions
from gauge_envs.scene.timing import FRAME_RATE_HZ, SAMPLE_INTERVAL_S, SAMPLES_PER_FRAME

SHARE = 0.02
"""Energy from nowhere that is allowed, as a share of the work done."""

NO_ACTION = np.zeros((1, 1))


class Energies:
    """Energies of the free material of a simulation, from its model's own tables.

    Args:
        simulation: The simulation; a cloth's reference shape is where it starts.
        driven: Name of the driven body, whose energy is left out.
    """

    def __init__(self, simulation, driven):
        self._simulation = simulation
        self._model = simulation.model
        self._scratch = mujoco.MjData(self._model)
        start = int(self._model.joint(driven).dofadr[0])
        self._driven_dofs = slice(start, start + 6)
        self._masses = self._model.body_mass.copy()
        self._masses[self._model.body(driven).id] = 0.0
        self._kinematics()
        self._rest_m2 = {flex: self._squared_edges(flex) for flex in self._cloths()}

    def now(self):
        """Kinetic, potential and elastic energy now [J]."""
        self._scratch.qpos[:] = self._simulation.data.qpos
        self._kinematics()
        velocity = self._simulation.data.qvel.copy()
        velocity[self._driven_dofs] = 0.0
        momentum = np.empty_like(velocity)
        mujoco.mj_makeM(self._model, self._scratch)
        mujoco.mj_mulM(self._model, self._scratch, momentum, velocity)
        potential = -float(
            self._masses @ (self._scratch.xipos @ self._model.opt.gravity)
        )
        return (
            0.5 * float(velocity @ momentum),
            potential,
            sum(self._elastic(flex) for flex in self._cloths()),
        )

    def elastic_at(self, qpos):
        """Elastic energy at given joint positions [J]."""
        self._scratch.qpos[:] = qpos
        self._kinematics()
        return sum(self._elastic(flex) for flex in self._cloths())

    def _kinematics(self):
        mujoco.mj_kinematics(self._model, self._scratch)
        mujoco.mj_comPos(self._model, self._scratch)
        mujoco.mj_flex(self._model, self._scratch)

    def _cloths(self):
        return [int(flex) for flex in np.flatnonzero(self._model.flex_dim == 2)]

    def _vertices(self, flex):
        first = self._model.flex_vertadr[flex]
        return self._scratch.flexvert_xpos[
            first : first + self._model.flex_vertnum[flex]
        ]

    def _squared_edges(self, flex):
        """Squared edge lengths [m^2] from vertex 1 to 2, 2 to 0 and 0 to 1, shape [triangle_count, 3]."""
        first, count = (
            self._model.flex_elemdataadr[flex],
            self._model.flex_elemnum[flex],
        )
        corners = self._vertices(flex)[
            self._model.flex_elem[first : first + 3 * count].reshape(-1, 3)
        ]
        return ((corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]) ** 2).sum(axis=2)

    def _elastic(self, flex):
        """Membrane energy s' S s / 4 a triangle and bending energy x' B x / 2 an edge [J]."""
        changes = self._squared_edges(flex) - self._rest_m2[flex]
        start = self._model.flex_stiffnessadr[flex]
        table = self._model.flex_stiffness[
            start : start + STIFFNESS_PER_TRIANGLE * len(changes)
        ]
        stiffness = np.zeros((len(changes), 3, 3))
        rows, columns = np.triu_indices(3)
        stiffness[:, rows, columns] = table.reshape(-1, STIFFNESS_PER_TRIANGLE)[:, :6]
        stiffness[:, columns, rows] = stiffness[:, rows, columns]
        membrane = 0.25 * np.einsum("ti,tij,tj", changes, stiffness, changes)

        first, count = self._model.flex_edgeadr[flex], self._model.flex_edgenum[flex]
        flaps = self._model.flex_edgeflap[first : first + count]
        folds = (flaps >= 0).all(axis=1)
        ends = np.column_stack([self._model.flex_edge[first : first + count], flaps])[
            folds
        ]
        start = self._model.flex_bendingadr[flex]
        forms = self._model.flex_bending[
            start : start + BENDING_PER_EDGE * count
        ].reshape(-1, BENDING_PER_EDGE)
        points = self._vertices(flex)[ends]
        # About their mean: a form does not see where its four points are, but rounding does.
        points = points - points.mean(axis=1, keepdims=True)
        bending = 0.5 * np.einsum(
            "eix,eij,ejx", points, forms[folds, :16].reshape(-1, 4, 4), points
        )
        return float(membrane + bending)


@dataclass(frozen=True, kw_only=True)
class Ledger:
    """Energies and work at the frames of an episode.

    Attributes:
        parts_j: Kinetic, potential and elastic energy of the free material [J], shape [frame_count, 3].
        work_j: Work that the driven body has done on it [J], shape [frame_count].
    """

    parts_j: NDArray[np.float64]
    work_j: NDArray[np.float64]

    @property
    def unpaid_j(self):
        """Energy gained since the start, less the work done [J], shape [frame_count]."""
        energy = self.parts_j.sum(axis=1)
        return energy - energy[0] - self.work_j

    @property
    def largest_rise_j(self):
        """The most by which energy less work rises between any two frames [J]."""
        return float((self.unpaid_j - np.minimum.accumulate(self.unpaid_j)).max())


def ledger(name, frame_count, *, parameters=None, settings=None, clock_s=0.0):
    """Run a scene with one driven body, step by step.

    The work is what the impulses of cloth, rope and contacts take out of the driven body: what its velocity changes by,
    less what the driver's own force does, times its huge mass. It holds for whatever the integrator makes of forces.

    Args:
        name: Variant.
        frame_count: Frames, the first included.
        parameters: Overrides of calibrated constants.
        settings: What differs from the preset.
        clock_s: Time of the driver at the start [s].
    """
    experiment = load_experiment(name, parameters or {})
    simulation = BackendMuJoCo().build(experiment.scene, settings)
    simulation.reset()
    (driver,) = experiment.scene.drivers
    (motion,) = prescribed_motions(experiment.scene, experiment.scene.duration_s)
    energies = Energies(simulation, driver.body)
    mass, timestep = (
        simulation.settings["kinematic_mass_kg"],
        simulation.settings["timestep_s"],
    )
    first = round(clock_s / SAMPLE_INTERVAL_S)
    parts, works, work = [energies.now()], [0.0], 0.0
    for sample in range((frame_count - 1) * SAMPLES_PER_FRAME):
        target = motion.targets(first + sample, NO_ACTION)[0]
        acceleration = target[0, 13:]
        simulation.drive(driver.body, target)
        before = simulation.body_states([driver.body])[0, 0, 7:]
        for _ in range(round(SAMPLE_INTERVAL_S / timestep)):
            mujoco.mj_step(simulation.model, simulation.data)
            after = simulation.body_states([driver.body])[0, 0, 7:]
            impulse = mass * (after - before - timestep * acceleration)
            work -= 0.5 * float(impulse @ (before + after))
            before = after
        if (sample + 1) % SAMPLES_PER_FRAME == 0:
            parts.append(energies.now())
            works.append(work)
    return Ledger(parts_j=np.array(parts), work_j=np.array(works))


def check(book):
    """Energy rose by no more than the work, neither since the start nor between any two frames.

    What is allowed is a share of the most work, given or taken, so far; a driver that lowers a cloth takes some.
    """
    allowed = SHARE * np.maximum.accumulate(np.abs(book.work_j))
    assert allowed[-1] > 0.0
    # The work of a driver that touches nothing is rounding of its 1000 kg.
    assert (book.unpaid_j <= allowed + 1e-9).all()
    assert book.largest_rise_j <= allowed[-1]


# Everything stays 2 mm off the mid-plane of a cloth that touches itself: the one on the board starts inside that layer.
ON_ITS_LAYER = {"textile.position_m": [0.4785, 0.4285, 0.188]}


def test_elastic_energy_is_that_of_mujocos_forces():
    """Its slope along a random direction, at a random shape, is the force that MuJoCo applies."""
    simulation = BackendMuJoCo().build(load_experiment("TextileFlinging-rayon").scene)
    model, data = simulation.model, simulation.data
    energies = Energies(simulation, "rod")
    random = np.random.default_rng(0)
    assert model.joint("rod").dofadr[0] == 0
    data.qpos[7:] += 1e-3 * random.standard_normal(model.nv - 6)
    direction = np.concatenate([np.zeros(6), random.standard_normal(model.nv - 6)])
    step = 1e-7 * np.concatenate([[0.0], direction])
    slope = (
        energies.elastic_at(data.qpos + step) - energies.elastic_at(data.qpos - step)
    ) / 2e-7
    mujoco.mj_forward(model, data)
    assert slope == pytest.approx(-float(data.qfrc_passive @ direction), rel=1e-6)


def test_ledger_closes_where_nothing_rubs():
    """A cloth swung by its edge keeps what the rod gives it, less 2 %: the work is measured right, not just enough."""
    book = ledger("TextileFlinging-rayon", 16)
    check(book)
    assert book.unpaid_j[-1] > -0.02 * book.work_j[-1]


@pytest.mark.slow
def test_finer_steps_lose_less():
    """What the implicit integrator takes away is of first order in the step."""
    coarse, fine = (
        ledger("TextileFlinging-rayon", 10, settings={"timestep_s": step})
        for step in (1 / 900, 1 / 1800)
    )
    assert coarse.unpaid_j[-1] < fine.unpaid_j[-1] < 0.0


@pytest.mark.slow
def test_cloth_is_lifted_out_of_the_board_once():
    """As published, cloth and board touch; the push onto its contact layer is the only energy from nowhere."""
    book = ledger("Funnel-rayon", 8)
    cloth = load_experiment("Funnel-rayon").scene.deformables[0]
    lift_j = 0.08576 * 9.80665 * 0.002
    assert cloth.mass_kg == 0.08576
    assert 0.0 < book.unpaid_j.max() < lift_j
    assert (np.diff(book.unpaid_j)[1:] < 0.0).all()


EPISODES = [
    # The rope's jerk stores 4 mJ, 1 % of the work, in its constraints and returns 3.
    ("RopeWinding-rubber", 90, {}, 0.0),
    # The ball turns from the start instead of after a second.
    ("RotatingBall-rayon", 16, {}, 1.0),
    ("RotatingBall-rayon", 90, {}, 0.0),
    ("RotatingBall-satin", 90, {}, 0.0),
    ("RotatingBall-uniform", 90, {}, 0.0),
    # The ball starts just above the cloth, at the speed that it has after one second.
    (
        "Funnel-rayon",
        14,
        ON_ITS_LAYER | {"ball.position_m": [0.4785, 0.4285, 0.3257]},
        1.0,
    ),
    ("Funnel-rayon", 90, ON_ITS_LAYER, 0.0),
    ("Funnel-satin", 90, ON_ITS_LAYER, 0.0),
    ("TextileBending-rayon", 90, {}, 0.0),
    ("TextileStretching-rayon", 90, {}, 0.0),
    *((f"TextileFlinging-{fabric}", 60, {}, 0.0) for fabric in FABRICS),
]
"""Up to three seconds, as published but for a cloth that starts on its contact layer; last, the time at the start."""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "frames", "parameters", "clock_s"), EPISODES)
def test_energy_comes_from_the_driver_alone(name, frames, parameters, clock_s):
    last = round(load_experiment(name).scene.duration_s * FRAME_RATE_HZ) + 1
    check(ledger(name, min(frames, last), parameters=parameters, clock_s=clock_s))
