"""The `gauge` command."""

from __future__ import annotations

import os
import sys

__all__ = ["main"]

EXIT_INTERRUPTED = 130


def main() -> None:
    """Run the `gauge` command."""
    try:
        from gauge_envs.cli.app import main as run_command
    except KeyboardInterrupt:  # The imports take a noticeable time.
        sys.stderr.write("interrupted\n")
        sys.stderr.flush()
        os._exit(EXIT_INTERRUPTED)
    run_command()
