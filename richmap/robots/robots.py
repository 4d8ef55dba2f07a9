"""The eight arms: which package each is read from, and what is put right on the way."""

import importlib.metadata
import importlib.util
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from richmap.robots.robot import RobotDescription
from richmap.robots.urdf import clean_urdf, with_full_turns, with_origins, without_extras

ROBOTS = ("xarm6", "ur3", "ur5", "ur10", "panda", "iiwa7", "ur5e", "gen3")

QUARTER, HALF = "1.5707963267948966", "3.141592653589793"

IIWA7_ORIGINS = {"right_hand": ("0 0 0.045", "0 0 0")}
"""KUKA's media flange is 126 mm from the wrist's centre; robosuite puts its hand 1 mm before that."""

UR5E_ORIGINS = {
    "shoulder_link": ("0 0 0.1625", "0 0 0"),
    "upper_arm_link": ("0 0.138 0", f"0 {QUARTER} 0"),
    "forearm_link": ("0 -0.131 0.425", "0 0 0"),
    "wrist_1_link": ("0 0 0.3922", f"0 {QUARTER} 0"),
    "wrist_2_link": ("0 0.1263 0", "0 0 0"),
    "wrist_3_link": ("0 0 0.0997", "0 0 0"),
    "right_hand": ("0 0.0996 0", f"-{QUARTER} 0 0"),
}
"""Universal Robots' published lengths; robosuite rounds them (1.6 mm at the flange)."""

GEN3_ORIGINS = {
    "shoulder_link": ("0 0 0.15643", f"{HALF} 0 0"),
    "HalfArm1_Link": ("0 0.005375 -0.12838", f"{QUARTER} 0 0"),
    "HalfArm2_Link": ("0 -0.21038 -0.006375", f"-{QUARTER} 0 0"),
    "forearm_link": ("0 0.006375 -0.21038", f"{QUARTER} 0 0"),
    "SphericalWrist1_Link": ("0 -0.20843 -0.006375", f"-{QUARTER} 0 0"),
    "SphericalWrist2_Link": ("0 0.00017505 -0.10593", f"{QUARTER} 0 0"),
    "Bracelet_Link": ("0 -0.10593 -0.00017505", f"-{QUARTER} 0 0"),
    "right_hand": ("0 0 -0.0615", f"{HALF} 0 0"),
}
"""Kinova's lengths, as robosuite has them, with exact right angles: robosuite rounds its quaternions to 5 digits."""

UR5E_MESHES = {
    "fixed_base_link": "base", "shoulder_link": "shoulder", "upper_arm_link": "upperarm", "forearm_link": "forearm",
    "wrist_1_link": "wrist1", "wrist_2_link": "wrist2", "wrist_3_link": "wrist3",
}  # fmt: skip
"""Meshes of the UR5e's links. Those that robosuite collides are convex hulls, so the ones that it shows are used."""


@lru_cache
def load_robot(name: str) -> RobotDescription:
    """Description of one of the robots that the package knows.

    Raises:
        ValueError: If there is no robot of that name.
    """
    if name not in ROBOTS:
        raise ValueError(f"There is no robot {name!r}. Robots: {', '.join(ROBOTS)}")
    if name in ("ur3", "ur5", "ur10"):
        return _universal_robots_cb(name)
    return {"xarm6": _xarm6, "panda": _panda, "iiwa7": _iiwa7, "ur5e": _ur5e, "gen3": _gen3}[name]()


def _xarm6() -> RobotDescription:
    """UFactory xArm6, as described by the QUT Centre for Robotics."""
    import rtbdata
    import xacro

    data = Path(rtbdata.__file__).parent
    text = xacro.process_file(data / "armer_xarm/data/xacro/robots/xarm6/xarm6.xacro").toxml()
    return RobotDescription(
        name="xarm6",
        urdf=clean_urdf(text, {"package://armer_xarm/": f"{data}/armer_xarm/"}, "link_base", "link6"),
        base="link_base",
        end_effector="link6",
        source=f"rtb-data {importlib.metadata.version('rtb-data')}, armer_xarm",
        licence="MIT",
    )


