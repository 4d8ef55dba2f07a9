"""The scripted oracles as players on an arm: which arm, which oracle, and what comes out, seed by seed."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import batched
from typing import TYPE_CHECKING, Any

from benchmark.settings.config import ORACLE_METHODS
from benchmark.settings.robot_config import SOURCE

if TYPE_CHECKING:
    import gymnasium
    import numpy as np
    from rich.console import Console

    from benchmark.episodes.episode import Condition, Episode
    from envs.arm.placed_arm import PlacedArm
    from envs.task import Controller, Task


TOGETHER = 25
"""Episodes that are played and stored together."""


@dataclass(frozen=True)
class ArmOracle:
    """One of a task's oracles, on an arm."""

    task: "Task"
    arm: "PlacedArm"
    oracle: str
    """`plain` or `aware`."""

    @property
    def kind(self) -> None:
        """It looks at no field."""

    @cached_property
    def condition(self) -> "Condition":
        """What its episodes are run with, in the columns of the episodes table: without a policy."""
        import math

        from benchmark.artifacts.commit import commit
        from benchmark.episodes.arm import arm_columns
        from benchmark.episodes.episode import Condition

        return Condition(
            task=self.task.name,
            **arm_columns(self.arm),
            method=ORACLE_METHODS[self.oracle],
            guidance_scale=0.0,
            sampler="none",
            sampling_steps=0,
            training_seed=-1,
            checkpoint="",
            checkpoint_hash="",
            field_fingerprint="",
            cell_size=math.nan,
            batch_size=1,
            device="cpu",
            commit=commit(),
            episode_version=self.task.episode_version(self.arm.setting),
        )

    def batches(self, seeds: Iterable[int]) -> Iterable[Sequence[int]]:
        """A few seeds each, whose episodes are stored together."""
        return batched(seeds, TOGETHER)

    def play(self, seeds: Sequence[int]) -> "list[Episode]":
        """The episodes, one after another."""
        from benchmark.episodes.episode import Episode
        from envs.task import play_oracle

        env, make = _environment(self.task, self.arm), _prepared(self)
        outcomes = [self.task.summarize(play_oracle(env, seed, make)) for seed in seeds]
        return [Episode(self.condition, seed, 0, outcome) for seed, outcome in zip(seeds, outcomes, strict=True)]


@lru_cache(maxsize=2)
def _prepared(player: ArmOracle) -> "Callable[[dict[str, Any]], Controller]":
    """The oracle on its arm; once per worker process, since it may take seconds."""
    return player.task.oracle(player.oracle)(player.arm)


@lru_cache(maxsize=2)
def _environment(task: "Task", arm: "PlacedArm") -> "gymnasium.Env":
    """One environment per worker process, kept from episode to episode."""
    return task.make(arm)


def demonstrated_path(task: "Task", episodes: int, console: "Console") -> "np.ndarray":
    """Flange positions, (n, 3), in [m], of the source's plain oracle in the scenes of the first seeds."""
    import numpy as np

    return np.concatenate(demonstrated_paths(task, episodes, console))


def demonstrated_paths(task: "Task", episodes: int, console: "Console") -> "list[np.ndarray]":
    """The same of each episode."""
    import numpy as np

    from envs.arm.place_arm import place_arm
    from envs.task import play_oracle
    from richmap.progress import progress_bar

    arm = place_arm(SOURCE, task.poses)
    env, make = task.make(arm), task.oracle("plain")(arm)
    with progress_bar(console) as progress:
        seeds = progress.track(range(episodes), description="Demonstrations")
        paths = [np.array([info["flange"] for info in play_oracle(env, seed, make)]) for seed in seeds]
    env.close()
    return paths
