"""The `gauge` command."""

from __future__ import annotations

__all__ = ["main"]


def main() -> None:
    """Run the `gauge` command in this process."""
    from gauge_envs.cli.app import main as run_command

    run_command()
