"""Models with the settings that this package recommends, and models with one planted fault each."""

from __future__ import annotations

from dataclasses import dataclass, field

RECOMMENDED = {
    "option": {
        "timestep": "0.002",
        "integrator": "implicitfast",
        "cone": "elliptic",
        "impratio": "100",
        "gravity": "0 0 -9.81",
    },
    "geom": {"solref": "0.004 1", "solimp": "0.95 0.95 0.001"},
}
"""Attributes of the XML in docs/sanity.md, with MuJoCo's gravity."""


@dataclass(frozen=True, kw_only=True)
class Planted:
    """One fault.

    Attributes:
        culprits: Names of settings with blanks between them, one of which must be named as the cause.
        rows: Rows in which it must show, with blanks between them.
        option: Attributes of `<option>` that replace the recommended ones.
        flag: Attributes of `<option><flag>`.
        geom: Attributes of `<default><geom>` that replace the recommended ones.
        foot: Attributes of the foot's own geom.
    """

    culprits: str = ""
    rows: str = ""
    option: dict[str, str] = field(default_factory=dict)
    flag: dict[str, str] = field(default_factory=dict)
    geom: dict[str, str] = field(default_factory=dict)
    foot: dict[str, str] = field(default_factory=dict)


PLANTED = {
    "gravity_9": Planted(
        culprits="gravity", rows="gravity", option={"gravity": "0 0 -9"}
    ),
    "gravity_tilted": Planted(
        culprits="gravity", rows="gravity", option={"gravity": "0.86 0 -9.77"}
    ),
    "pyramidal_and_soft": Planted(
        culprits="contact_solimp cone impratio",
        rows="creep-wood",
        option={"cone": "pyramidal", "impratio": "1"},
        geom={"solref": "0.02 1", "solimp": "0.5 0.9 0.01"},
    ),
    "solimp_from_zero": Planted(
        culprits="contact_solimp",
        rows="rest-height",
        geom={"solref": "0.02 1", "solimp": "0 0.8 0.01"},
    ),
    "step_20_ms": Planted(
        culprits="timestep_s", rows="point", option={"timestep": "0.02"}
    ),
    "margin_1_cm": Planted(
        culprits="contact_margin_m", rows="rest-height", geom={"margin": "0.01"}
    ),
    "pyramidal": Planted(
        culprits="cone", rows="slide-turned", option={"cone": "pyramidal"}
    ),
    "one_iteration": Planted(
        culprits="iterations cone",
        rows="slide-wood",
        option={
            "iterations": "1",
            "ls_iterations": "5",
            "cone": "pyramidal",
            "impratio": "1",
        },
    ),
    "soft_solref": Planted(
        culprits="contact_solref", rows="rest-height", geom={"solref": "0.2 1"}
    ),
    "negative_solref": Planted(
        culprits="contact_solref", rows="rest-height", geom={"solref": "-50 -14"}
    ),
    "no_impratio": Planted(
        culprits="impratio", rows="creep-wood", option={"impratio": "0.01"}
    ),
    "refsafe_off": Planted(
        culprits="refsafe contact_solref timestep_s",
        rows="creep-wood",
        flag={"refsafe": "disable"},
        geom={"solref": "0.001 1"},
    ),
    "slippery_override": Planted(
        culprits="o_friction", rows="creep-wood", flag={"override": "enable"}
    ),
    "soft_foot": Planted(
        culprits="contact_solref",
        rows="rest-height",
        foot={"priority": "1", "solref": "0.2 1"},
    ),
}
"""Planted faults by name."""


def model_xml(planted=None):
    """Return a model of a robot with a trunk, two shins and a foot on a plane, with a fault or without."""
    fault = planted or Planted()
    option = RECOMMENDED["option"] | fault.option
    geom = RECOMMENDED["geom"] | fault.geom
    if "override" in fault.flag:
        option |= {
            "o_friction": "0.05 0.05 0.005 0.0001 0.0001",
            "o_solref": geom["solref"],
            "o_solimp": geom["solimp"],
        }
    flag = f"<flag {attributes(fault.flag)}/>" if fault.flag else ""
    return f"""<mujoco><option {attributes(option)}>{flag}</option><default><geom {attributes(geom)}/></default>
      <worldbody><geom name="floor" type="plane" size="5 5 .1"/><body name="robot" pos="0 0 1"><freejoint/>
        <geom name="trunk" type="box" size=".2 .1 .05"/><geom name="left_shin" size=".03" pos="0 .1 -.2"/>
        <geom name="right_shin" size=".03" pos="0 -.1 -.2"/>
        <geom name="foot" size=".04" pos="0 0 -.3" {attributes(fault.foot)}/></body></worldbody></mujoco>"""


def attributes(values):
    """Return attributes as they are written in XML."""
    return " ".join(f'{name}="{value}"' for name, value in values.items())
