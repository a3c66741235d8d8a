"""Show a finding in a published model with plain MuJoCo: python show.py KIND NAME FILE.

KIND is `inertia` (of a body over that of its shapes), `density` (of a body in the box around its shapes), `range` (of
a joint), `commands` (of an actuator, and the range of its joint), `solref` (that acts on a geom), `friction` (of a
geom, and of the world), `overlap` (of a geom at the start), `held` (speed of a joint after 2 s, and the share of its
dry friction that acts), or `mirror` (numbers of two parts, `left,right`).
"""

import sys

import mujoco
import numpy as np


def box_m(model, body):
    """Return edges of the box around the shapes of a body in its frame [m]."""
    corners = []
    for geom in np.flatnonzero(model.geom_bodyid == body):
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
        half = np.abs(rotation.reshape(3, 3)) @ model.geom_aabb[geom, 3:]
        centre = (
            model.geom_pos[geom] + rotation.reshape(3, 3) @ model.geom_aabb[geom, :3]
        )
        corners += [centre - half, centre + half]
    return np.ptp(corners, axis=0)


def inertia(model, name):
    """Return the inertia of a body over that of an even box around its shapes."""
    body = model.body(name).id
    even = model.body_mass[body] * (box_m(model, body) ** 2).sum() / 6.0
    return f"{model.body_inertia[body].sum() / even:.3g} times that of an even box"


def density(model, name):
    """Return the mass of a body and its density in the box around its shapes."""
    body = model.body(name).id
    mass_kg = model.body_mass[body]
    density = mass_kg / box_m(model, body).prod()
    return f"{mass_kg:.3g} kg, {density:.6g} kg/m^3"


def turns(model, name):
    """Return the range of a joint."""
    return f"range {np.degrees(model.joint(name).range).round(3).tolist()} degrees"


def commands(model, name):
    """Return the commands of an actuator and the range of its joint."""
    joint = model.joint(model.actuator(name).trnid[0])
    return f"ctrlrange {model.actuator(name).ctrlrange.tolist()}, joint {joint.range.round(3).tolist()}"


def solref(model, name):
    """Return the time constant of a geom and the least one that acts."""
    return f"solref {model.geom(name).solref[0]:g} s, at least {2.0 * model.opt.timestep:g} s acts"


def start(model):
    """Return the state of the first keyframe, or the initial one."""
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return data


def friction(model, name):
    """Return the friction of a geom, and that of the geoms of the world."""
    others = sorted(
        {float(row[0]) for row in model.geom_friction[model.geom_bodyid == 0]}
    )
    return f"friction {model.geom(name).friction[0]:g}, of the world {others}"


def overlap(model, name):
    """Return the deepest contact of a geom, by name or number, at the start."""
    geom = int(name) if name.isdigit() else model.geom(name).id
    depths = [contact.dist for contact in start(model).contact if geom in contact.geom]
    return f"{-1e3 * min(depths):.1f} mm deep"


def held(model, name):
    """Return the speed of a joint after 2 s, and the force of its dry friction over frictionloss."""
    data, dof = start(model), model.joint(name).dofadr[0]
    while data.time < 2.0:
        mujoco.mj_step(model, data)
    kind = mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF
    row = np.flatnonzero((data.efc_type == kind) & (data.efc_id == dof))[0]
    share = abs(data.efc_force[row]) / model.dof_frictionloss[dof]
    return f"{1e3 * data.qvel[dof]:.3g} mrad/s with {share:.2f} of its friction"


def mirror(model, names):
    """Return numbers of two parts."""
    left, right = names.split(",")
    for kind in ("joint", "actuator", "geom", "body"):
        try:
            parts = [getattr(model, kind)(name) for name in (left, right)]
        except KeyError:
            continue
        keys = [
            key
            for key in dir(parts[0])
            if not key.startswith("_") and "adr" not in key and key != "id"
        ]
        pairs = {
            key: [np.atleast_1d(getattr(part, key)) for part in parts] for key in keys
        }
        return ", ".join(
            f"{key} {np.array2string(a, precision=3)} and {np.array2string(b, precision=3)}"
            for key, (a, b) in pairs.items()
            if a.dtype.kind == "f" and not np.allclose(np.abs(a), np.abs(b))
        )[:200]
    return "no such parts"


KINDS = {
    "inertia": inertia,
    "density": density,
    "range": turns,
    "commands": commands,
    "solref": solref,
    "friction": friction,
    "overlap": overlap,
    "held": held,
    "mirror": mirror,
}

if __name__ == "__main__":
    kind, name, file = sys.argv[1:]
    print(KINDS[kind](mujoco.MjModel.from_xml_path(file), name))
