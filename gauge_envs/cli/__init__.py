"""The `gauge` command."""
