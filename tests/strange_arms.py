"""Small descriptions of arms as strangers write them."""

LIMIT = '<limit lower="-2" upper="2" effort="1" velocity="1"/>'
CYLINDER = '<cylinder length="0.15" radius="0.02"/>'


def urdf(extra="", mesh=CYLINDER, lift="lift", roll="roll"):
    """Four joints: pan about z, lift and bend about y, roll about z."""
    return f"""<robot name="mini">
  <link name="base"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
  <joint name="pan" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.1"/>
    <axis xyz="0 0 1"/>{LIMIT}</joint>
  <link name="upper"><collision><origin xyz="0 0 0.1"/><geometry>{mesh}</geometry></collision></link>
  <joint name="{lift}" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 0.2"/>
    <axis xyz="0 1 0"/>{LIMIT}</joint>
  <link name="fore"><collision><origin xyz="0 0 0.1"/><geometry>{CYLINDER}</geometry></collision></link>
  <joint name="bend" type="revolute"><parent link="fore"/><child link="hand"/><origin xyz="0 0 0.2"/>
    <axis xyz="0 1 0"/>{LIMIT}</joint>
  <link name="hand"><collision><origin xyz="0 0 0.05"/><geometry><sphere radius="0.02"/></geometry></collision></link>
  <joint name="{roll}" type="revolute"><parent link="hand"/><child link="tool"/><origin xyz="0 0 0.1"/>
    <axis xyz="0 0 1"/>{LIMIT}</joint>
  <link name="tool"/>
  {extra}
</robot>
"""


def fixed(parent, child, xyz="0 0 0", rpy="0 0 0", shape="", more=""):
    """A link that is fixed to another one."""
    shape = f"<collision><geometry>{shape}</geometry></collision>" if shape else ""
    return f"""<joint name="{child}_mount" type="fixed"><parent link="{parent}"/><child link="{child}"/>
        <origin xyz="{xyz}" rpy="{rpy}"/>{more}</joint><link name="{child}">{shape}</link>"""


WALL = '<box size="0.1 0.6 0.6"/>'

MJCF = """<mujoco><compiler angle="radian"/>{default}<worldbody><body name="base">
  <geom name="foot" type="cylinder" size=".06 .05"/>
  <body name="l1" pos="0 0 .06"><joint name="a" axis="0 0 1" range="-2 2"/><geom type="sphere" size=".03"/>
    <body name="l2" pos="0 0 .06"><joint name="b" axis="0 1 0" range="-1 1"/>
      <geom name="rod" type="capsule" fromto="0 0 -.06 0 0 .2" size=".03"/>
      <body name="l3" pos="0 0 .2"><joint name="c" axis="0 1 0" range="-2.9 2.9"/>
        <geom name="ball" type="sphere" pos="0 0 .26" size=".02"/><site name="tip" pos="0 0 .28"/>
        <body name="blade" pos="0 0 .05"><geom type="sphere" size=".04"/></body>
      </body></body></body></body></worldbody>{contact}</mujoco>"""


def collada(unit, up="Z_UP"):
    """A block of 2 x 2 x 6 units."""
    return f"""<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="{unit}"/><up_axis>{up}</up_axis></asset><library_geometries><geometry id="g"><mesh><source id="p">
<float_array id="pa" count="24">-1 -1 -3 1 -1 -3 1 1 -3 -1 1 -3 -1 -1 3 1 -1 3 1 1 3 -1 1 3</float_array>
<technique_common><accessor source="#pa" count="8" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="12">
<input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 3 2 4 5 6 4 6 7 0 1 5 0 5 4 1 2 6 1 6 5 2 3 7 2 7 6 3 0 4 3
4 7</p></triangles></mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node id="n">
<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
