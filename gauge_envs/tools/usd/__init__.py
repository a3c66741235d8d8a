"""Conversion between scenes and USD layers, including layers that other tools wrote."""
