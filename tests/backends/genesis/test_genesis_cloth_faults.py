"""Faults planted in Genesis's cloth, each of which a conformance check of cloth catches."""

import numpy as np
import pytest

pytest.importorskip("genesis", reason="extra 'genesis' is not installed")

from gauge_envs.backends.genesis import cloth, parts
from gauge_envs.backends.genesis.kernels import PBDKernels
from gauge_envs.tools.conformance import Status, run_checks


def bending_compliance_halved(patch):
    """Hinges are twice as stiff."""
    healthy = PBDKernels.set_compliance
    patch.setattr(
        PBDKernels, "set_compliance", lambda self, values: healthy(self, 0.5 * values)
    )


def friction_halved(patch):
    """Bodies rub half as much."""
    healthy = PBDKernels.set_friction
    patch.setattr(
        PBDKernels, "set_friction", lambda self, values: healthy(self, 0.5 * values)
    )


def border_springs_whole(patch):
    """Springs on the border have the stiffness of those inside."""
    healthy = cloth.grid_stiffnesses

    def whole(*arguments):
        found = healthy(*arguments)
        along = found.max()
        return np.where(np.isclose(found, 0.5 * along), along, found)

    patch.setattr(cloth, "grid_stiffnesses", whole)


def held_edge_late(patch):
    """Held particles are where their body was one step earlier."""
    healthy = parts.later_targets
    patch.setattr(
        parts,
        "later_targets",
        lambda targets, times: healthy(targets, times - times[1]),
    )


FAULTS = [
    (bending_compliance_halved, "cloth-bending", 2.0, 0.1),
    (friction_halved, "cloth-slide", 1.54, 0.05),
    (border_springs_whole, "cloth-stretch", 1.25, 0.05),
]
"""Fault, check, expected ratio of measured to expected value, and its relative tolerance."""


@pytest.mark.slow
@pytest.mark.parametrize(("plant", "check", "ratio", "tolerance"), FAULTS)
def test_a_fault_in_cloth_fails_its_check(plant, check, ratio, tolerance, monkeypatch):
    plant(monkeypatch)
    (result,) = run_checks("genesis", only=(check,))
    assert result.status is Status.FAIL
    assert result.measured / result.expected == pytest.approx(ratio, rel=tolerance)


@pytest.mark.slow
def test_an_edge_that_lags_one_step_fails_its_check(monkeypatch):
    held_edge_late(monkeypatch)
    (result,) = run_checks("genesis", only=("cloth-pinned-edge",))
    assert result.status is Status.FAIL
