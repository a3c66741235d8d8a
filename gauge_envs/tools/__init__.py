"""Instruments: each folder measures one thing on top of the core and has a `gauge` command."""
