"""MuJoCo: friction of a sliding box depends on its direction with the default cone. Law: mu g in each direction."""

import mujoco
import numpy as np

FRICTION, G, SPEED, SECONDS = 0.3, 9.81, 1.5, 0.3
XML = """<mujoco><option gravity="0 0 -{g}" timestep="{step}" {option}/><worldbody>
<geom type="plane" size="9 9 1" friction="{mu}"/><body pos="0 0 .01"><freejoint/>
<geom type="box" size=".05 .05 .01" mass=".1" friction="{mu}"/></body></worldbody></mujoco>"""


def share(degrees: float, step_s: float, option: str = "") -> float:
    """Return the friction of a slide along a direction over that of the pair."""
    text = XML.format(g=G, mu=FRICTION, step=step_s, option=option)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    way = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
    for _ in range(round(0.2 / step_s)):  # It settles first.
        mujoco.mj_step(model, data)
    data.qvel[:2] = SPEED * way
    for _ in range(round(SECONDS / step_s)):
        mujoco.mj_step(model, data)
    return (SPEED - float(data.qvel[:2] @ way)) / (FRICTION * G * SECONDS)


for option in ("", 'cone="elliptic"'):
    for step_s in (1 / 500, 1 / 900):
        values = ", ".join(
            f"{share(d, step_s, option):.3f} at {d} degrees" for d in (0, 45)
        )
        print(f"{option or 'defaults'}, step 1/{1 / step_s:.0f} s: {values}; law 1")
