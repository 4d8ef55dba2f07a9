import numpy as np
import pytest

from benchmark.map_quality import labels, poses
from benchmark.map_quality.label_errors import label_errors
from benchmark.map_quality.labels import CHUNK, TEST_SETS, LabelledPoses, label, labelled, make_test_set
from richmap import cache
from richmap.motion import inverse_kinematics
from richmap.motion.reach import reach_ball
from richmap.outputs import FileRefusedError
from richmap.robots.robots import load_robot

pytestmark = pytest.mark.system


@pytest.fixture
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setattr(cache.platformdirs, "user_cache_dir", lambda _: str(tmp_path))
    monkeypatch.setattr(labels, "CHUNK", 60)
    return tmp_path


def test_the_papers_set_is_half_reachable_and_the_rest_is_not():
    robot = load_robot("panda")
    made = make_test_set(robot, TEST_SETS["paper"], np.random.default_rng(0), 200)
    assert len(made) == 200 and made.strict.sum() == 100
    counts = dict(zip(poses.DRAWS, np.bincount(made.kind, minlength=len(poses.DRAWS)), strict=True))
    assert counts == {"reachable": 100, "outside": 20, "below ground": 20, "perturbed": 60, "uniform": 0}
    assert (made.strict == (made.kind == 0)).all()
    assert made.drawn["below ground"] > 20 and made.drawn["perturbed"] > 60 and made.drawn["reachable"] == 100
    shoulder, radius = reach_ball(robot)
    distance = np.linalg.norm(made.positions - shoulder, axis=1)
    assert (distance[made.kind == 1] > radius).all() and (distance[made.kind != 1] < radius + 1e-3).all()
    assert (made.positions[made.kind == 2][:, 2] < 0).all() and (made.positions[made.kind == 3][:, 2] >= 0).all()
    assert (poses.paper_box(robot).cells_of(made.positions) == 0).all()


def test_poses_of_free_configurations_are_labelled_reachable():
    robot = load_robot("ur3")
    positions, rotations = poses.draw("reachable", robot, np.random.default_rng(1), 150)
    assert np.all(label(robot, positions, rotations, starts=100))


def test_a_strict_label_holds_in_every_looser_sense():
    robot = load_robot("panda")
    positions, rotations = poses.draw("uniform", robot, np.random.default_rng(2), 150)
    strict, loose, wrist_free = label(robot, positions, rotations, starts=20)
    assert 0 < strict.sum() < strict.size
    assert (loose >= strict).all() and (wrist_free >= strict).all() and loose.sum() > strict.sum()


@pytest.mark.parametrize("name", ["panda", "ur5e"])
def test_labels_are_those_of_a_search_for_each_sense_alone(name):
    robot = load_robot(name)
    positions, rotations = poses.draw("uniform", robot, np.random.default_rng(5), 300)
    starts = inverse_kinematics.starting_configurations(robot, 20, seed=0)
    strict, loose, wrist_free = label(robot, positions, rotations, starts=20)
    assert (strict == inverse_kinematics.solve(robot, starts, positions, rotations)[1]).all()
    assert (loose == inverse_kinematics.solve(robot, starts, positions, rotations, loose=labels.LOOSE)[1]).all()
    assert (wrist_free >= inverse_kinematics.solve(robot, starts, positions, rotations, free_roll=True)[1]).all()


def test_labels_are_kept_chunk_by_chunk(own_cache, monkeypatch):
    robot = load_robot("panda")
    seen = []
    some = labelled(robot, "hard", "test", 100, report=seen.append)
    assert len(some) == 100 and seen == [60, 100]
    monkeypatch.setattr(labels, "make_test_set", lambda *_: pytest.fail("A chunk is made again."))
    again = labelled(robot, "hard", "test", 70)
    assert (again.positions == some.positions[:70]).all() and (again.strict == some.strict[:70]).all()


def test_a_chunk_that_was_cut_short_is_made_again(own_cache):
    robot = load_robot("panda")
    before = labelled(robot, "hard", "test", 60)
    (file,) = own_cache.rglob("00000.safetensors")
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(FileRefusedError, match="cut short"):
        LabelledPoses.load(file)
    after = labelled(robot, "hard", "test", 60)
    assert (before.positions == after.positions).all() and (before.loose == after.loose).all()


def test_splits_and_chunks_hold_different_poses(own_cache):
    robot = load_robot("panda")
    test, validation = (labelled(robot, "hard", split, 120) for split in ("test", "validation"))
    every = np.concatenate([test.positions, validation.positions])
    assert len(np.unique(every, axis=0)) == 240


def test_unknown_sets_are_refused_by_name():
    with pytest.raises(ValueError, match="There is no test set easy/test. Sets: paper, hard"):
        labelled(load_robot("panda"), "easy", "test", CHUNK)


def test_an_error_is_a_pose_that_more_starts_reach():
    robot = load_robot("panda")
    made = make_test_set(robot, {"uniform": 1.0}, np.random.default_rng(4), 60)
    blind = LabelledPoses(made.positions, made.quaternions, *np.zeros((3, 60), dtype=bool), made.kind, made.drawn)
    errors = label_errors(robot, blind, 60, np.random.default_rng(0))
    assert errors["missed_strict"] == pytest.approx(made.strict.mean(), abs=1 / 60)
    assert errors["only_other_roll"] == 0
