"""Files of scenes that other programs read and write. Each format is a package."""

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
"""Suffixes of USD layers, which every engine can use."""
