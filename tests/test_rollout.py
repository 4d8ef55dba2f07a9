import dataclasses

import numpy as np
import pytest
import torch
from rich.console import Console

from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.episodes.arm import branch_of
from benchmark.rollouts.guidance_class import GuidanceClass
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.rollouts.rollout import load_policy
from benchmark.settings.config import RunConfig
from benchmark.settings.robot_config import ArmConfig, RobotConfig
from benchmark.settings.setting import SettingError
from richmap.geometry.grid import Grid
from richmap.similarity.energy import EnergyField

pytestmark = pytest.mark.system

CONFIG = RunConfig(robot=RobotConfig("xarm6"), batch_size=3, device="cpu")


@pytest.fixture(scope="module")
def rollout():
    return make_rollout(CONFIG, 0.0, checkpoint_folder(42), Console(quiet=True))


@pytest.fixture(scope="module")
def episodes(rollout):
    return rollout.play([50_001, 50_002])


def test_an_episode_replays_alone_to_the_last_bit(rollout, episodes):
    alone = rollout.play([50_002])
    assert alone == [episodes[1]]


def test_an_episode_keeps_its_row(episodes):
    assert {episode.episode_seed: episode.slot for episode in episodes} == {50_001: 0, 50_002: 1}


def test_a_row_holds_what_the_episode_was_run_with_and_what_happened(episodes):
    row = episodes[0].row()
    for column in ("robot", "setting", "method", "lambda", "checkpoint", "checkpoint_hash", "episode_seed", "score"):
        assert column in row
    assert (
        row["lambda"] == 0 and row["method"] == "direct" and len(row.pop("posture")) == 6 and row.pop("narrowed") == ()
    )
    assert all(np.isscalar(value) or value is None for value in row.values())


GUIDANCE = """
from policies.guidance import Guidance

class Still(Guidance):
    def __init__(self, field, scale, base, seed):
        self.scale = scale

    def correct(self, chunk, effector):
        return self.scale * chunk

class NoGuidance:
    pass
"""


def test_a_strangers_guidance_acts(rollout, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(GUIDANCE)
    condition = dataclasses.replace(rollout.condition, method="mine", guidance_scale=0.0)
    still = dataclasses.replace(rollout, condition=condition, guidance=GuidanceClass(file, "Still"))
    (episode,) = still.play([50_001])
    assert episode.outcome.failure_cause == "dithering" and not episode.outcome.p1
    with pytest.raises(ValueError, match="no class NoGuidance that is a policies.guidance.Guidance"):
        GuidanceClass(file, "NoGuidance").make(1.0, None, (0.0, 0.0), 0)


def test_the_policy_solves_its_own_arm(episodes):
    assert all(episode.outcome.p2 for episode in episodes)


def test_a_policy_is_found_by_its_recipe_seed_and_rank():
    assert checkpoint_folder(43).name == "seed43-1"
    assert checkpoint_folder(43, 1, "clean").name == "clean-seed43-1"
    with pytest.raises(SettingError, match="recipe=dirty is not allowed. Allowed: robust, clean"):
        dataclasses.replace(CONFIG, recipe="dirty")


def test_an_unknown_training_seed_is_refused():
    with pytest.raises(ValueError, match="seed=7 checkpoint=1 is not there. Here: .*seed42-1"):
        checkpoint_folder(7)
    with pytest.raises(ValueError, match=r"published, but .*: python -m benchmark.source_policies .*seeds=\[42\]"):
        checkpoint_folder(42, 3)


def test_other_settings_make_another_condition(rollout):
    original = make_rollout(dataclasses.replace(CONFIG, setting="original"), 0.0, checkpoint_folder(42), Console())
    assert original.condition.setting == "original" and not original.condition.self_collision
    assert original.condition != rollout.condition


def test_single_choices_of_the_arm_reach_the_environment_and_the_row():
    config = dataclasses.replace(
        CONFIG, robot=RobotConfig("ur3"), arm=ArmConfig(base=[0.06, 0.0, 0.0], self_collision=False)
    )
    rollout = make_rollout(config, 0.0, checkpoint_folder(42), Console())
    bases = set()
    (episode,) = rollout.play([50_000], watch=lambda env: bases.add(env.unwrapped.arm.base))
    assert bases == {(0.06, 0.0, 0.0)}
    row = episode.row()
    assert row["base_x"] == 0.06 and not row["self_collision"] and branch_of(row) == "wrist_out"


def test_what_was_asked_of_guidance_reaches_the_policy():
    """Lambda and base: a constant push to the base, 3-4-5."""
    config = dataclasses.replace(
        CONFIG, robot=RobotConfig("ur3"), method="towards", arm=ArmConfig(base=[0.06, 0.0, 0.0])
    )
    policy = load_policy(make_rollout(config, 0.04, checkpoint_folder(42), Console()))
    effector = torch.tensor([[0.36, 0.4, 0.0, 0.0]])
    np.testing.assert_allclose(policy.guidance.push(effector), [[0.024, 0.032]], rtol=1e-5)
    unguided = load_policy(make_rollout(config, 0.0, checkpoint_folder(42), Console()))
    assert unguided.guidance.push(effector) is None


def test_the_slope_of_the_field_is_added_lambda_times(tmp_path):
    """The paper's equation 14, from the row of the table to the noise, with E = 3 x - 2 y."""
    grid = Grid((-1.0, -1.0, -0.8), 0.2, (10, 10, 10))
    x, y, _ = np.moveaxis(grid.centres().reshape(*grid.shape, 3), -1, 0)
    about = {"source": "xarm6", "target": "ur3", "fingerprint": "f" * 64}
    EnergyField(grid, 3 * x - 2 * y, about).save(tmp_path / "field.safetensors")
    direct = make_rollout(dataclasses.replace(CONFIG, robot=RobotConfig("ur3")), 0.0, checkpoint_folder(42), Console())
    of_paper = dataclasses.replace(direct.condition, method="paper", guidance_scale=0.5)
    policy = load_policy(dataclasses.replace(direct, condition=of_paper, field=tmp_path / "field.safetensors"))
    push = policy.guidance.push(torch.tensor([[0.36, 0.1, 0.0, 0.0]]))
    np.testing.assert_allclose(push, [[1.5, -1.0]], rtol=1e-4)


def test_an_impossible_arm_is_refused():
    config = dataclasses.replace(CONFIG, robot=RobotConfig("ur3"), arm=ArmConfig(base=[-0.9, 0.0, 0.0]))
    with pytest.raises(ValueError, match="hold the tool"):
        make_rollout(config, 0.0, checkpoint_folder(42), Console()).play([50_000])
