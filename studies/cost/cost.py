"""CPU time of episodes over their simulated time, from result files of `gauge run`.

gauge run "*" --backend mujoco --out results
python -m studies.cost.cost results > scoring/costs.csv
"""

from __future__ import annotations

import csv
import sys
from collections import defaultdict
from pathlib import Path

from gauge_envs import find_variant
from gauge_envs.runs.result_file import load_result


def main() -> None:
    seconds: dict[tuple[str, str], list[float]] = defaultdict(list)
    for folder in sys.argv[1:]:
        for file in sorted(Path(folder).glob("*.json")):
            result = load_result(file)
            if result.error is None and result.cpu_s is not None:
                family = find_variant(result.id).family
                seconds[str(result.backend), family].append(result.cpu_s / result.sim_s)
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(["engine", "family", "ids", "least", "most"])
    for (engine, family), costs in seconds.items():
        table.writerow(
            [engine, family, len(costs), f"{min(costs):.2g}", f"{max(costs):.2g}"]
        )


if __name__ == "__main__":
    main()
