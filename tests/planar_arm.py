"""An arm in a plane, of which closed forms are known."""

import richmap

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
LIMIT = '<limit lower="{}" upper="{}" effort="1" velocity="{}"/>'


def planar(lower=-3.0, upper=3.0, speed=2.0):
    """Three joints about z with links of 0.4, 0.3 and 0.1 m: it reaches 0.8 m, and a pose in its plane in two ways."""
    joints = [("base", "a", 0.0), ("a", "b", 0.4), ("b", "c", 0.3)]
    parts = [
        f'<joint name="{child}" type="revolute"><parent link="{parent}"/><child link="{child}"/><origin xyz="{x} 0 0"/>'
        f'<axis xyz="0 0 1"/>{LIMIT.format(lower, upper, speed)}</joint><link name="{child}">{INERTIAL}</link>'
        for parent, child, x in joints
    ]
    tool = '<joint name="t" type="fixed"><parent link="c"/><child link="tool"/><origin xyz="0.1 0 0"/></joint>'
    text = f'<robot name="planar"><link name="base"/>{"".join(parts)}{tool}<link name="tool"/></robot>'
    return richmap.RobotDescription("planar", text, "base", "tool", "", "")
