"""The table with its two blocks and two targets, as robosuite models."""

import tempfile
import xml.etree.ElementTree as ET
from pathlib import Path

from robosuite.models.arenas import Arena
from robosuite.models.objects import BoxObject

from envs.success import SUCCESS_RADIUS

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
ARM_BIT, SCENE_BIT = 2, 1
"""Contact bits: everything meets the scene; whether links meet links is the arm setting's choice."""


class Table(Arena):
    """Table top at z = 0, the workspace marked on it, targets that can be moved (mocap bodies), lights, a camera."""

    def __init__(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "table.xml")
            file.write_text(_TABLE_XML)
            super().__init__(str(file))

    def _postprocess_arena(self) -> None:
        """Drop the markers that robosuite adds for its viewer's mouse control."""
        for body in self.worldbody.findall("body"):
            if body.get("name").endswith("_eef_target"):
                self.worldbody.remove(body)


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
  <asset>
    <texture type="skybox" builtin="gradient" rgb1="0.93 0.95 0.98" rgb2="0.70 0.76 0.84" width="256" height="256"/>
    <texture name="wood" type="2d" builtin="flat" rgb1="0.86 0.83 0.78" rgb2="0.86 0.83 0.78" width="16" height="16"/>
    <material name="table" texture="wood" reflectance="0.03" specular="0.1" shininess="0.1"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 0.1" material="table" group="1" friction="1 0.005 0.0001"
          solref="0.004 1"/>
    <geom name="workspace" type="box" pos="0.35 0 0.0001" size="0.2505 0.4995 0.0001" rgba="0.78 0.80 0.84 1"
          contype="0" conaffinity="0" group="1"/>
    {_target_xml("target")}{_target_xml("target2")}
    <light name="key" pos="0.8 -0.9 1.8" dir="-0.35 0.55 -1.1" diffuse="0.65 0.65 0.65" specular="0.2 0.2 0.2"/>
    <light name="fill" pos="0.2 1.2 1.6" dir="0.1 -0.8 -1" diffuse="0.3 0.3 0.32" castshadow="false"/>
    <camera name="front" pos="1.25 -0.42 0.85" xyaxes="0.42 0.91 0 -0.56 0.26 0.79" fovy="42"/>
  </worldbody>
</mujoco>
"""
