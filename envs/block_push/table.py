"""The table with its two blocks and two targets, as robosuite models."""

import xml.etree.ElementTree as ET

from robosuite.models.objects import BoxObject

from envs.arm.arena import LIGHTS, SKY_AND_TABLE, TextArena
from envs.block_push.success import SUCCESS_RADIUS

BLOCK_EDGE = 0.04
"""In [m]."""
BLOCK_MASS = 0.01
"""In [kg]."""
BLOCK_INERTIA = 8e-6
"""About every axis, in [kg m^2]: three times a solid cube's, as in the original."""
COLOURS = {
    "block": "1 0.3412 0.3490 1",
    "block2": "0.3412 0.8 0.3490 1",
    "target": "0.20 0.65 0.35 1",
    "target2": "0.85 0.30 0.30 1",
}


class Table(TextArena):
    """Table top at z = 0, the workspace marked on it, targets that can be moved (mocap bodies), lights, a
    camera."""

    def __init__(self) -> None:
        super().__init__(_TABLE_XML)


def make_block(name: str) -> BoxObject:
    """A cube that slides on the table, with the original's mass, inertia and friction."""
    block = BoxObject(
        name=name,
        size=[BLOCK_EDGE / 2] * 3,
        friction=(1.0, 0.005, 0.0001),
        solref=(0.004, 1),
        rgba=[float(c) for c in COLOURS[name].split()],
        joints=[{"type": "free", "damping": "0"}],
    )
    inertia = " ".join([str(BLOCK_INERTIA)] * 3)
    block.get_obj().insert(0, ET.Element("inertial", pos="0 0 0", mass=str(BLOCK_MASS), diaginertia=inertia))
    return block


def _target_xml(name: str) -> str:
    """The square that the original shows, and in it the disc that counts."""
    colour = COLOURS[name].rsplit(" ", 1)[0]
    unseen = 'contype="0" conaffinity="0" group="1"'
    return f"""
    <body name="{name}" mocap="true">
      <geom name="{name}_square" type="box" size="0.06 0.06 0.0005" rgba="{colour} 0.45" {unseen}/>
      <geom name="{name}_disc" type="cylinder" size="{SUCCESS_RADIUS} 0.0008" rgba="{colour} 0.9" {unseen}/>
    </body>"""


_TABLE_XML = f"""
<mujoco model="table">
  <asset>{SKY_AND_TABLE}
    <material name="mat" rgba="0.30 0.33 0.38 1" specular="0.1" shininess="0.1"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="3 3 0.1" material="table" group="1" friction="1 0.005 0.0001"
          solref="0.004 1"/>
    <geom name="workspace" type="box" pos="0.35 0 0.0001" size="0.2505 0.4995 0.0001" material="mat"
          contype="0" conaffinity="0" group="1"/>
    {_target_xml("target")}{_target_xml("target2")}{LIGHTS}
    <camera name="front" pos="1.22 -0.3 1.12" xyaxes="0.2827 0.9592 -0 -0.6781 0.1999 0.7073" fovy="42"/>
  </worldbody>
</mujoco>
"""
