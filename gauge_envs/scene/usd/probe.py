"""Open a USD file and read all its values, in a child process whose memory and time are limited.

The script is started by `source.Source` and imports nothing of this package. Arguments: the file, and the largest
number of prims.
"""

from __future__ import annotations

import sys

from pxr import Tf, Usd

__all__: list[str] = []

REFUSED = 3
"""Exit code after a printed reason, as in `files.child_refusal`."""

MOST_SAMPLES = 100_000
"""Largest number of time samples of an attribute."""


def main(file: str, most_prims: int) -> int:
    """Return the exit code; a file that USD cannot read is no matter of limits."""
    try:
        stage = Usd.Stage.Open(file)
        for count, prim in enumerate(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())):
            if count >= most_prims:
                print(f"it has more than {most_prims} prims")
                return REFUSED
            for attribute in prim.GetAuthoredAttributes():
                codes = attribute.GetTimeSamples()
                if len(codes) > MOST_SAMPLES:
                    print(f"{attribute.GetPath()} has {len(codes)} time samples, the limit is {MOST_SAMPLES}")
                    return REFUSED
                for code in (Usd.TimeCode.Default(), *codes):
                    attribute.Get(code)
    except (Tf.ErrorException, UnicodeDecodeError):
        return 0
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2])))
