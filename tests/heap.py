"""A MuJoCo model with every rule by which geoms collide or mix their constants; all of it lies in one heap."""

import mujoco

HEAP = """
<mujoco model="heap">
  <option {option}><flag {flag}/></option>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1" solref=".01 1.2" margin=".002"/>
    <geom name="step" type="box" size=".5 .5 .1" friction="1.5 .02 .003"/>
    <body name="a"><freejoint/>
      <geom name="a1" size=".2" solmix="3" solref=".04 .7" solimp=".5 .8 .01 .4 3" gap=".003"/>
      <geom name="a2" size=".2" priority="2" condim="4" friction=".3 .05 .01" margin=".01"/>
      <body name="a_child" pos=".01 0 0"><joint axis="0 1 0"/>
        <geom name="child" size=".2" condim="6"/>
        <body name="grandchild" pos="0 .01 0"><joint axis="1 0 0"/><geom name="grandchild" size=".2" condim="1"/></body>
      </body>
      <body name="a_welded" pos="0 0 .01"><geom name="welded" size=".2" solref="-500 -20"/></body>
    </body>
    <body name="b"><freejoint/><geom name="b" size=".2" priority="2" solref="-300 -40" friction="0 0 0"/></body>
    <body name="c"><freejoint/><geom name="c" size=".2" solmix="0" solref=".03 1"/></body>
    <body name="d"><freejoint/><geom name="d" size=".2" solmix="0" solref=".05 1" contype="2" conaffinity="1"/></body>
    <body name="e"><freejoint/><geom name="e" size=".2" contype="0" conaffinity="0"/></body>
    <body name="hand" mocap="true"><geom name="hand" size=".2"/></body>
    <body name="post"><joint axis="0 0 1"/><geom name="post" size=".2"/></body>
  </worldbody>
  <contact>
    <exclude body1="a" body2="c"/>
    <pair geom1="e" geom2="c" condim="3" friction=".7 .8 .01 .002 .003" solref=".015 .9" solreffriction=".03 1.1"
      solimp=".6 .7 .02 .3 4" margin=".004" gap=".001"/>
    <pair geom1="b" geom2="a1" condim="4"/>
  </contact>
</mujoco>
"""


def heap(*, option="", flag=""):
    return mujoco.MjModel.from_xml_string(HEAP.format(option=option, flag=flag))
