"""Time of `import gauge_envs` over that of a bare `import gymnasium`, in one run.

Each import takes place in a fresh process, by turns, so that a busy machine slows both. Exits 1 when the median is
above the limit: 1.3 times Gymnasium's, and 50 ms.
"""

from __future__ import annotations

import statistics
import subprocess
import sys

PACKAGE, BASELINE = "gauge_envs", "gymnasium"
REPEATS = 11
FACTOR_LIMIT = 1.3
EXTRA_LIMIT_S = 0.050

TIMED_IMPORT = """
import time
start = time.perf_counter()
import {module}
print(time.perf_counter() - start)
"""


def import_s(module: str) -> float:
    """Time that a fresh interpreter takes to import a module [s]."""
    run = subprocess.run(
        [sys.executable, "-c", TIMED_IMPORT.format(module=module)], capture_output=True, text=True, check=True
    )
    return float(run.stdout)


def main() -> int:
    for module in (BASELINE, PACKAGE):
        import_s(module)  # The first import writes the cache of compiled files.
    pairs = [(import_s(BASELINE), import_s(PACKAGE)) for _ in range(REPEATS)]
    baseline_s, package_s = (statistics.median(times) for times in zip(*pairs, strict=True))
    limit_s = FACTOR_LIMIT * baseline_s + EXTRA_LIMIT_S
    print(f"import {BASELINE}: {1e3 * baseline_s:.0f} ms, median of {REPEATS}")
    print(f"import {PACKAGE}: {1e3 * package_s:.0f} ms, {package_s / baseline_s:.2f} times that")
    print(f"limit: {1e3 * limit_s:.0f} ms ({FACTOR_LIMIT} times, and {1e3 * EXTRA_LIMIT_S:.0f} ms)")
    return int(package_s > limit_s)


if __name__ == "__main__":
    sys.exit(main())
