"""Conformance checks: small analytic scenes that show whether an engine obeys the laws of mechanics.

    gauge backend check mine

The checks use only the contract of `gauge_envs.backends`, so they run on any engine. A check is one function that
builds a scene and measures one number; its docstring has the scene and the measured quantity:

    check = Checks(Level.RIGID)


    @check(
        "free-fall",
        title="free fall",
        law="a = g",
        unit="m/s^2",
        tolerance=Tolerance("a fall has no model error", relative=1e-3),
        cause="the engine has a gravity of its own, or damps free bodies",
    )
    def free_fall(lab: Lab) -> Measurement:
        \"\"\"A ball that falls from 3 m.

        Downward acceleration, by a quadratic fit over 0.5 s.

        Source: Galilei.
        \"\"\"
        rollout = lab.rollout(Scene(bodies=(ball("ball", (0.0, 0.0, 3.0)),), duration_s=0.5))
        height_m = rollout.position("ball")[:, 2]
        measured = -acceleration_m_per_s2(rollout.times_s, height_m)
        return Measurement(measured=measured, expected=GRAVITY_M_PER_S2)

Add it to a module of checks, which `catalog` lists. The decorator registers it for the command, the table and the
tests. Checks that share a scene share its recording by `Lab.once`.
"""

from typing import TYPE_CHECKING

from gauge_envs.registry import lazy_names

if TYPE_CHECKING:
    from gauge_envs.tools.conformance.catalog import checks as checks
    from gauge_envs.tools.conformance.cloth import (
        BENT_FREE_M as BENT_FREE_M,
        bending_stiffness as bending_stiffness,
        cantilever_strip as cantilever_strip,
    )
    from gauge_envs.tools.conformance.lab import (
        Lab as Lab,
        Measurement as Measurement,
    )
    from gauge_envs.tools.conformance.model import (
        Check as Check,
        CheckResult as CheckResult,
        Checks as Checks,
        Level as Level,
        Status as Status,
        Tolerance as Tolerance,
    )
    from gauge_envs.tools.conformance.run import run_checks as run_checks
else:
    __getattr__, __all__ = lazy_names(
        __name__,
        {
            ".catalog": ["checks"],
            ".cloth": [
                "BENT_FREE_M",
                "bending_stiffness",
                "cantilever_strip",
            ],
            ".lab": ["Lab", "Measurement"],
            ".model": [
                "Check",
                "CheckResult",
                "Checks",
                "Level",
                "Status",
                "Tolerance",
            ],
            ".run": ["run_checks"],
        },
    )
