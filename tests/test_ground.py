import numpy as np
import pinocchio
import pytest

from richmap.motion.ground import lowest_points
from richmap.robots.robots import load_robot


@pytest.mark.parametrize("name", ["xarm6", "ur5e", "panda", "iiwa7"])
def test_the_lowest_point_is_that_of_all_triangles(name):
    robot = load_robot(name)
    model = pinocchio.buildModelFromXML(robot.urdf)
    data = model.createData()
    joints = np.random.default_rng(0).uniform(robot.lower, robot.upper, (20, len(robot.joints)))
    corners = {
        link: np.concatenate([shape.triangles().vertices for shape in shapes])
        for link, shapes in robot.shapes.items()
        if shapes and robot.depth[link]
    }
    base = model.frames[model.getFrameId(robot.base)].placement.inverse()
    for q, lowest in zip(joints, lowest_points(robot, joints), strict=True):
        pinocchio.framesForwardKinematics(model, data, q)
        heights = []
        for link, points in corners.items():
            pose = base * data.oMf[model.getFrameId(link)]
            heights.append((points @ pose.rotation.T + pose.translation)[:, 2].min())
        assert lowest == pytest.approx(min(heights), abs=1e-9)


def test_turning_about_a_vertical_axis_changes_no_height():
    robot = load_robot("ur3")
    joints = np.random.default_rng(1).uniform(robot.lower, robot.upper, (50, 6))
    turned = joints + [1.0, 0, 0, 0, 0, 0]
    assert lowest_points(robot, turned) == pytest.approx(lowest_points(robot, joints))
