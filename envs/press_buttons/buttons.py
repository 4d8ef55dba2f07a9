"""The table and the four buttons as a model: caps on springs, in housings that stand in the air."""

import numpy as np

from envs.arm.arena import LIGHTS, SKY_AND_TABLE, TextArena
from envs.arm.contact import ARM_BIT
from envs.press_buttons.workspace import CAP_HEIGHT, CAP_RADIUS, DEEPEST, HOUSING_HEIGHT, HOUSING_RADIUS
from richmap.task_spaces.press_buttons import BUTTONS

CAP_MASS = 0.02
"""In [kg]."""
STIFFNESS = 300.0
"""Of the spring behind a cap, in [N/m]: 3.6 N where the switch closes."""
DAMPING = 2 * np.sqrt(STIFFNESS * CAP_MASS)
"""Of the cap's motion, in [N s/m]: critical, so that it comes back without a swing."""
WAITING, WAS_PRESSED = (0.85, 0.25, 0.22, 1.0), (0.25, 0.7, 0.35, 1.0)
"""Colours of caps."""
NAMES = tuple(f"button{i}" for i in range(BUTTONS))
"""Of the buttons' bodies, which can be put anywhere (mocap), their face at the origin and its normal along z."""


class ButtonTable(TextArena):
    """Table top at z = 0, four buttons, lights, a camera."""

    def __init__(self) -> None:
        super().__init__(_XML)


def _button_xml(name: str) -> str:
    """A body with a housing, and in it a cap that slides along z; each is a body that collides with the arm alone."""
    collides = f'contype="0" conaffinity="{ARM_BIT}" condim="4" friction="1 0.005 0.0001" solref="0.004 1" group="1"'
    cap = f"{CAP_RADIUS} {CAP_HEIGHT / 2}"
    return f"""
    <body name="{name}" mocap="true">
      <geom name="{name}_housing" type="cylinder" pos="0 0 {-CAP_HEIGHT - HOUSING_HEIGHT / 2}"
            size="{HOUSING_RADIUS} {HOUSING_HEIGHT / 2}" rgba="0.25 0.27 0.3 1" {collides}/>
      <body name="{name}_cap" gravcomp="1">
        <inertial pos="0 0 {-CAP_HEIGHT / 2}" mass="{CAP_MASS}" diaginertia="1e-5 1e-5 1e-5"/>
        <joint name="{name}_slide" type="slide" axis="0 0 -1" range="0 {DEEPEST}" limited="true"
               stiffness="{STIFFNESS}" damping="{DAMPING}"/>
        <geom name="{name}_cap" type="cylinder" pos="0 0 {-CAP_HEIGHT / 2}" size="{cap}"
              rgba="{" ".join(map(str, WAITING))}" {collides}/>
      </body>
    </body>"""


_XML = f"""
<mujoco model="buttons">
  <asset>{SKY_AND_TABLE}
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="3 3 0.1" material="table" group="1" friction="1 0.005 0.0001"
          solref="0.004 1"/>
    {"".join(map(_button_xml, NAMES))}{LIGHTS}
    <camera name="front" pos="1.55 -0.6 0.95" xyaxes="0.4191 0.9080 -0.0000 -0.3608 0.1665 0.9177" fovy="40"/>
  </worldbody>
</mujoco>
"""
