"""MuJoCo: a box that is pushed with a share of the friction limit creeps. Law: it rests below the limit."""

import mujoco

FRICTION, G, MASS_KG = 0.5, 9.81, 0.2
XML = """<mujoco><option gravity="0 0 -{g}" timestep="{step}" {option}/><worldbody>
<geom type="plane" size="9 9 1" friction="{mu}"/><body pos="0 0 .04"><freejoint/>
<geom type="box" size=".04 .04 .04" mass="{kg}" friction="{mu}"/></body></worldbody></mujoco>"""


def moved_mm(share: float, step_s: float, option: str = "") -> float:
    """Return the displacement within 1 s [mm]."""
    text = XML.format(g=G, mu=FRICTION, kg=MASS_KG, step=step_s, option=option)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for _ in range(round(0.5 / step_s)):
        mujoco.mj_step(model, data)
    start = data.qpos[0]
    data.xfrc_applied[1, 0] = share * FRICTION * MASS_KG * G
    for _ in range(round(1.0 / step_s)):
        mujoco.mj_step(model, data)
    return 1e3 * (data.qpos[0] - start)


for option in ("", 'cone="elliptic" impratio="100"'):
    for share in (0.5, 0.95):
        values = [
            f"{moved_mm(share, s, option):.3f} mm at 1/{1 / s:.0f} s"
            for s in (1 / 500, 1 / 900)
        ]
        print(f"{option or 'defaults'}, {share}: {', '.join(values)}; law 0")
