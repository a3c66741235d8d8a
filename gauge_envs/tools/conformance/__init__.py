"""Conformance checks: small analytic scenes that show whether a backend obeys the laws of mechanics.

    gauge backend check mine

The checks use only the contract of `gauge_envs.backends`, so they run on any engine. A fault that they find affects
benchmark runs too. A check is one function that builds a scene and measures one number:

    @check(
        "free-fall",
        title="free fall",
        scene="a ball that falls from 3 m",
        measures="downward acceleration of a ball, quadratic fit over 0.5 s",
        law="a = g",
        source="Galilei",
        unit="m/s^2",
        tolerance=Tolerance(relative=1e-3, rationale="a fall has no model error"),
        diagnosis="check gravity and damping",
    )
    def free_fall(lab: Lab) -> Measurement:
        rollout = lab.rollout(Scene(bodies=(ball("ball", (0.0, 0.0, 3.0)),), duration_s=0.5), 0.5)
        fit = np.polyfit(rollout.times_s, rollout.position("ball")[:, 2], 2)
        return Measurement(measured=-2.0 * fit[0], expected=GRAVITY_M_PER_S2)

Add it to the module of its kind. The decorator registers it for the command, the table and the tests.
"""

# The order of the checks is that of these imports.
from gauge_envs.tools.conformance import contract, continuation, rigid, pairs, spin  # noqa: F401  # isort: skip
from gauge_envs.tools.conformance import forces, contacts, shapes, slopes, momentum, hinged  # noqa: F401  # isort: skip
from gauge_envs.tools.conformance import driven, collisions, cloth, air, soft, lines  # noqa: F401  # isort: skip
from gauge_envs.tools.conformance import benchmark  # noqa: F401  # isort: skip
from gauge_envs.runs.rollout import Rollout
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.model import Check, CheckResult, Measurement, Status, Tolerance
from gauge_envs.tools.conformance.registry import check, checks
from gauge_envs.tools.conformance.run import run_checks

from gauge_envs.tools.conformance import start  # noqa: F401  # isort: skip

__all__ = [
    "Check",
    "CheckResult",
    "Lab",
    "Measurement",
    "Rollout",
    "Status",
    "Tolerance",
    "check",
    "checks",
    "run_checks",
]
