"""Demonstrations: what is in them, and that collecting can be killed and repeated."""

import json
from dataclasses import replace

import numpy as np
import pytest
from lerobot.datasets import LeRobotDataset

from benchmark.artifacts.alone import alone
from benchmark.settings.setting import SettingError
from benchmark.training.collection import collect
from benchmark.training.demonstration import Demonstration, demonstrate, pack, source_env, unpack
from benchmark.training.demonstration_recipe import CollectConfig
from envs.block_push.demonstrator import around_blocks
from envs.block_push.oracle import Oracle
from envs.block_push.scene import START, Scene

pytestmark = pytest.mark.system

SHOWN = CollectConfig().demonstrator
KINDS = ("clean", *dict(SHOWN.kinds))


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demonstrations") / "few"
    return CollectConfig(
        episodes=2,
        shares=["noise:0.5", "bursts:0", "wide:0.5", "crowded:0"],
        workers=1,
        output_dir=str(folder),
    )


@pytest.fixture(scope="module")
def root(config):
    return collect(config)


def test_a_dataset_holds_one_successful_episode_of_each_seed(root):
    dataset = LeRobotDataset(f"local/{root.name}", root=root, video_backend="pyav")
    columns = dataset.hf_dataset.with_format("numpy")[:]
    assert dataset.fps == 10
    assert list(dict.fromkeys(columns["seed"])) == [0, 1]
    assert columns["next.done"].sum() == columns["next.success"].sum() == 2
    assert (columns["next.done"] == columns["next.success"]).all()
    assert set(columns["kind"]) <= {"noise", "wide"}


def test_collecting_again_changes_nothing(root, config):
    before = (root / "meta" / "info.json").stat().st_mtime_ns
    assert collect(config) == root
    assert (root / "meta" / "info.json").stat().st_mtime_ns == before


def test_statistics_are_in_the_same_order_in_every_process(root):
    text = (root / "meta" / "stats.json").read_text()
    assert text == json.dumps(json.loads(text), indent=4, sort_keys=True)


def test_two_processes_do_not_collect_into_one_folder(tmp_path):
    config = CollectConfig(episodes=1, output_dir=str(tmp_path / "few"))
    with alone(tmp_path / "few"), pytest.raises(SettingError, match="Another process makes .*few"):
        collect(config)
    assert not list(tmp_path.iterdir())


def test_the_usual_folder_is_judged_when_it_is_used(tmp_path, monkeypatch):
    """Importing and training on other data need nothing of it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("benchmark.settings.paths.os.access", lambda *_: False)
    config = CollectConfig()
    with pytest.raises(SettingError, match="Choose another: output_dir="):
        collect(config)


def test_what_is_there_need_not_be_writable(root, config, monkeypatch):
    monkeypatch.setattr("benchmark.settings.paths.os.access", lambda *_: False)
    assert collect(replace(config)) == root


def test_other_settings_need_another_folder(root, config):
    with pytest.raises(SettingError, match="made otherwise.*Delete the folder or choose another output_dir"):
        collect(CollectConfig(episodes=3, output_dir=config.output_dir))


def test_the_recipe_is_stored_with_the_data(root, config):
    about = json.loads((root / "meta" / "collect.json").read_text())
    assert about["recipe"] == config.recipe
    assert sum(count["kept"] for count in about["played"].values()) == 2


@pytest.mark.parametrize("kind", KINDS)
def test_a_demonstration_depends_on_its_seed_alone(kind):
    env = source_env(SHOWN.environment)
    once, again = demonstrate(SHOWN, env, 3, kind), demonstrate(SHOWN, env, 3, kind)
    assert np.array_equal(once.observations, again.observations)
    assert np.array_equal(once.actions, again.actions)
    assert once.successes[-1] and not once.successes[:-1].any()


def test_without_bursts_only_noise_is_left():
    env = source_env(SHOWN.environment)
    driven = demonstrate(SHOWN, env, 3, "bursts", burst_probability=0.0)
    wrong = np.diff(driven.observations[:, 8:10], axis=0) - driven.actions[:-1]
    assert 0.1 < (np.abs(wrong).max(axis=1) > 1e-5).mean() < 0.3


def test_the_demonstrator_walks_around_blocks_and_in_clean_episodes_straight_on():
    start, far = np.array(START), np.array([0.52, 0.2, 0.0])
    scene = Scene(np.array([0.29, -0.1, 0.0]), np.array([0.29, 0.05, 0.0]), np.array([0.28, 0.2, 0.0]), far, 3, start)
    behind = {"scene": replace(scene, effector=np.array([0.29, 0.12]))}

    def dragged(detours):
        observation, _ = source_env(SHOWN.environment).reset(seed=0, options=behind)
        oracle = Oracle(3)
        oracle(observation)
        oracle.phase, oracle._origin = "origin", start
        for _ in range(20):
            label = oracle(observation)
            step = around_blocks(oracle, label, observation) if detours else label
            observation, *_ = source_env(SHOWN.environment).step(step.astype(np.float32))
        return np.linalg.norm(observation[:2] - scene.block[:2]) + np.linalg.norm(observation[3:5] - scene.block2[:2])

    assert dragged(detours=False) > 0.05
    assert dragged(detours=True) < 0.005


def test_the_demonstrator_walks_around_the_block_that_it_is_about_to_push():
    """From in front of it to behind it: the oracle's straight way would push it backwards."""
    block, target = np.array([0.4, -0.1, 0.0]), np.array([0.4, 0.2, 0.0])
    aside, far = np.array([0.55, -0.3, 0.0]), np.array([0.52, 0.2, 0.0])
    observation, _ = source_env(SHOWN.environment).reset(
        seed=0, options={"scene": Scene(block, aside, target, far, 0, np.array([0.4, 0.0]))}
    )
    oracle = Oracle(0)
    for _ in range(30):
        label = around_blocks(oracle, oracle(observation), observation)
        if oracle.phase != "pre_block":
            break
        observation, *_ = source_env(SHOWN.environment).step(label.astype(np.float32))
    assert oracle.phase == "block"
    assert np.linalg.norm(observation[:2] - block[:2]) < 0.002


def test_packing_keeps_every_episode():
    rng = np.random.default_rng(0)
    episodes = [
        Demonstration(
            seed,
            "noise",
            2,
            rng.random((n, 16), dtype=np.float32),
            rng.random((n, 2), dtype=np.float32),
            rng.random(n, dtype=np.float32),
            rng.random(n) < 0.5,
        )
        for seed, n in ((5, 3), (6, 1), (7, 4))
    ]
    for before, after in zip(episodes, unpack(pack(episodes)), strict=True):
        assert (before.seed, before.kind, before.attempts) == (after.seed, after.kind, after.attempts)
        for name in ("observations", "actions", "rewards", "successes"):
            assert np.array_equal(getattr(before, name), getattr(after, name))


@pytest.mark.parametrize(
    "fields", [{"shares": ["noise:1.2"]}, {"shares": ["shown:0.1"]}, {"shares": ["noise"]}, {"episodes": 0}]
)
def test_impossible_settings_are_refused(fields):
    with pytest.raises(ValueError, match="is not allowed. Allowed"):
        CollectConfig(**fields)


def test_demonstrations_of_other_code_are_refused(root, config):
    file = root / "meta" / "collect.json"
    about = json.loads(file.read_text())
    file.write_text(json.dumps({**about, "episode_version": 0}))
    try:
        with pytest.raises(SettingError, match="made otherwise .*'episode_version': 0"):
            collect(config)
    finally:
        file.write_text(json.dumps(about))
