"""What stands in files is what is followed; what is no path is refused in a line."""

import json
import re
import zipfile

import numpy as np
import pandas as pd
import pytest
from lerobot.datasets import LeRobotDataset
from scipy.spatial.transform import Rotation

from benchmark import check
from benchmark.artifacts.pose_files import QUATERNION, PoseColumns, PoseFileError, read_poses
from benchmark.settings.check_config import BaseConfig, CheckConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.setting import SettingError
from richmap.motion.kinematics import flange_frames
from richmap.robots.custom import custom_robot
from tests.strange_arms import urdf


@pytest.fixture
def arm(tmp_path):
    (tmp_path / "mini.urdf").write_text(urdf())
    return RobotConfig("custom", str(tmp_path / "mini.urdf"), "base", "tool")


@pytest.fixture
def demonstrations(arm):
    """Joint angles of two episodes and the poses that they are, with which episode each is of."""
    robot = custom_robot(arm.path, "base", "tool")
    joints = np.linspace([-0.5, 0.4, 0.6, 0.2], [0.6, 0.7, 0.3, 0.5], 12)
    positions, rotations = flange_frames(robot, joints)
    return joints, np.column_stack([positions, Rotation.from_matrix(rotations).as_quat()]), np.repeat([3, 4], 6)


def table(poses, episodes, names=QUATERNION):
    return pd.DataFrame(poses, columns=names).assign(episode=episodes)


def dataset(root, values, episodes, names, feature="observation.state"):
    features = {feature: {"dtype": "float32", "shape": (len(names),), "names": names}}
    made = LeRobotDataset.create("local/x", 20, features, root=root, use_videos=False)
    for i, value in enumerate(values):
        made.add_frame({feature: value.astype(np.float32), "task": "x"})
        if i + 1 == len(values) or episodes[i + 1] != episodes[i]:
            made.save_episode()
    made.finalize()
    return root


def test_every_kind_of_file_says_the_same(arm, demonstrations, tmp_path):
    joints, poses, episodes = demonstrations
    table(poses, episodes).to_csv(tmp_path / "a.csv", index=False)
    np.savez(tmp_path / "b.npz", episode=episodes, **dict(zip(QUATERNION, poses.T, strict=True)))
    np.savez(tmp_path / "c.npz", poses=poses, episode=episodes)
    vectors = np.column_stack([poses[:, :3], Rotation.from_quat(poses[:, 3:]).as_rotvec()])
    robot = custom_robot(arm.path, "base", "tool")
    names = [f"ee.{name}" for name in ("x", "y", "z", "wx", "wy", "wz")]
    turned = dataset(tmp_path / "e", vectors, episodes, names)
    of_joints = dataset(tmp_path / "f", np.degrees(joints), episodes, [f"{name}.pos" for name in robot.joints])
    first, said = read_poses(tmp_path / "a.csv", PoseColumns(), None)
    assert said == "x, y, z, qx, qy, qz, qw, 10 steps per second"
    assert first.positions == pytest.approx(poses[:, :3]) and [*first.episodes] == [*episodes]
    for file, wanted, frequency in [
        (tmp_path / "b.npz", PoseColumns(), 10),
        (tmp_path / "c.npz", PoseColumns(), 10),
        (dataset(tmp_path / "d", poses, episodes, [f"ee.{name}" for name in QUATERNION]), PoseColumns(), 20),
        (turned, PoseColumns(), 20),
        (turned, PoseColumns(names=tuple(names), feature="observation.state"), 20),
        (of_joints, PoseColumns(joints_of=robot, degrees=True), 20),
    ]:
        path, _ = read_poses(file, wanted, None)
        assert path.positions == pytest.approx(first.positions, abs=1e-6)
        assert path.rotations == pytest.approx(first.rotations, abs=1e-6)
        assert len(path.spans) == 2 and path.period == 1 / frequency
    with pytest.raises(PoseFileError, match="more than two turns. If joint angles are in degrees, say so"):
        read_poses(of_joints, PoseColumns(joints_of=robot), None)
    with pytest.raises(PoseFileError, match=r"feature=action is not in it. It has observation.state"):
        read_poses(of_joints, PoseColumns(feature="action"), None)
    with pytest.raises(PoseFileError, match="it lacks columns: x, y, .* It has observation.state: pan.pos, lift.pos"):
        read_poses(of_joints, PoseColumns(), None)
    next((turned / "data").rglob("*.parquet")).write_bytes(b"nothing")
    with pytest.raises(PoseFileError, match="no folder of a LeRobotDataset, or damaged"):
        read_poses(turned, PoseColumns(), None)


