"""Checks that solutions of the same equations agree, on MJCF models: layouts of matrices, solvers, threads.

Scenes of the contract have one solution for each engine. An engine that reads MJCF files has options there which must
not matter, and takes them from the file.
"""

from __future__ import annotations

from gauge_envs.runs.rollout import DeclinedError
from gauge_envs.tools.conformance.lab import Lab
from gauge_envs.tools.conformance.model import Check, Measurement
from gauge_envs.tools.sanity import solver_differences

FLOOR = '<geom type="plane" size="5 5 0.1"/>'

CORNERS_M = " ".join(
    f"{x} {y} {z}"
    for x in (-0.06, 0.06)
    for y in (-0.05, 0.05)
    for z in (-0.03, 0.03 + x / 4.0)
)
"""Corners of a wedge [m], whose top leans."""


def _arm(x: int, y: int) -> str:
    """Return a capsule on a hinge at a side of a box of 0.12 by 0.1 by 0.08 m."""
    return (
        f'<body pos="{0.06 * x} {0.05 * y} 0"><joint axis="{abs(y)} {abs(x)} 0" damping="0.01"/>'
        f'<geom type="capsule" fromto="0 0 0 {0.08 * x} {0.08 * y} 0" size="0.012" density="500"/></body>'
    )


def _pile(count: int, geoms: str, more: str = "") -> str:
    """Return free bodies above a floor, each turned by 137 degrees beside the one below it."""
    return (
        f'<mujoco>{more}<worldbody>{FLOOR}<replicate count="{count}" offset="0 0 0.09" euler="0 0 137">'
        f'<body pos="0.12 0.03 0.12"><freejoint/>{geoms}</body></replicate></worldbody></mujoco>'
    )


BOX = '<geom type="box" size="0.06 0.05 0.04" density="500"/>'
ARMS = "".join(_arm(x, y) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)))
WEDGE = f'<asset><mesh name="wedge" vertex="{CORNERS_M}"/></asset>'
TABLE = (
    '<geom type="box" size="0.1 0.06 0.01" pos="0 0 0.03"/>'
    '<geom type="box" size="0.01 0.06 0.03" pos="0.08 0 -0.01"/>'
    '<geom type="box" size="0.01 0.06 0.03" pos="-0.08 0 -0.01"/>'
)
CLOTH = f"""<mujoco><worldbody>{FLOOR}<geom type="sphere" size="0.1" pos="0 0 0.2"/>
<flexcomp name="cloth" type="grid" dim="2" count="6 6 1" spacing="0.05 0.05 0.05" pos="0 0 0.32" radius="0.005"
mass="0.1"><edge equality="true" damping="0.01"/><contact selfcollide="none"/></flexcomp></worldbody></mujoco>"""

SCENES = {
    "solver-pile": (_pile(20, BOX + ARMS), 400),
    "solver-meshes": (_pile(8, '<geom type="mesh" mesh="wedge"/>', WEDGE), 150),
    "solver-compounds": (_pile(8, TABLE), 150),
    "solver-cloth": (CLOTH, 100),
}
"""Model of each check, and its steps."""


def _register(id: str, mjcf: str, steps: int) -> None:
    @Check(id)
    def measure(lab: Lab) -> Measurement:
        if ".xml" not in lab.backend.file_suffixes:
            raise DeclinedError(
                ("it reads no MJCF files, whose options choose a solution",)
            )
        if lab.settings:
            raise DeclinedError(("an MJCF file contains its own settings",))
        found = solver_differences(mjcf, steps)
        parts = [f"{pair} part by {value:.2g}" for pair, value in found.items()]
        return Measurement(measured=max(found.values()), hint="; ".join(parts))


for _id, (_mjcf, _steps) in SCENES.items():
    _register(_id, _mjcf, _steps)
