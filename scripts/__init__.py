"""Commands of a checkout, `python -m scripts`: generated files, versions of dependencies, tests of the wheel."""