def test_columns_are_known_by_the_names_that_people_give_them(arm, demonstrations, tmp_path):
    joints, poses, episodes = demonstrations
    robot, file = custom_robot(arm.path, "base", "tool"), tmp_path / "a.csv"
    whole = table(poses, episodes)
    for name in ("episode", "episode_index", "EPISODE"):
        whole.rename(columns={"episode": name}).to_csv(file, index=False)
        assert [*read_poses(file, PoseColumns(), None)[0].episodes] == [*episodes]
    whole.assign(episode_index=0).to_csv(file, index=False)
    with pytest.raises(PoseFileError, match="says episodes twice, in episode and episode_index"):
        read_poses(file, PoseColumns(), None)
    of_joints = pd.DataFrame(joints, columns=[*robot.joints]).assign(episode=episodes, timestamp=1.0)
    others = {name: f"a{i}" for i, name in enumerate(robot.joints)}
    backwards = of_joints[[*reversed(of_joints.columns)]]
    for each in (of_joints, backwards, of_joints.rename(columns=others)[["timestamp", *others.values(), "episode"]]):
        each.to_csv(file, index=False)
        path, _ = read_poses(file, PoseColumns(joints_of=robot), None)
        assert path.positions == pytest.approx(poses[:, :3], abs=1e-6)
    of_joints.rename(columns={robot.joints[1]: "other"}).to_csv(file, index=False)
    with pytest.raises(PoseFileError, match=f"such as {robot.joints[0]}, and none of {robot.joints[1]}. Other names"):
        read_poses(file, PoseColumns(joints_of=robot), None)


def test_what_would_be_read_otherwise_than_it_is_meant_is_refused(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("x,y,z,wx,wy,wz\n0,0,0,0,0,90\n")
    with pytest.raises(PoseFileError, match="Row 1 is turned by 90, more than a whole turn in rad"):
        read_poses(file, PoseColumns(), None)
    for whole in ("x,y,z,qx,qy,qz,qw,,\n0,0,0,0,0,0,1,,\n", "x,y,z,qx,qy,qz,qw\r0,0,0,0,0,0,1\r"):
        file.write_text(whole, newline="")
        assert len(read_poses(file, PoseColumns(), None)[0].positions) == 1
    file.write_text("x,y,z,qx,qy,qz,qw, x\n0,0,0,0,0,0,1,5\n")
    with pytest.raises(PoseFileError, match="its header names the column 'x' 2 times"):
        read_poses(file, PoseColumns(), None)


@pytest.mark.system
def test_a_check_leaves_tables_a_picture_and_a_page(arm, demonstrations, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    _, poses, episodes = demonstrations
    poses[-1, :3] *= 3  # beyond the reach
    table(poses, episodes).to_csv(tmp_path / "a.csv", index=False)
    out = tmp_path / "out"
    config = CheckConfig(arm, str(tmp_path / "a.csv"), base=BaseConfig(x=[-0.1, 0.1]), output_dir=str(out))
    check.main(config)
    said = capsys.readouterr().out
    assert "follows 91.7 % of 12 steps, and 50.0 % of 2 episodes" in said
    assert re.search(r"out of reach: 1 step \(8.3 %\) in 1 episode; first in episode 4, step 5, at \(", said)
    assert "Not in the cache: the map of " in said and "not calibrated" in said
    steps, arrays = pd.read_csv(out / "steps.csv"), np.load(out / "steps.npz")
    assert steps.followed.tolist() == [True] * 11 + [False] == arrays["followed"].tolist()
    assert steps.reason.iloc[-1] == "out of reach" == arrays["reason"][-1] and "mapped" not in steps
    assert pd.read_csv(out / "losses.csv").loc[0, ["episode", "step", "steps"]].tolist() == [4, 5, 1]
    page = (out / "check.html").read_text()
    assert "followed: 11 steps" in page and "out of reach: 1 step" in page and "axes of the base frame" in page
    assert (out / "poses.ply").read_bytes().startswith(b"ply") and (out / "check.png").stat().st_size > 10_000


@pytest.mark.system
@pytest.mark.parametrize(
    ("name", "why"),
    [("px150", "of whose metres one is 0.4 of px150's"), ("j2s6s200", "too fast:")],
    ids=["reaches nothing in full size", "its joints are slow, and the simulation turns all alike"],
)
def test_an_arm_is_asked_for_the_task_as_the_simulation_has_it(tmp_path, capsys, name, why):
    check.main(CheckConfig(RobotConfig(name), scenes=2, output_dir=str(tmp_path)))
    said = " ".join(capsys.readouterr().out.split())
    assert why in said
    assert int(re.search(r"Expected success of direct transfer: (\d+) %", said)[1]) > 80


def rows(change):
    """A file of five good rows of a path that was changed."""
    good = table(np.tile([0.2, 0.1, 0.3, 0, 1, 0, 0], (5, 1)).astype(object), 0)
    return change(good)


def cell(row, name, value):
    def change(good):
        good[name] = [*good[name][:row], value, *good[name][row + 1 :]]
        return good

    return change


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "the file is empty"),
        ("x,y,z\n", r"it lacks columns: qx, qy, qz, qw. It has x, y, z"),
        ("a.x,b.x,y,z,qx,qy,qz,qw\n", r"it lacks columns: x \(twice or more\)"),
        ("x,y,z,qx,qy,qz,qw\n", "it has no row"),
        (rows(lambda good: good.drop(columns="qw")), "it lacks columns: qw. It has x, y, z, qx, qy, qz"),
        (rows(cell(2, "y", "near")), "Row 3 has 'near' in column y, which is no number"),
        (rows(cell(2, "y", "")), "Row 3 has nothing in column y, which is no number"),
        (rows(cell(1, "z", "inf")), "Row 2 holds no finite number"),
        (rows(cell(3, "qy", 2)), "Row 4 holds a quaternion .* of another length than 1: 2"),
        (rows(cell(3, "episode", 0.5)), "Row 4 has 0.5 in column episode, which is no whole number"),
        (rows(cell(3, "episode", 1)), "Row 5 goes on with episode 0, which ended before"),
        (rows(lambda good: good.assign(x=200, y=100, z=300)), "all 5 positions are beyond the reach of .* by 1000"),
    ],
)
def test_a_damaged_table_is_refused_in_a_line(text, message, arm, tmp_path, capsys):
    file = tmp_path / "a.csv"
    file.write_text(text if isinstance(text, str) else text.to_csv(index=False))
    with pytest.raises(SettingError, match=message) as error:
        check.main(CheckConfig(arm, str(file), output_dir=str(tmp_path / "out")))
    assert str(error.value).startswith(f"poses={file}: ") and "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()


