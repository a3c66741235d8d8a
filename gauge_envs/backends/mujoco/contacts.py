"""Constants of contacts: a recipe for each contact mode, and the user's settings that override it."""

from dataclasses import dataclass
from typing import Any

import mujoco

from gauge_envs.backends.mujoco.settings import SettingsMuJoCo
from gauge_envs.scene import Contact, ContactMode
from gauge_envs.scene.bodies import friction_dimension

IMPEDANCE_SHAPE = (0.5, 2.0)
"""Midpoint and power of the impedance curve, MuJoCo's defaults; they have no effect on a constant impedance."""


@dataclass(frozen=True, kw_only=True)
class ContactConstantsMuJoCo:
    """MuJoCo's constants of a contact, under MuJoCo's names.

    Attributes:
        condim: Dimension of the contact space: 1, 3, 4 or 6.
        friction: Coefficients: tangential (2), torsional [m], rolling (2) [m].
        solref: Time constant [s] and damping ratio; or, if negative, stiffness and damping.
        solreffriction: The same in the tangential directions; zeros stand for `solref`.
        solimp: Impedance: d0, dwidth, width [m], midpoint, power.
        margin: Distance at which the contact force starts [m].
        gap: Additional distance at which the contact is detected without force [m].
    """

    condim: int
    friction: tuple[float, ...]
    solref: tuple[float, ...]
    solreffriction: tuple[float, ...]
    solimp: tuple[float, ...]
    margin: float
    gap: float

    def put_on_pair(self, pair: mujoco.MjsPair) -> None:
        """Write all constants to an explicit pair."""
        for key, value in vars(self).items():
            setattr(pair, key, value)

    def put_on_geom(self, geom: mujoco.MjsGeom) -> None:
        """Write all constants but `solreffriction`, which geoms lack, to one geom of a pair with equal constants."""
        values = dict(vars(self))
        del values["solreffriction"]
        _, sliding, torsional, rolling, _ = self.friction
        # MuJoCo adds the margins and the gaps of the two geoms, so each geom gets half.
        values |= {
            "friction": [sliding, torsional, rolling],
            "margin": 0.5 * self.margin,
            "gap": 0.5 * self.gap,
        }
        for key, value in values.items():
            setattr(geom, key, value)


def contact_constants(
    contact: Contact, settings: SettingsMuJoCo
) -> ContactConstantsMuJoCo:
    """Return the constants of a contact between rigid bodies."""
    recipe: dict[str, Any] = {"solreffriction": (0.0, 0.0), "margin": 0.0, "gap": 0.0}
    if contact.mode is ContactMode.SUSTAINED:
        recipe["solref"] = settings.sustained_solref
        recipe["solimp"] = (*settings.sustained_solimp, *IMPEDANCE_SHAPE)
    else:
        recipe |= _impact(contact, settings)
    if settings.contact_solref is not None:
        # The tangential constants of a recipe fit only its own constants in the normal direction.
        recipe["solreffriction"] = (0.0, 0.0)
    if settings.contact_solreffriction is not None:
        recipe["solreffriction"] = settings.contact_solreffriction
    friction = _friction(contact, settings)
    dimension = friction_dimension(contact.torsion_m, contact.rolling_m)
    condim = max(settings.condim or 3, dimension)
    if friction[0] == 0.0:
        # A contact without friction has no tangential constraints, which is exact and cheap.
        condim = 1
    return ContactConstantsMuJoCo(
        condim=condim, friction=friction, **recipe | given_constants(settings)
    )


def given_constants(settings: SettingsMuJoCo) -> dict[str, Any]:
    """Return the values of `solref`, `solimp`, `margin` and `gap` that the settings give for every recipe."""
    given = {
        "solref": settings.contact_solref,
        "solimp": settings.contact_solimp,
        "margin": settings.contact_margin_m,
        "gap": settings.contact_gap_m,
    }
    return {key: value for key, value in given.items() if value is not None}


def _friction(contact: Contact, settings: SettingsMuJoCo) -> tuple[float, ...]:
    if settings.o_friction is not None:
        return settings.o_friction
    sliding, rolling = (
        settings.friction_scale * contact.friction,
        contact.rolling_m or settings.rolling_friction_m,
    )
    return (
        sliding,
        sliding,
        contact.torsion_m or settings.torsional_friction_m,
        rolling,
        rolling,
    )


def _impact(contact: Contact, settings: SettingsMuJoCo) -> dict[str, Any]:
    """Return constants with which an impact has the restitution of the contact.

    They use MuJoCo's direct solref with damping (1 + e)/h: one step then changes the normal velocity v to -e v. The
    same damping would also reverse the tangential velocity, so friction gets 1/h, which stops it.
    """
    step = settings.timestep_s
    constants = {
        "solref": (
            -settings.impact_stiffness / step**2,
            -(1.0 + contact.restitution) / step,
        ),
        "solimp": (*settings.impact_solimp, *IMPEDANCE_SHAPE),
    }
    if settings.cone == "elliptic":
        constants["solreffriction"] = (0.0, -1.0 / step)
    return constants
