"""New processes of Python."""

import subprocess
import sys


def run_python(*words, **options):
    """Run Python with words, as in a shell; its output is text."""
    return subprocess.run(
        [sys.executable, *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
        **options,
    )


def printed(*words, **options):
    """Return what Python prints that must succeed."""
    done = run_python(*words, **options)
    assert done.returncode == 0, done.stderr
    return done.stdout