def _universal_robots_cb(name: str) -> RobotDescription:
    """UR3, UR5 or UR10 of the CB series, as described by ur_description."""
    return _from_example_robot_data(name, f"{name}_robot.urdf", "base_link", "tool0", "ur_description", "BSD-3-Clause")


def _panda() -> RobotDescription:
    """Franka Panda without its hand, as described by franka_description; the flange is panda_link8.

    Its collision meshes are the maker's, one convex hull per link. They are wider than the meshes that are shown: 6.3 %
    of the configurations that are free by those collide by these (n = 20,000).
    """
    robot = _from_example_robot_data(
        "panda", "panda.urdf", "panda_link0", "panda_link8", "panda_description", "Apache-2.0"
    )
    return replace(robot, urdf=without_extras(robot.urdf))


def _from_example_robot_data(
    name: str, file: str, base: str, end_effector: str, folder: str, licence: str
) -> RobotDescription:
    files = importlib.metadata.files("example-robot-data")
    urdf = next(Path(f.locate()) for f in files if f.name == file).resolve()
    share = urdf.parents[4]
    return RobotDescription(
        name=name,
        urdf=clean_urdf(urdf.read_text(), {"package://": f"{share}/"}, base, end_effector),
        base=base,
        end_effector=end_effector,
        source=f"example-robot-data {importlib.metadata.version('example-robot-data')}, {folder}",
        licence=licence,
    )


def _iiwa7() -> RobotDescription:
    """KUKA LBR iiwa 7 R800 with its media flange (iiwa_link_ee of iiwa_description)."""
    return _from_robosuite("iiwa7", "iiwa", with_origins(_robosuite_urdf("iiwa"), IIWA7_ORIGINS))


def _gen3() -> RobotDescription:
    """Kinova Gen3, seven joints, with vision; its four continuous joints get the range of one turn."""
    return _from_robosuite("gen3", "kinova3", with_full_turns(with_origins(_robosuite_urdf("kinova3"), GEN3_ORIGINS)))


def _ur5e() -> RobotDescription:
    """Universal Robots UR5e."""
    root = ET.fromstring(with_origins(_robosuite_urdf("ur5e"), UR5E_ORIGINS))
    for link in root.iter("link"):
        for collision in link.findall("collision"):
            link.remove(collision)
        if link.get("name") in UR5E_MESHES:
            file = _robosuite_folder("ur5e") / "meshes" / f"{UR5E_MESHES[link.get('name')]}_vis.stl"
            collision = ET.SubElement(link, "collision")
            ET.SubElement(collision, "origin", xyz="0 0 0", rpy=f"{QUARTER} 0 0")  # The mesh has y up.
            ET.SubElement(ET.SubElement(collision, "geometry"), "mesh", filename=str(file))
    return _from_robosuite("ur5e", "ur5e", ET.tostring(root, encoding="unicode"))


def _from_robosuite(name: str, folder: str, urdf: str) -> RobotDescription:
    return RobotDescription(
        name=name,
        urdf=urdf,
        base="fixed_base_link",
        end_effector="right_hand",
        source=f"robosuite {importlib.metadata.version('robosuite')}, {folder}",
        licence="MIT",
    )


def _robosuite_urdf(folder: str) -> str:
    """An arm of robosuite's, from its base to its hand."""
    from richmap.robots.mjcf import urdf_from_mjcf

    urdf = urdf_from_mjcf(_robosuite_folder(folder) / "robot.xml")
    return clean_urdf(urdf, {}, "fixed_base_link", "right_hand")


def _robosuite_folder(folder: str) -> Path:
    (package,) = importlib.util.find_spec("robosuite").submodule_search_locations  # Importing it takes seconds.
    return Path(package).resolve() / "models/assets/robots" / folder
