"""The `gauge` command."""

from gauge_envs.cli.app import app, main

__all__ = ["app", "main"]
