"""Readers of what people train with, one module for each kind of target."""
