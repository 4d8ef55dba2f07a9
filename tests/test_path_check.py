"""What an arm follows of a path, against closed forms and another library's inverse kinematics."""

import dataclasses

import mink
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import richmap
from richmap.motion.kinematics import flange_frames
from richmap.motion.reach import reach_ball
from richmap.paths.base_search import best_base, candidates
from richmap.paths.path_check import Reason
from richmap.paths.pose_path import PosePath
from richmap.physics.mujoco_model import kinematic_spec
from richmap.robots.robots import load_robot
from richmap.similarity.similarity import compare_maps
from tests.planar_arm import planar


def checked_path(robot, path, episodes=None, **options):
    """With the whole pose asked for: of three joints the roll, here the turn in the plane, would be left free."""
    return richmap.check(robot, path, episodes, free_roll=False, **options)


def poses(positions, angle=0.0):
    """Poses whose x axis is turned about z by an angle, or by one each, in [rad]."""
    quaternion = Rotation.from_euler("z", np.broadcast_to(angle, len(positions))[:, None]).as_quat()
    return np.column_stack([positions, quaternion])


def line(start, end, n):
    return np.linspace(start, end, n)


def around(joint, n, step):
    """Poses of the planar arm as one joint turns by a step, in [rad], at a time."""
    joints = np.tile([0.3, 0.9, -0.5], (n, 1))
    joints[:, joint] += step * np.arange(n)
    positions, rotations = flange_frames(planar(-9.0, 9.0), joints)
    return np.column_stack([positions, Rotation.from_matrix(rotations).as_quat()]), joints


def test_a_line_within_reach_is_followed_in_one_branch():
    robot = planar()
    checked = checked_path(robot, poses(line([0.3, 0.2, 0], [0.5, -0.2, 0], 100)))
    assert checked.steps_followed == checked.episodes_followed == 1.0 and not checked.lost
    positions, _ = flange_frames(robot, checked.joints)
    assert positions == pytest.approx(checked.path.positions, abs=1e-5)
    assert np.abs(np.diff(checked.joints, axis=0)).max() < 0.05
    assert len({*np.sign(checked.joints[:, 1])}) == 1


def test_it_is_lost_where_the_line_leaves_the_reach():
    """The wrist, 0.1 m behind the flange, is 0.7 m from the first axis at most."""
    positions = line([0.4, 0.0, 0], [0.9, 0.0, 0], 201)
    checked = checked_path(planar(), poses(positions), speed=100.0, period=10.0)
    beyond = positions[:, 0] - 0.1 > 0.7 + 1e-3  # the tolerance
    assert ((checked.reason == Reason.OUT_OF_REACH) == beyond).all() and (checked.followed == ~beyond).all()
    (lost,) = checked.lost
    assert lost.step == np.argmax(beyond) and lost.steps == beyond.sum()
    assert lost.position[0] == pytest.approx(0.8015, abs=1.3e-3)
    assert lost.about.startswith(f"{lost.position[0]:.3f} m from the shoulder; the flange gets 0.800 m")
    assert reach_ball(planar())[1] == pytest.approx(0.8)


def test_it_goes_on_when_the_line_comes_back():
    out = line([0.7, 0.1, 0], [0.9, 0.0, 0], 50)
    checked = checked_path(planar(), poses(np.concatenate([out, out[::-1]])), period=1.0)
    assert checked.followed[:20].all() and not checked.followed[40:60].any() and checked.followed[-20:].all()
    assert checked.episodes_followed == 0.0


def test_a_joint_s_limit_is_named():
    path, joints = around(0, 100, 0.01)
    checked = checked_path(planar(-1.2, 1.0), path)
    beyond = joints[:, 0] > 1.0 + 0.002  # about the tolerance of 1 mm at 0.8 m
    assert ((checked.reason == Reason.JOINT_LIMIT) == beyond).all() and checked.followed[~beyond].all()
    assert checked.lost[0].about == f"a at {joints[np.argmax(beyond), 0]:.3f} rad, its limit is 1.000 rad"


def test_a_joint_is_turned_back_by_a_whole_turn_if_there_is_time():
    """From -3.5 to 3.5 rad: at 3.5 the joint has to go back by a turn, which takes it 2 pi / 2 s."""
    path, joints = around(0, 120, 0.05)
    checked = checked_path(planar(-3.5, 3.5), path, period=0.1)
    out = joints[:, 0] > 3.5 + 0.002
    back = np.argmax(out) - 1 + np.ceil((2 * np.pi - 0.05 * 20) / 0.2 / 1)  # about; it moves on meanwhile
    lost = np.flatnonzero(~checked.followed)
    assert lost[0] == np.argmax(out) and {*checked.reason[lost]} == {Reason.JOINT_LIMIT}
    assert (np.diff(lost) == 1).all() and abs(lost[-1] - back) <= 3
    assert checked.joints[-1, 0] == pytest.approx(joints[-1, 0] - 2 * np.pi, abs=1e-4)