def test_what_is_no_file_of_poses_is_refused(tmp_path):
    (tmp_path / "a.npz").write_bytes(b"PK\3\4 and no more")
    (tmp_path / "a.txt").write_text("1 2 3")
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe\0\0x")
    np.savez(tmp_path / "b.npz", x=np.zeros(2), y=np.zeros(3))
    np.savez(tmp_path / "c.npz", poses=np.zeros((2, 6)))
    np.savez(tmp_path / "d.npz", x=np.array([None]))
    np.savez_compressed(tmp_path / "whole.npz", poses=np.random.default_rng(0).normal(size=(50, 7)))
    packed = bytearray((tmp_path / "whole.npz").read_bytes())
    packed[len(packed) // 2] ^= 255
    (tmp_path / "e.npz").write_bytes(packed)
    np.savez(tmp_path / "f.npz", poses=np.ones((2, 7), dtype=complex))
    np.savez(tmp_path / "g.npz", poses=np.eye(2, 7, 6), episode=[1e30, 1e30])
    np.savez(tmp_path / "h.npz", poses=np.eye(2, 7, 6), episode=np.array(0.5))
    np.savez(tmp_path / "i.npz", **dict.fromkeys(QUATERNION, np.zeros(2, dtype="M8[s]")))
    with zipfile.ZipFile(tmp_path / "j.npz", "w", zipfile.ZIP_DEFLATED) as bomb, bomb.open("x.npy", "w") as zeros:
        for _ in range(1200):
            zeros.write(bytes(10**6))
    (tmp_path / "b.csv").write_text("x,y,z,qx,qy,qz,qw\n0.3,0.1,0.3,0,1,0,0,0\n")
    (tmp_path / "c.csv").write_text("x,y,z,qx,qy,qz,qw\nTrue,0.1,0.3,0,1,0,0\n")
    (tmp_path / "d.csv").write_text("x" * 200_000)
    (tmp_path / "folder").mkdir()
    (tmp_path / "broken" / "meta").mkdir(parents=True)
    (tmp_path / "broken" / "meta" / "info.json").write_text(json.dumps([1]))
    for name, message in {
        "a.npz": "damaged, or no .npz file", "a.txt": "its name ends in '.txt'", "a.csv": "no table of comma-separated",
        "b.npz": "differ in length: x 2, y 3", "c.npz": r"it holds poses \(2, 6\)", "d.npz": "no .npz file of plain",
        "e.npz": "damaged, or no .npz file", "f.npz": "column x holds complex128", "g.npz": "Row 1 has 1e.30",
        "h.npz": r"column episode holds float64 of shape \(\)", "i.npz": "column x holds datetime64",
        "j.npz": "it takes 1.2 GB, and 1 are read", "b.csv": "its rows have more values than its header names",
        "c.csv": "column x holds bool", "d.csv": "its first line is longer than",
        "folder": "no folder of a LeRobotDataset", "broken": "no folder of a LeRobotDataset", "none": "no such file",
    }.items():  # fmt: skip
        with pytest.raises(PoseFileError, match=message):
            read_poses(tmp_path / name, PoseColumns(), None)


def test_a_region_is_least_and_greatest():
    with pytest.raises(SettingError, match=r"base.x=\[0.3, -0.3\] is not allowed. Allowed: \[least,greatest\]"):
        BaseConfig(x=[0.3, -0.3])
    with pytest.raises(SettingError, match="gives up to 20000 candidates; these are 40401"):
        BaseConfig(x=[-1, 1], y=[-1, 1], spacing=0.01)
