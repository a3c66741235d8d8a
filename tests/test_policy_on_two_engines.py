"""The example that runs a policy on two engines."""

import os

from places import ROOT
from programs import printed


def test_a_policy_runs_on_two_engines(tmp_path):
    (tmp_path / "policies.py").write_text("def still(_):\n    return [0.0]\n")
    shown = printed(
        ROOT / "examples" / "policy_on_two_engines.py",
        *("policies:still", "--id", "Turntable-Limit-wood"),
        *("--other", "rapier", "--episodes", 1),
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    returns = dict(line.split() for line in shown.splitlines())
    assert returns.keys() == {"mujoco", "rapier"}
    assert all(float(total) >= 0.0 for total in returns.values())
