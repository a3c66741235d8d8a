"""Open a USD file and read all its values, in a child process whose memory and time are limited.

The script is started by `source.Source` and imports nothing of this package. Its arguments are the file and the
largest number of prims.
"""

import sys

from pxr import Tf, Usd

REFUSED = 3
"""Exit code after a printed reason, as in `files.child_refusal`."""

MOST_SAMPLES = 100_000
"""Largest number of time samples of an attribute."""


def main(file: str, most_prims: int) -> int:
    """Print why the file is refused, if it is, and return the exit code."""
    try:
        stage = Usd.Stage.Open(file)
    except Tf.ErrorException as error:
        # Opening it in another process could take the memory that is missing here.
        print(f"is not a readable USD file: {_reason(error)}")
        return REFUSED
    for count, prim in enumerate(
        Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
    ):
        if count >= most_prims:
            print(f"it has more than {most_prims} prims")
            return REFUSED
        for attribute in prim.GetAuthoredAttributes():
            fault = _fault(attribute)
            if fault:
                print(fault)
                return REFUSED
    return 0


def _fault(attribute: Usd.Attribute) -> str:
    """Return what is wrong with the values of an attribute, or nothing.

    USD also reports memory that is missing here as a value that it cannot read. Another process would take that memory.
    """
    try:
        codes = attribute.GetTimeSamples()
        if len(codes) > MOST_SAMPLES:
            return f"{attribute.GetPath()} has {len(codes)} time samples, the limit is {MOST_SAMPLES}"
        for code in (Usd.TimeCode.Default(), *codes):
            attribute.Get(code)
    except Tf.ErrorException as error:
        return f"a value cannot be read: {_reason(error)}"
    except UnicodeDecodeError:
        return ""
    return ""


def _reason(error: Tf.ErrorException) -> str:
    try:
        return str(error.args[0].commentary).strip()
    except UnicodeDecodeError:
        # The message quotes the file, which may contain any bytes.
        return "it holds bytes that are not UTF-8 text"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], int(sys.argv[2])))
