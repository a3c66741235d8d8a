"""The number of processors for a run, and the name of the processor for its record."""

import os
import platform
import re
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path


def processor_count() -> int:
    """Return the number of processors that this process may use, at most that of `OMP_NUM_THREADS`."""
    count = (
        len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    )
    given = os.environ.get("OMP_NUM_THREADS", "")
    return min(count, int(given)) if given.isdecimal() and int(given) else count


@cache
def processor_name() -> str:
    """Return the machine's architecture, and on Linux its processor, as `x86_64, AMD EPYC`.

    Equal versions may give other last bits on another processor, because libraries select functions by processor.
    """
    cpu_info = ""
    with suppress(OSError):
        cpu_info = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    name = re.search(r"^model name\s*: (.*)", cpu_info, re.MULTILINE)
    return platform.machine() + (f", {name[1].strip()}" if name else "")
