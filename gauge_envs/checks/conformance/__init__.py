"""Conformance kit: small analytic scenes that tell whether a backend obeys the laws, and where to look if not.

    gauge backend check mine

Everything goes through the contract of `gauge_envs.backends`, so the kit works on any engine, and what it finds is what
a benchmark run would suffer from. A check is one function that builds a scene and measures one number:

    @check(
        "free-fall",
        title="free fall",
        measures="downward acceleration of a ball, quadratic fit over 0.5 s",
        law="a = g",
        source="Galilei",
        unit="m/s^2",
        tolerance=Tolerance(relative=1e-3, rationale="a fall has no model error"),
        diagnosis="look at gravity and damping",
    )
    def free_fall(lab: Lab) -> Measurement:
        course = lab.course(Scene(bodies=(ball("ball", (0.0, 0.0, 3.0)),), duration_s=0.5), 0.5)
        fit = np.polyfit(course.times_s, course.position("ball")[:, 2], 2)
        return Measurement(measured=-2.0 * fit[0], expected=GRAVITY_M_PER_S2)

Put it into the module of its kind; the decorator makes it known to the command, the table and the tests.
"""

# The order of the checks is that of these imports.
from gauge_envs.checks.conformance import contract, rigid, contacts, driven, cloth, soft, lines  # noqa: F401  # isort: skip
from gauge_envs.checks.conformance.kit import (
    Check,
    CheckResult,
    Measurement,
    Status,
    Tolerance,
    check,
    checks,
    run_checks,
)
from gauge_envs.checks.conformance.lab import Lab
from gauge_envs.checks.rollout import Course

__all__ = [
    "Check",
    "Course",
    "CheckResult",
    "Lab",
    "Tolerance",
    "Measurement",
    "Status",
    "check",
    "checks",
    "run_checks",
]
