"""Print the first two tables of the study, with the closed form and the simulated studies of the tests of the command.

python studies/transfer/transfer.py
"""

import sys
from pathlib import Path

TESTS = Path(__file__).parents[2] / "tests"
sys.path += [str(TESTS), str(TESTS / "tools" / "transfer")]

from test_transfer import (  # noqa: E402
    FRICTION,
    TASK,
    TRAINING,
    constant,
    held_share,
    predicted_reward,
    tilting,
)

from gauge_envs.tools.transfer.policy_replays import replay  # noqa: E402
from gauge_envs.tools.transfer.transfer import transfer_report  # noqa: E402

SHARES = (0.90, 0.92, 0.95, 1.00)
STUDIES = (
    (5, 2, (0.1, 0.02, 0.02)),
    (5, 2, (0.1, 0.1, 0.1)),
    (5, 2, (0.0, 0.1, 0.0)),
    (5, 2, (0.0, 0.0, 0.1)),
    (5, 3, (0.1, 0.02, 0.02)),
    (10, 3, (0.1, 0.02, 0.02)),
    (1, 3, (0.0, 0.1, 0.0)),
    (1, 3, (0.1, 0.02, 0.02)),
    (5, 1, (0.0, 0.1, 0.0)),
)
"""Policies, starts, and scatter between policies, starts and single episodes."""

worlds = [constant(f"{share:.2f}", share * FRICTION) for share in SHARES]
report = transfer_report(
    replay(TASK, {"steep": tilting(0.98)}, TRAINING, worlds, starts=1)
)
for share, row in zip(SHARES, report.others, strict=True):
    print(
        f"| {share:.2f} | {predicted_reward(0.98, share * FRICTION):.2f} | {row.reward.value:.2f} |"
    )
for policies, starts, scatter in STUDIES:
    held = held_share(policies, starts, scatter, count=2000)
    print(
        f"| {policies} x {starts} | {', '.join(f'{one:g}' for one in scatter)} | {held:.2f} |"
    )