@pytest.mark.system
@pytest.mark.parametrize("joint", [0, 6])
def test_a_joint_that_turns_without_end_goes_twice_round(joint):
    """The other six joints move as they like, and share in the turning."""
    robot = load_robot("gen3")
    assert robot.continuous == tuple(robot.joints[::2])
    joints = np.tile([0.3, 0.5, -0.2, 1.6, 0.1, 0.9, 0.4], (160, 1))
    joints[:, joint] += np.linspace(0, 4 * np.pi, 160)
    positions, rotations = flange_frames(robot, joints)
    checked = richmap.check(robot, np.column_stack([positions, Rotation.from_matrix(rotations).as_quat()]))
    assert checked.steps_followed == 1.0
    assert checked.joints[-1, joint] - checked.joints[0, joint] > 3 * np.pi
    assert flange_frames(robot, checked.joints)[0] == pytest.approx(positions, abs=1e-3)
    stopped = richmap.check(dataclasses.replace(robot, continuous=()), checked.path)
    assert stopped.steps_followed < 1.0


def test_a_joint_that_turns_without_end_stops_where_its_limits_are_narrowed():
    robot = dataclasses.replace(planar(-np.pi, np.pi), continuous=("a", "c"))
    assert np.stack(robot.stops).tolist() == [[-np.inf, -np.pi, -np.inf], [np.inf, np.pi, np.inf]]
    narrow = robot.narrowed(robot.lower, np.array([1.0, np.pi, np.pi]))
    assert np.stack(narrow.stops)[:, 0].tolist() == [-np.pi, 1.0]


@pytest.mark.parametrize("step, waits", [(0.199, 0), (0.201, 1), (0.5, 2), (0.65, 3)])
def test_a_step_of_the_base_takes_as_long_as_the_joint_needs(step, waits):
    """At 2 rad/s a joint moves 0.2 rad in 0.1 s; the path rests before and after the step."""
    path, _ = around(0, 2, step)
    path = np.repeat(path, [5, 10], axis=0)
    checked = checked_path(planar(), path, period=0.1)
    assert (checked.reason == Reason.TOO_FAST).tolist() == [False] * 5 + [i < waits for i in range(10)]
    assert checked.reachable.all()
    if waits:
        assert checked.lost[0].about == f"a at {step / 0.1:.2f} rad/s, 2.00 rad/s is its most"


def test_what_only_the_other_elbow_reaches_is_no_path():
    """Elbow one way and then the other: each pose is reached, and no branch has both."""
    robot = planar(-3.0, 3.0)
    robot = robot.narrowed(np.array([-1.0, -2.0, -3.0]), np.array([1.0, 2.0, 3.0]))
    joints = np.array([[0.9, -1.5, 0.2], [-0.9, 1.5, -0.2]])
    positions, rotations = flange_frames(robot, joints)
    path = PosePath.of(np.column_stack([positions, Rotation.from_matrix(rotations).as_quat()]), period=100.0)
    checked = checked_path(robot, path)
    assert checked.reachable.tolist() == [True, True]
    assert checked.followed.sum() == 1 or np.sign(checked.joints[0, 1]) == np.sign(checked.joints[1, 1])


def test_links_that_touch_are_named():
    robot = load_robot("ur3")
    joints = np.tile([0.1, -1.4, 1.5, -1.7, -1.5, 0.2], (40, 1))
    joints[:, 2] = np.linspace(1.5, 2.9, 40)  # The forearm folds onto the upper arm.
    positions, rotations = flange_frames(robot, joints)
    path = PosePath.of(np.column_stack([positions, Rotation.from_matrix(rotations).as_quat()]), period=10.0)
    checked = richmap.check(robot, path)
    from richmap.motion.collision import self_collision

    hits = self_collision(robot)(checked.joints)
    assert ((checked.reason == Reason.SELF_COLLISION) == hits).all() and hits.any()
    assert " and " in next(lost for lost in checked.lost if lost.reason == Reason.SELF_COLLISION).about


def mink_reaches(robot, position, rotation, starts):
    """Whether differential inverse kinematics of another library reaches a pose within the limits from any start."""
    model = kinematic_spec(robot).compile()
    model.jnt_range[:], model.jnt_limited[:] = np.stack([robot.lower, robot.upper], 1), True
    configuration = mink.Configuration(model)
    task = mink.FrameTask(robot.end_effector, "body", position_cost=1.0, orientation_cost=0.2, lm_damping=1e-3)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, position
    task.set_target(mink.SE3.from_matrix(pose))
    limits = [mink.ConfigurationLimit(model)]
    for start in starts:
        configuration.update(start)
        for _ in range(40):
            velocity = mink.solve_ik(configuration, [task], 1.0, "daqp", limits=limits)
            configuration.integrate_inplace(velocity, 1.0)
            error = task.compute_error(configuration)
            if np.linalg.norm(error[:3]) < 1e-3 and np.linalg.norm(error[3:]) < 1e-2:
                return True
    return False


