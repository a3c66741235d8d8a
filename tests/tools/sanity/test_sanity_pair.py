"""The friction of a pair of geoms: that of MuJoCo's own contact, its rule, and that of other stacks."""

import mujoco
import numpy as np
import pytest

from gauge_envs.tools.sanity import configuration
from gauge_envs.tools.sanity.pair import STACKS, pair_parts

MODEL = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1" friction="{floor}" priority="{rank}"/>
    <body pos="0 0 0.02"><freejoint/><geom name="foot" size="0.02" friction="{foot}" condim="{condim}"/></body>
  </worldbody>
  {contact}
</mujoco>
"""
PAIR = '<contact><pair geom1="floor" geom2="foot" friction="{value} {value} 0 0 0"/></contact>'


def text_of(folder, **values):
    """Return the model file, and the first line of its page."""
    file = folder / "model.xml"
    file.write_text(MODEL.format(**values))
    robot = configuration(str(file)).robot
    return file, pair_parts(robot, ("floor", "foot"))[0].text


@pytest.mark.parametrize("seed", range(20))
def test_the_friction_in_force_is_that_of_mujocos_contact(seed, tmp_path):
    """Priorities, explicit pairs, and the greater value; the judge is the list of contacts of a step."""
    random = np.random.default_rng(seed)
    floor, foot, value = random.uniform(0.1, 2.0, 3).round(2)
    explicit = PAIR.format(value=value) if seed % 4 == 3 else ""
    file, text = text_of(
        tmp_path,
        floor=floor,
        foot=foot,
        rank=seed % 3 - 1,
        condim=random.choice([3, 4, 6]),
        contact=explicit,
    )
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 1
    assert f"friction {data.contact.friction[0, 0]:g} is in force" in text
    assert f"condim {data.contact.dim[0]}" in text
    if explicit:
        assert "stated by their pair" in text
    else:
        assert ("higher priority" in text) == (seed % 3 != 1)


def test_other_stacks_combine_the_same_materials_differently():
    """0.3 and 1.0: the greater, the mean, the product, and Drake's 2 a b / (a + b)."""
    combined = {stack: rule(0.3, 1.0) for stack, _, rule in STACKS}
    assert combined["Genesis"] == 1.0 and combined["PyBullet"] == 0.3
    assert combined["PhysX, Isaac Sim, Isaac Lab"] == combined["Rapier"] == 0.65
    assert combined["Drake"] == pytest.approx(0.6 / 1.3)
