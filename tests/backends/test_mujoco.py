"""Traps of MuJoCo with rigid bodies: heavy driven bodies, states that it resets, and settings of other versions.

Expected values follow from Coulomb's law, from symmetry, and from MuJoCo's release notes.
"""

import mujoco
import numpy as np
import pytest

from gauge_envs import load_experiment
from gauge_envs.backends import backend
from gauge_envs.backends.mujoco.options import constants_of
from gauge_envs.backends.mujoco.simulation import SimulationMuJoCo
from gauge_envs.backends.mujoco.versions import LATER_SETTINGS, UNSTEADY_BOXES
from gauge_envs.errors import ParameterError
from gauge_envs.runs.batch import run_many
from gauge_envs.runs.request import RunRequest
from gauge_envs.runs.result import Outcome
from gauge_envs.tools.conformance import run_checks

MUJOCO = backend("mujoco")
RIGID = load_experiment("SlopeSlider-2-wood").scene
CLOTH = load_experiment("TextileFlinging-satin").scene


# --- motion ----------------------------------------------------------------------------------------------------------


def test_a_tilting_board_lets_a_cube_go_at_the_friction_angle(rollout):
    env, trajectory, _ = rollout("SlopeSlider-3-metal")
    scene = env.experiment.scene
    driver, start = scene.drivers[0], scene.body("board").pose
    along_board_m = np.array(
        [
            driver.pose(start, time_s).to_body(1e-3 * sample)[0]
            for time_s, sample in zip(
                trajectory.times_s, trajectory.samples, strict=True
            )
        ]
    )
    slipped = np.abs(along_board_m - along_board_m[0]) > 2e-4
    tilt_rad = driver.motions[0].value(trajectory.times_s[np.argmax(slipped)])
    late_deg = np.degrees(tilt_rad - np.arctan(scene.contacts[0].friction))
    # 0.2 mm of slip at the growing acceleration takes about 0.05 s, which is 0.7 degrees of tilt.
    assert 0.0 < late_deg < 1.2


@pytest.mark.skipif(
    mujoco.__version__ in UNSTEADY_BOXES, reason="box contacts jump in this release"
)
def test_the_residual_of_a_heavy_driven_board_does_not_move_a_light_cube(rollout):
    """The cube stays in the plane of symmetry. The tolerance of the solver is relative to the board's 1000 kg."""

    def sideways_mm(**settings):
        _, trajectory, _ = rollout("SlopeSlider-3-wood", settings=settings)
        return float(np.ptp(trajectory.frames[:, 1]))

    assert sideways_mm() < 1e-6
    coarse_mm = sideways_mm(integrator="implicitfast")
    assert coarse_mm > 0.01
    fine_mm = sideways_mm(integrator="implicitfast", tolerance=1e-12)
    assert fine_mm < 0.1 * coarse_mm


@pytest.mark.parametrize("integrator", ["RK4", "Euler", "implicitfast"])
def test_driven_bodies_arrive_where_they_are_prescribed(integrator):
    """Five blocks slide and turn at up to 34 m/s^2 and 86 rad/s^2; a speed at the end of a step is a h / 2 too high."""
    settings = {"integrator": integrator, "timestep_s": 1 / 900}
    (result,) = run_checks("mujoco", settings=settings, only=("driven-path",))
    assert result.measured < 1e-9


def test_a_state_that_mujoco_resets_counts_as_diverged():
    unstable = {
        "sustained_solref": [1e-6, 0.1],
        "refsafe": False,
        "timestep_s": 1 / 180,
    }
    (result,) = run_many([RunRequest("Turntable-1-wood", settings=unstable)])
    assert result.outcome is Outcome.DIVERGED
    assert result.score.rmse is None
    assert "reset the state" in str(result.diverged_reason)


# --- versions --------------------------------------------------------------------------------------------------------


@pytest.fixture
def older(monkeypatch):
    """MuJoCo 3.11, as far as this package asks for it."""
    monkeypatch.setattr(mujoco, "__version__", "3.11.0")


@pytest.mark.usefixtures("older")
def test_an_older_version_runs_rigid_scenes_without_the_settings_that_it_lacks():
    (reason,) = MUJOCO.supports(CLOTH).missing
    assert "install mujoco>=4" in reason
    settings = MUJOCO.build(RIGID).settings
    assert "speculative" not in settings
    assert settings["integrator"] == "Euler"


@pytest.mark.parametrize(
    ("settings", "condim"),
    [({"torsional_friction_m": 0.1}, 4), ({"rolling_friction_m": 0.1, "condim": 4}, 6)],
)
def test_a_friction_that_condim_ignores_is_an_error(settings, condim):
    with pytest.raises(ParameterError, match=f"change nothing: set condim={condim}"):
        MUJOCO.build(RIGID, settings)


@pytest.mark.usefixtures("older")
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"speculative": False}, r"'speculative': .* 3\.11\.0 .*MuJoCo 4\.0: leave it"),
        ({"preset": "rod"}, r"'integrator': .*no value 'discrete', .*MuJoCo 3\.13"),
    ],
)
def test_a_setting_that_the_installed_version_lacks_is_an_error(settings, message):
    with pytest.raises(ParameterError, match=message):
        MUJOCO.build(RIGID, settings)


def test_features_are_installed_from_their_first_version_on():
    installed = [int(part) for part in mujoco.__version__.split(".")[:2]]
    assert MUJOCO.supports(RIGID)
    assert bool(MUJOCO.supports(CLOTH)) is (installed >= [4, 0])
    has_discrete = hasattr(mujoco.mjtIntegrator, "mjINT_DISCRETE")
    has_speculative = hasattr(mujoco.mjtEnableBit, "mjENBL_SPECULATIVE")
    installed_settings = [later.is_installed for later in LATER_SETTINGS]
    assert installed_settings == [has_discrete, has_speculative]
    euler = constants_of(mujoco.mjtIntegrator, "mjINT_", ("Euler", "later"))
    assert euler == {"Euler": int(mujoco.mjtIntegrator.mjINT_EULER)}


def test_an_episode_shows_the_states_of_a_subclass():
    """An engine of another author may change what bodies report, and nothing else."""

    class Shifted(SimulationMuJoCo):
        def body_states(self, names):
            return super().body_states(names) + 1.0

    simulation = MUJOCO.build(RIGID)
    simulation.__class__ = Shifted
    simulation.reset()
    rows = np.zeros((1, 1, 1, 13))
    sampler = simulation.sampler(["cube"], rows)
    sampler.read(0)
    sampler.finish()
    np.testing.assert_array_equal(rows[0], simulation.body_states(["cube"]))
