"""Checks that are the first to catch no mutant, and a mutant that they catch too."""

ALSO = {
    "rest-box": "margin",
    "inertia-sphere": "sphere-larger",
    "copy": "state-behind",
    "restore-rest": "restore-warm-start",
    "restore-edge": "restore-velocity",
    "restore-hinge": "restore-velocity",
    "restore-benchmark-rigid": "restore-warm-start",
    "restore-benchmark-soft": "restore-velocity",
    "swing-box": "box-inertia",
    "swing-cylinder": "cylinder-length",
    "rest-sphere": "margin",
    "rest-cylinder": "cylinder-length",
    "rest-lying-cylinder": "cylinder-radius",
    "rest-convex": "margin",
    "roll-cylinder": "rolling-friction",
    "slide-plane": "plane-level",
    "collision-slow": "slow-restitution",
}
