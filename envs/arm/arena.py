"""What stands around an arm, from a text, as robosuite has it."""

import tempfile
from pathlib import Path

from robosuite.models.arenas import Arena


class TextArena(Arena):
    """Floor, lights, a camera `front` and what else an MJCF text holds; its floor is a geom `floor`."""

    def __init__(self, text: str) -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "table.xml")
            file.write_text(text)
            super().__init__(str(file))

    def _postprocess_arena(self) -> None:
        """Drop the markers that robosuite adds for its viewer's mouse control."""
        for body in self.worldbody.findall("body"):
            if body.get("name").endswith("_eef_target"):
                self.worldbody.remove(body)


SKY_AND_TABLE = """
    <texture type="skybox" builtin="gradient" rgb1="0.95 0.96 0.98" rgb2="0.72 0.77 0.84" width="256"
             height="256"/>
    <texture name="grid" type="2d" builtin="checker" rgb1="0.60 0.62 0.65" rgb2="0.57 0.59 0.62" width="256"
             height="256" mark="edge" markrgb="0.66 0.68 0.71"/>
    <material name="table" texture="grid" texrepeat="10 10" texuniform="true" specular="0.1"/>"""
"""Assets that every arena has."""
LIGHTS = """
    <light name="key" pos="1.0 -0.8 1.9" dir="-0.45 0.45 -1.1" diffuse="0.7 0.7 0.7" specular="0.2 0.2 0.2"/>
    <light name="fill" pos="0.3 1.4 1.7" dir="0 -0.9 -1" diffuse="0.4 0.4 0.42" castshadow="false"/>"""
"""Likewise what lights it."""