def test_single_poses_agree_with_another_library():
    robot, rng = planar(-1.5, 1.5), np.random.default_rng(0)
    positions, rotations = flange_frames(robot, rng.uniform(-2.5, 2.5, (20, 3)))
    path = np.column_stack([positions, Rotation.from_matrix(rotations).as_quat()])
    checked = checked_path(robot, path, np.arange(20))
    starts = rng.uniform(robot.lower, robot.upper, (8, 3))
    found = [mink_reaches(robot, *pose, starts) for pose in zip(positions, rotations, strict=True)]
    assert checked.reachable.tolist() == found and 4 < sum(found) < 16
    assert (checked.followed == checked.reachable).all()
    assert {*checked.reason} == {Reason.FOLLOWED, Reason.JOINT_LIMIT}


def test_maps_stand_beside(sampled_map):
    from richmap.geometry.grid import Grid

    grid = Grid.around_base(cell_size=0.1, half_width=0.8, z_offset=0.2)
    robot, robot_map, other = load_robot("ur3"), sampled_map("ur3", grid, 20_000), sampled_map("ur5", grid, 20_000)
    down = np.tile([0, 1.0, 0, 0], (40, 1))
    path = np.column_stack([line([0.2, 0.2, 0.2], [0.9, 0.2, 0.2], 40), down])
    checked = richmap.check(robot, path, robot_map=robot_map, source_map=other)
    assert (checked.mapped == robot_map.reachable(path[:, :3], np.tile([0, 0, -1.0], (40, 1)))).all()
    cells = grid.cells_of(path[:, :3])
    mmd = compare_maps(other, robot_map).mmd
    assert np.array_equal(checked.mmd[cells >= 0], mmd[cells[cells >= 0]], equal_nan=True)
    assert np.isnan(checked.mmd[cells < 0]).all()
    too_much, too_little = checked.map_errors()
    assert too_much == np.mean(checked.mapped[~checked.reachable])
    assert too_little == np.mean(~checked.mapped[checked.reachable])
    with pytest.raises(ValueError, match="The map is of ur5, and the arm is ur3"):
        richmap.check(robot, path, robot_map=other)


def test_the_best_base_is_where_the_path_is_followed(sampled_map):
    from richmap.geometry.grid import Grid

    grid = Grid.around_base(cell_size=0.1, half_width=0.8, z_offset=0.2)
    robot, robot_map = load_robot("ur3"), sampled_map("ur3", grid, 20_000)
    down = np.tile([0, 1.0, 0, 0], (30, 1))
    path = PosePath.of(np.column_stack([line([0.8, -0.15, 0.2], [0.8, 0.15, 0.2], 30), down]))
    bases = candidates(np.array([[0, 0.6], [0, 0], [0, 0], [0, 0]]), 0.2)
    assert bases[:, 0] == pytest.approx([0, 0.2, 0.4, 0.6])
    found = best_base(robot, path, robot_map, bases)
    assert richmap.check(robot, path).steps_followed < 1
    assert found.check.steps_followed == 1 and found.best[0] in (0.4, 0.6)
    assert found.check.path.positions == pytest.approx(path.positions - found.best[:3])


def test_a_path_seen_from_another_base_is_the_same_path():
    base = np.array([0.1, -0.2, 0.3, 0.7])
    path = PosePath.of(poses(line([0.3, 0.2, 0], [0.5, -0.2, 0], 7), 0.4))
    seen, turn = path.seen_from(base), Rotation.from_euler("z", 0.7).as_matrix()
    assert seen.positions @ turn.T + base[:3] == pytest.approx(path.positions)
    assert turn @ seen.rotations == pytest.approx(path.rotations)


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda p: p[:, :6], r"an array \(n, 7\) with n >= 1. Got \(5, 6\)"),
        (lambda p: p[:0], r"n >= 1. Got \(0, 7\)"),
        (
            lambda p: np.where(np.arange(5)[:, None] >= 3, np.nan, p),
            r"Row 4 \(and 1 more rows\) holds no finite number",
        ),
        (lambda p: p + [0, 1e300, 0, 0, 0, 0, 0], r"Row 1 .* farther than 1000 m from the base: .*1e\+300"),
        (lambda p: p * [1, 1, 1, 1e300, 1, 1, 1e300], "a quaternion .* length than 1: 1e"),
        (lambda p: p * [1, 1, 1, 2, 2, 2, 2], r"Row 1 \(and 4 more rows\) holds a quaternion .* length than 1: 2"),
    ],
)
def test_what_is_no_pose_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        richmap.check(planar(), change(poses(np.zeros((5, 3)))))


def test_an_episode_is_in_one_piece():
    with pytest.raises(ValueError, match="Row 3 goes on with episode 7, which ended before"):
        checked_path(planar(), poses(np.zeros((3, 3))), [7, 8, 7])
    with pytest.raises(ValueError, match=r"Episodes are a whole number per pose, 3 of them. Got float64 \(3,\)"):
        checked_path(planar(), poses(np.zeros((3, 3))), [0.5, 0.5, 0.5])
