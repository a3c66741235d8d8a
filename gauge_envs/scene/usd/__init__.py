"""Scene <-> USD: a layer that any USD tool opens, and back, also from layers that others wrote."""
