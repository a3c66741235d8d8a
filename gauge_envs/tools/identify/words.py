"""Identified settings of joints as tables, and in the language of each engine."""

from collections.abc import Mapping
from dataclasses import asdict

from gauge_envs.pages.document import Document
from gauge_envs.pages.table import Column, Table
from gauge_envs.tools.identify.fit import Identified

DRY, VISCOUS, ARMATURE = "dry_friction_n_m", "viscous_friction_n_m_s_per_rad", "armature_kg_m2"
KP, KV, DELAY = "kp_n_m_per_rad", "kv_n_m_s_per_rad", "delay_s"

SNIPPETS: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    "mujoco": {
        '<joint name="{joint}" {}/>': {DRY: 'frictionloss="{}"', VISCOUS: 'damping="{}"', ARMATURE: 'armature="{}"'},
        '<position joint="{joint}" {}/>': {KP: 'kp="{}"', KV: 'kv="{}"'},
    },
    "newton": {
        "joint {joint}: add_joint_revolute(..., {})": {
            DRY: "friction={}",
            ARMATURE: "armature={}",
            KP: "target_ke={}",
            KV: "target_kd={}",
        },
        "joint {joint}: model.mujoco.dof_passive_damping = {}": {VISCOUS: "{}"},
    },
    "drake": {
        "joint {joint}: SetDampingVector([{}])": {VISCOUS: "{}"},
        "actuator of joint {joint}: set_default_gear_ratio(1); set_default_rotor_inertia({})": {ARMATURE: "{}"},
        "actuator of joint {joint}: set_controller_gains(PdControllerGains({}))": {KP: "p={}", KV: "d={}"},
    },
    "pybullet": {
        "changeDynamics(body, {joint}, {})": {VISCOUS: "jointDamping={}"},
        "setJointMotorControl2(body, {joint}, VELOCITY_CONTROL, targetVelocity=0, {})": {DRY: "force={}"},
    },
    "physx": {
        "joint {joint}: set_friction({})": {DRY: "{}"},
        "joint {joint}: set_armature([{}])": {ARMATURE: "{}"},
        "joint {joint}: set_drive_property({})": {KP: "stiffness={}", KV: "damping={}"},
    },
    "genesis": {
        "set_dofs_frictionloss([{}], [{joint}])": {DRY: "{}"},
        "set_dofs_damping([{}], [{joint}])": {VISCOUS: "{}"},
        "set_dofs_armature([{}], [{joint}])": {ARMATURE: "{}"},
        "set_dofs_kp([{}], [{joint}])": {KP: "{}"},
        "set_dofs_kv([{}], [{joint}])": {KV: "{}"},
    },
}
"""Lines of each engine: their frame, and what each number adds to it."""


def identified_document(found: Identified) -> Document:
    """Return the numbers with intervals, and the errors of the logs."""

    def number(key: str, title: str) -> Column:
        return Column(key, title, lambda value: f"{value:.4g}", is_number=True)

    numbers = Table(
        columns=(
            Column("joint", f"{found.engine}: joint"),
            Column("name", "setting"),
            number("value", "value"),
            number("low", "low"),
            number("high", "high"),
            Column("unknown", "not determined"),
        ),
        rows=[asdict(one) for one in found.settings],
        notes=("low and high are the ends of the 95 % interval.", ""),
    )
    rows = [
        {"log": name, "used": used, "joint": joint, "error": 1e3 * float(error)}
        for used, errors in (("fitted", found.error_rad), ("held out", found.held_out_rad))
        for name, values in errors.items()
        for joint, error in enumerate(values)
    ]
    errors = Table(
        columns=(
            Column("log", "log"),
            Column("used", ""),
            Column("joint", "joint"),
            number("error", "rms error [mrad]"),
        ),
        rows=rows,
    )
    return Document(parts=(numbers, errors), rows=[{"engine": found.engine, "settings": numbers.rows, "errors": rows}])


def snippet(found: Identified) -> str:
    """Return the numbers in the language of the engine, a line for each joint and command, and what it cannot say."""
    lines = []
    for joint, terms in enumerate(found.terms()):
        said: set[str] = set()
        for frame, parts in SNIPPETS.get(found.engine, {}).items():
            inside = [text.format(f"{terms[name]:.5g}") for name, text in parts.items() if name in terms]
            said |= parts.keys() & terms.keys()
            if inside:
                separator = " " if frame.startswith("<") else ", "
                lines.append(frame.replace("{joint}", str(joint)).replace("{}", separator.join(inside)))
        lines += [
            f"# joint {joint}: {name} = {value:.5g}, which {found.engine} has no line for: apply it in your controller"
            for name, value in terms.items()
            if name not in said
        ]
    return "\n".join(lines) + "\n"
