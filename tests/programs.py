"""New processes of Python."""

import subprocess
import sys


def run_python(*words, **options):
    """Run Python with arguments, and return the process with its output as text."""
    return subprocess.run(
        [sys.executable, *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
        **options,
    )


def printed(*words, **options):
    """Return the output of Python, which must succeed."""
    done = run_python(*words, **options)
    assert done.returncode == 0, done.stderr
    return done.stdout
