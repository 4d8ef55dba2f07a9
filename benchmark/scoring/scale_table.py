"""The table of scales: what each scale of each method of guidance comes to, and which is chosen."""

from typing import TYPE_CHECKING

from benchmark.episodes.arm import ARM

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd

    from envs.task import Task

CHOSEN_FOR = [*ARM, "sampler", "sampling_steps"]
"""Columns of the episodes table that a scale is chosen for."""

METHOD = ["method", "cell_size", "field_fingerprint", "entry_hash"]
"""And these: slopes of two fields are of two sizes, so that a scale holds for one of them; a class of a file is another
method when its files have changed."""


def scale_table(episodes: "pd.DataFrame", task: "Task", names: "Sequence[str]" = ()) -> "pd.DataFrame":
    """A row per arm, method, field, version of a class and scale, over all checkpoints: n, these scores or the task's
    `headline`, and differences to direct transfer.

    Differences are paired: same checkpoint, same episode. `chosen` is the scale that ranks first, of equal ones the
    smallest; of those that were rolled out whole, on every episode of direct transfer's. Intervals are for other
    trainings and other episodes.
    """
    import pandas as pd

    from benchmark.scoring.statistics import Crossed, clustered_difference, clustered_mean

    rows = []
    for arm, group in episodes.groupby(CHOSEN_FOR, sort=True):
        direct = group[group.method == "direct"]
        for key, point in group.groupby([*METHOD, "lambda"], sort=False, dropna=False):
            pairs = point.merge(direct, on=["checkpoint_hash", "episode_seed"], suffixes=("", "_direct"))
            row = dict(zip([*CHOSEN_FOR, *METHOD, "lambda"], (*arm, *key), strict=True))
            row |= {
                "n": len(point),
                "checkpoints": point.checkpoint_hash.nunique(),
                "whole": 0 < len(pairs) == len(direct),
            }
            for name in names or task.headline:
                less = pairs[name].astype(float) - pairs[f"{name}_direct"].astype(float)
                rate, difference = (
                    clustered_mean(Crossed.of(point, point[name])),
                    clustered_difference(Crossed.of(pairs, less)),
                )
                row |= dict(zip((name, f"{name}_low", f"{name}_high"), rate, strict=True))
                of_difference = (f"{name}_difference", f"{name}_difference_low", f"{name}_difference_high")
                row |= dict(zip(of_difference, difference, strict=True))
            rows.append(row)
    table = pd.DataFrame(rows).sort_values([*CHOSEN_FOR, *METHOD, "lambda"], ignore_index=True)
    in_order = table[table.whole].sort_values([task.ranking[0], "lambda"], ascending=[False, True])
    best = in_order.groupby([*CHOSEN_FOR, *METHOD], dropna=False).head(1)
    return table.assign(chosen=table.index.isin(best.index))
