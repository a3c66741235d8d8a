"""List and show experiments and control tasks."""
