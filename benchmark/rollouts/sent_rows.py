"""Sent rows."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

    from benchmark.episodes.episode import Episode
    from benchmark.rollouts.rollout import Rollout


def refusals(table: "pd.DataFrame", rollouts: "Sequence[Rollout]", seeds: range) -> Iterator[str]:
    """Why rows are not those of the rollouts on these episode seeds, row by row."""
    from benchmark.episodes.episode import row_name

    found: Counter[tuple[int, int]] = Counter()
    for number, row in enumerate(table.to_dict("records")):
        which, differing = nearest(row, rollouts)
        seed = row["episode_seed"]
        name = f"row {number} ({row_name(row)})"
        if differing:
            said = ", ".join(f"{column} is {stored}, not {ours}" for column, (stored, ours) in differing.items())
            yield f"{name}: {said}."
        elif seed not in seeds:
            yield f"{name}: its seed is none of the protocol's, {seeds[0]} to {seeds[-1]}."
        elif found[which, seed]:
            yield f"{name} is there already."
        else:
            found[which, seed] += 1
    for which, rollout in enumerate(rollouts):
        for seed in seeds:
            if not found[which, seed]:
                yield f"{row_name(rollout.condition.row() | {'episode_seed': seed})} is missing."


def nearest(row: Mapping[str, Any], rollouts: "Sequence[Rollout]") -> tuple[int, dict[str, tuple[Any, Any]]]:
    """Which rollout a row differs least from, and the columns in which it does: the row's value and the rollout's."""
    from benchmark.episodes.episode import plain

    differing = []
    for rollout in rollouts:
        pairs = {name: (plain(row.get(name)), plain(value)) for name, value in rollout.condition.row().items()}
        differing.append({name: pair for name, pair in pairs.items() if name != "commit" and pair[0] != pair[1]})
    which = min(range(len(rollouts)), key=lambda i: len(differing[i]))
    return which, differing[which]


def otherwise(rows: "pd.DataFrame", episodes: "Iterable[Episode]") -> Iterator[str]:
    """In which columns rows differ from their episodes, rolled out again."""
    from benchmark.episodes.episode import differences, row_id, row_name
    from richmap.progress import progress_bar

    stored = {row_id(row): row for row in rows.to_dict("records")}
    with progress_bar() as progress:
        for episode in progress.track(episodes, total=len(rows), description="Replays"):
            row = stored[row_id(episode.row())]
            differing = differences(row, episode)
            if differing:
                said = ", ".join(f"{name} is {sent}, not {replayed}" for name, (sent, replayed) in differing.items())
                yield f"{row_name(row)}, replayed: {said}."
