"""Who plays episodes, a policy on an arm or a scripted oracle, and how several play side by side."""

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import as_completed
from typing import TYPE_CHECKING, Protocol

from richmap.worker import worker_pool

if TYPE_CHECKING:
    from benchmark.episodes.episode import Condition, Episode
    from envs.task import Task


class Player(Protocol):
    """Plays episodes of a task on an arm: `benchmark.rollouts.rollout.Rollout` or `arm_oracle.ArmOracle`."""

    @property
    def task(self) -> "Task":
        """What is played."""

    @property
    def condition(self) -> "Condition":
        """What its episodes are run with."""

    @property
    def kind(self) -> str | None:
        """Of the field that guidance looks at (`policies.method.Method.field`); None without one."""

    def batches(self, seeds: Iterable[int]) -> Iterable[Sequence[int]]:
        """The seeds, grouped as they are played together."""

    def play(self, seeds: Sequence[int]) -> "list[Episode]":
        """The episodes of one group."""


def play_all(jobs: "Iterable[tuple[Player, Iterable[int]]]", workers: int) -> "Iterator[list[Episode]]":
    """Play episodes with some seeds of one player after another, group by group in worker processes; one worker is this
    process. Gives each group as it is finished."""
    groups = [(player, group) for player, seeds in jobs for group in player.batches(seeds)]
    if min(workers, len(groups)) <= 1:
        yield from (player.play(group) for player, group in groups)
        return
    with worker_pool(min(workers, len(groups))) as pool:
        left = {pool.submit(player.play, group) for player, group in groups}
        for played in as_completed([*left]):
            left.remove(played)
            if error := played.exception():
                yield from [each.result() for each in left if each.done() and not each.exception()]
                raise error
            yield played.result()
