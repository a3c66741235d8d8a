"""The constants of all pairs of a MuJoCo model, compared with the contacts that MuJoCo makes."""

import mujoco
import numpy as np
import pytest
from heap import heap

from gauge_envs.backends.mujoco.contact_table import COLUMNS, contact_pairs


def made_contacts(data):
    """Constants of the contacts that MuJoCo makes, by their geoms, without those in which nothing can move."""
    contacts = {}
    for contact in data.contact:
        if contact.exclude != 3:
            constants = (
                contact.friction,
                contact.solref,
                contact.solreffriction,
                contact.solimp,
            )
            contacts[tuple(sorted(contact.geom.tolist()))] = np.hstack(
                [contact.dim, *constants, contact.includemargin]
            )
    return contacts


def read_contacts(model):
    pairs = contact_pairs(model)
    without_gap = pairs.constants[:, : COLUMNS["gap"].start]
    return {
        tuple(geoms): row
        for geoms, row in zip(pairs.geoms.tolist(), without_gap, strict=True)
    }


@pytest.mark.parametrize(
    ("option", "flag"),
    [
        ("", ""),
        ("", "filterparent='disable'"),
        (
            "o_margin='.03' o_solref='.007 1.3' o_solimp='.1 .2 .3 .4 5' o_friction='.1 .2 .3 .4 .5'",
            "override='enable'",
        ),
    ],
)
def test_pairs_are_those_that_mujoco_makes_of_a_heap(option, flag):
    model = heap(option=option, flag=flag)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    made, read = made_contacts(data), read_contacts(model)
    assert len(made) > 20
    assert made.keys() == read.keys()
    for geoms, constants in made.items():
        np.testing.assert_allclose(
            read[geoms], constants, rtol=1e-12, err_msg=str(geoms)
        )


def test_a_gap_is_the_sum_of_both():
    # `includemargin` leaves the gap out; it shows in how far apart a contact is found.
    xml = """<mujoco><worldbody><geom type="plane" size="1 1 1" gap=".03"/><body pos="0 0 {height}"><freejoint/>
      <geom size=".1" gap=".02"/></body></worldbody></mujoco>"""
    for height, count in ((0.149, 1), (0.151, 0)):
        model = mujoco.MjModel.from_xml_string(xml.format(height=height))
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        assert data.ncon == count
        assert contact_pairs(model).constants[
            0, COLUMNS["gap"]
        ].item() == pytest.approx(0.05)
