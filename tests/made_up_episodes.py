"""Episodes that nobody rolled out, for tests of what is done with their rows."""

import dataclasses

from benchmark.episodes.episode import Condition, Episode
from envs.block_push.outcome import EpisodeOutcome
from envs.block_push.scene import draw_scene
from envs.block_push.task import BLOCK_PUSH

CONDITION = Condition(
    task="block_push", robot="ur3", setting="embodied", robot_fingerprint="f00d", base_x=0.0, base_y=0.0, base_z=0.0,
    base_yaw=0.0, posture=(-0.2, -1.2, 1.8, -2.2, -1.57, 0.4), self_collision=True, joint_limits=True,
    orientation_weight=1.0, narrowed=(), tool_length=0.04, delay=0.0, obstacles=0, method="direct",
    guidance_scale=0.0, sampler="DDIM", sampling_steps=10, training_seed=42,
    checkpoint="seed42-1", checkpoint_hash="abc", field_fingerprint="", cell_size=float("nan"), batch_size=10,
    device="cpu", commit="c1c1c1c", episode_version=BLOCK_PUSH.episode_version("embodied"),
)  # fmt: skip


def episode(seed, p1=True, p2=True, condition=CONDITION):
    length = 3 if p2 else 350
    nothing = {float: 0.0, int: 0, str: "free"}
    values = {f.name: nothing.get(f.type) for f in dataclasses.fields(EpisodeOutcome)} | dict(
        score=0.49 * p1 + 0.51 * p2, p1=p1, p2=p2, success_at_end=p2, length=length, mode=draw_scene(seed).mode,
        failure_cause=None if p2 else "outer_reach", first_block=0 if p1 else None,
        first_target="near" if p1 else None, first_entry_s=0.2 if p1 else None,
    )  # fmt: skip
    return Episode(condition, seed, seed % 10, EpisodeOutcome(**values))
