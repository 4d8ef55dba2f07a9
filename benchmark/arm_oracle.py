"""The scripted oracles as players on an arm: which arm, which oracle, and what comes out, seed by seed."""

from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TYPE_CHECKING

from benchmark.config import ORACLE_METHODS

if TYPE_CHECKING:
    from benchmark.results import Condition
    from envs.arms import ArmSetting
    from envs.feasibility import TableFeasibility
    from envs.outcome import EpisodeOutcome


@dataclass(frozen=True)
class ArmOracle:
    """One of the oracles, on an arm."""

    arm: "ArmSetting"
    oracle: str
    """`plain` or `aware`."""

    @property
    def condition(self) -> "Condition":
        """What its episodes are run with, in the columns of the episodes table: without a policy."""
        import math

        from benchmark.arithmetic import arithmetic
        from benchmark.arm import arm_columns
        from benchmark.code_version import code_version, commit
        from benchmark.results import Condition

        return Condition(
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
            batch_shape=1,
            device="cpu",
            code_version=code_version(),
            commit=commit(),
            arithmetic=arithmetic(),
        )


def play_chunk(chunk: tuple[ArmOracle, tuple[int, ...]]) -> "list[EpisodeOutcome]":
    """Outcomes of an oracle's episodes on an arm with these seeds."""
    from envs.aware_oracle import AwareOracle
    from envs.oracle import Oracle, run_oracle
    from envs.outcome import summarize

    player, seeds = chunk
    make_oracle = Oracle if player.oracle == "plain" else partial(AwareOracle, _table(player.arm))
    return [summarize(run_oracle(_environment(player.arm), seed, make_oracle)) for seed in seeds]


@lru_cache(maxsize=2)
def _table(arm: "ArmSetting") -> "TableFeasibility":
    """Where the arm can hold its tool; once per worker process, since it takes seconds."""
    from envs.feasibility import table_feasibility

    return table_feasibility(arm, spacing=0.01)


@lru_cache(maxsize=2)
def _environment(arm: "ArmSetting"):
    """One environment per worker process, kept from episode to episode."""
    import gymnasium

    import envs

    return gymnasium.make(
        envs.ENVIRONMENTS[arm.robot],
        setting=arm.name,
        base=arm.base,
        wrist=arm.wrist,
        self_collision=arm.self_collision,
        orientation_weight=arm.orientation_weight,
    )
