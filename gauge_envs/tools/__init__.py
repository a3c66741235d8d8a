"""Instruments: one folder each. The `__init__.py` of a folder lists the names that others may use."""
