"""Methods ranked on each arm: a pure function of the episodes tables, by two protocols."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import or_
from typing import TYPE_CHECKING

import numpy as np

from benchmark.episodes.arm import ARM, changes, usual_rows
from benchmark.settings import scenes
from benchmark.settings.config import RunConfig
from benchmark.settings.robot_config import in_tables
from benchmark.settings.setting import SettingError

if TYPE_CHECKING:
    import pandas as pd

    from benchmark.scoring.statistics import Crossed
    from envs.task import Task


@dataclass(frozen=True)
class Protocol:
    """Which test episodes count, and by which scores."""

    name: str
    settings: tuple[str, ...]
    scenes: range
    """Seeds of the scenes, the same for each policy."""
    batch_size: int
    """Rows of the batches in which policies are evaluated: other batches round otherwise."""
    policies: int
    """Of ours; an entry may have one of its own."""
    scores: tuple[str, ...]
    """The first one ranks; () for the task's own (`envs.task.Task.ranking`)."""
    best_only: bool
    """Whether of our own policies only the best checkpoint of each training seed counts."""
    task: str = ""
    """The only one that it is for; empty for all."""

    @property
    def episodes(self) -> int:
        """Of each policy."""
        return len(self.scenes)


PAPER = Protocol("paper", ("original",), scenes.PAPER, 10, 9, ("score", "p2"), best_only=False, task="block_push")
STRICT = Protocol("strict", ("embodied", "best"), scenes.TABLES, 50, 3, (), best_only=True)
PROTOCOLS = (PAPER, STRICT)


def protocols_of(task: "Task") -> tuple[Protocol, ...]:
    """The protocols of a task, with its scores."""
    return tuple(
        replace(protocol, scores=protocol.scores or task.ranking)
        for protocol in PROTOCOLS
        if protocol.task in ("", task.name)
    )


SAMPLING = ["sampler", "sampling_steps", "batch_size", "device"]
GUIDANCE = ["method", "lambda", "field_fingerprint", "cell_size", "entry_hash"]
"""Columns of the episodes table that rows must share, with those of their arm and their episode version, to be counted
together, whatever their policy."""


def counted(episodes: "pd.DataFrame", protocol: Protocol, ours: set[str]) -> "pd.DataFrame":
    """The rows that a protocol counts: of its settings, episodes and batches, of our policies (hashes of their weights)
    or of an entry. Other people's policies count as entries."""
    if episodes.empty:
        return episodes
    counts = episodes.setting.isin(protocol.settings) & episodes.episode_seed.isin(protocol.scenes)
    counts &= episodes.batch_size == protocol.batch_size
    of_ours = episodes.checkpoint_hash.isin(ours)
    if protocol.best_only:
        of_ours &= ~episodes.checkpoint.str.fullmatch(r"(\w+-)?seed\d+-([2-9]|\d\d+)")
    return episodes[counts & (of_ours | (episodes.entry_hash != ""))]


def leaderboard(
    episodes: "pd.DataFrame", protocol: Protocol, task: "Task", track: Callable[[Sequence], Iterable] = iter
) -> "pd.DataFrame":
    """One row per arm and method, over all policies: scores, differences to direct transfer, what changed, causes.

    Rows that lack episodes or policies, or some of those of direct transfer that they are compared with, come last on
    their arm: what is missing may be what failed. So do those of an entry that has some of our policies and others.

    For each score and each of the task's traits there is its mean (the column of its name), `_low` and `_high`, its
    difference to direct transfer on the same episodes of the same policies (of ours, where an entry has its own),
    `_difference`, `_difference_low` and `_high`; for scores also the least and most of any policy, `_least` and
    `_most`, the difference's `_p` (`statistics.sign_flip_p_value`), and `_holm`, the same `adjusted`. Likewise, for
    direct transfer on an arm that stands or holds its tool otherwise than in the setting `embodied`, that to direct
    transfer there, `_arm_difference` and `_arm_p`. NaN where there is nothing to compare with. `policies` has the
    figures of each.

    Args:
        episodes: The rows that count.
        protocol: Says by which scores.
        task: What they are of.
        track: Goes through the rows that are made, such as a progress bar.

    Raises:
        SettingError: If two policies go by one name.
    """
    import pandas as pd

    rows, ours = [], episodes.checkpoint_hash[episodes.entry_hash == ""].unique()
    traits = {trait.name: trait.of(episodes) for trait in task.traits if trait.of}
    episodes = episodes.assign(**traits, training=_training(episodes))
    groups = [
        (on_arm, group)
        for _, on_arm in episodes.groupby([*ARM, "episode_version"])
        for _, group in on_arm.groupby([*GUIDANCE, *SAMPLING], dropna=False)
    ]
    for on_arm, group in track(groups):
        foreign = bool(group.entry_hash.iloc[0]) and not group.checkpoint_hash.isin(ours).any()
        direct = _direct(on_arm, group, foreign)
        mixed = not foreign and not group.checkpoint_hash.isin(ours).all()
        row = _row(group, direct, protocol, task, foreign) | _to_usual_arm(episodes, group, protocol)
        rows.append(row | {"complete": row["complete"] and not mixed})
    table = pd.DataFrame(rows)
    for score in protocol.scores:
        table[f"{score}_holm"] = adjusted(table, f"{score}_p")
    rank = [protocol.settings.index(x) for x in table.setting], [*map(in_tables, table.robot)]
    order = np.lexsort([table["lambda"], -table[protocol.scores[0]], ~table.complete, *rank[::-1]])
    return table.iloc[order].reset_index(drop=True)


def adjusted(table: "pd.DataFrame", name: str) -> "pd.Series":
    """P-values of a column adjusted after Holm for all robots, methods and scales of a setting and episode version.

    Only complete rows are adjusted and counted, and somebody else's entry in no family but its own, ours and its own:
    what others add changes nobody's figures.
    """
    import pandas as pd

    from benchmark.scoring.statistics import holm

    p_values = pd.Series(np.nan, index=table.index)
    for (*of_setting, entry), rows in table.groupby(["setting", "episode_version", "entry_hash"]):
        alike = (table[["setting", "episode_version"]] == of_setting).all(axis=1)
        family = table[name][alike & table.complete & table.entry_hash.isin(["", entry])]
        p_values.update(pd.Series(holm(family.to_numpy()), family.index).reindex(rows.index))
    return p_values


def _training(episodes: "pd.DataFrame") -> "pd.Series":
    """What counts as one training: the seed, or where the checkpoint does not say, the checkpoint."""
    seed = episodes.training_seed
    return seed.astype(str).where(seed >= 0, episodes.checkpoint_hash)


def _direct(on_arm: "pd.DataFrame", group: "pd.DataFrame", foreign: bool) -> "pd.DataFrame":
    """Episodes of direct transfer that a group can be compared with; none for direct transfer itself.

    A policy that is not ours, and that may not even diffuse, is compared with ours as they usually sample, or with all
    where ours do not diffuse.
    """
    sampling = group[SAMPLING].iloc[0].copy()
    if foreign and not on_arm.sampler[on_arm.method == "direct"].eq("none").all():
        sampling[["sampler", "sampling_steps"]] = RunConfig.sampler, RunConfig.sampling_steps
    same = (on_arm[SAMPLING] == sampling).all(axis=1)
    return on_arm[same & (on_arm.method == "direct") & (group.method.iloc[0] != "direct")]


def _to_usual_arm(episodes: "pd.DataFrame", group: "pd.DataFrame", protocol: Protocol) -> dict[str, float]:
    """Difference of direct transfer on an arm that stands or holds its tool otherwise to that on the arm of the setting
    embodied; NaN for all else."""
    from benchmark.scoring.statistics import clustered_difference, sign_flip_p_value

    first, alike = group.iloc[0], ["robot", "method", "episode_version", *SAMPLING]
    common = usual_rows(episodes[(episodes[alike] == first[alike]).all(axis=1)], "embodied")
    if not changes(first, "embodied") or first.method != "direct":
        common = common[:0]
    pairs = group.merge(common, on=["checkpoint_hash", "episode_seed"], suffixes=("", "_common"))
    row: dict[str, float] = {}
    for name in protocol.scores:
        crossed = _crossed(pairs, pairs[name].astype(float) - pairs[f"{name}_common"].astype(float))
        row |= _named(f"{name}_arm_difference", clustered_difference(crossed))
        row[f"{name}_arm_p"] = sign_flip_p_value(crossed)
    return row


def _row(group: "pd.DataFrame", direct: "pd.DataFrame", protocol: Protocol, task: "Task", foreign: bool) -> dict:
    """One row of the leaderboard; an entry that has one of our policies is to have all of them.

    A foreign policy is compared with each of ours on the same scenes, all others with themselves.
    """
    from benchmark.scoring.statistics import clustered_difference, clustered_mean, sign_flip_p_value

    first = group.iloc[0]
    names = group.groupby("checkpoint").checkpoint_hash.nunique()
    if names.max() > 1:
        raise SettingError(
            f"Two policies go by the name {names.idxmax()} on {first.robot}, {first.setting}, {first.method} "
            f"{first['lambda']:g}: {', '.join(x[:12] for x in group.checkpoint_hash.unique())}. "
            "Move the episodes of one of them away."
        )
    row = first[[*ARM, *GUIDANCE, *SAMPLING, "episode_version"]].to_dict() | {
        "entry": bool(first.entry_hash),
        "commits": sorted(group.commit.unique()),
        "n": len(group),
        "episodes": group.episode_seed.nunique(),
        "trainings": group.training.nunique(),
        "causes": group.failure_cause.dropna().value_counts().to_dict(),
    }
    of_pair = ["episode_seed"] if foreign else ["checkpoint_hash", "episode_seed"]
    pairs = group.merge(direct, on=of_pair, suffixes=("", "_direct")).assign(training=lambda pair: pair.training_direct)
    policies, with_each = (group.checkpoint.nunique(), protocol.policies) if foreign else (protocol.policies, 1)
    whole = len(group) == protocol.episodes * policies
    row["complete"] = whole and len(pairs) in (0, with_each * len(group))
    shares = [trait.name for trait in task.traits if not trait.of]
    for name in (*protocol.scores, *(trait.name for trait in task.traits)):
        extra = {"extra": ()} if name in shares else {}
        row |= _named(name, clustered_mean(_crossed(group, group[name]), **extra))
        row |= _named(f"{name}_difference", (np.nan,) * 3)
        row |= {f"{name}_p": np.nan} if name in protocol.scores else {}
        if len(pairs):
            difference = pairs[name].astype(float) - pairs[f"{name}_direct"].astype(float)
            crossed = _crossed(pairs, difference)
            row |= _named(f"{name}_difference", clustered_difference(crossed, **extra))
            if name in protocol.scores:
                row[f"{name}_p"] = sign_flip_p_value(crossed)
    changes = [pairs[name] != pairs[f"{name}_direct"] for name in task.plan] if len(pairs) else []
    changed = clustered_mean(_crossed(pairs, reduce(or_, changes))) if changes else (np.nan,) * 3
    row |= _named("order_changed", changed)
    row["policies"] = [_policy(rows, direct, protocol, task) for _, rows in group.groupby("checkpoint")]
    for score in protocol.scores:
        means = [policy[score] for policy in row["policies"]]
        row |= {f"{score}_least": min(means), f"{score}_most": max(means)}
    return row


def _crossed(rows: "pd.DataFrame", values: "pd.Series") -> "Crossed":
    """Values of these rows by training and episode."""
    from benchmark.scoring.statistics import Crossed

    return Crossed(values.to_numpy(float, na_value=np.nan), rows.training.to_numpy(str), rows.episode_seed.to_numpy())


def _policy(rows: "pd.DataFrame", direct: "pd.DataFrame", protocol: Protocol, task: "Task") -> dict:
    """Figures of one policy: Wilson intervals, paired differences to direct transfer, exact McNemar tests."""
    from benchmark.scoring.scores import paired
    from benchmark.scoring.statistics import rate_interval

    policy = {"checkpoint": rows.checkpoint.iloc[0], "n": len(rows)}
    control = direct[direct.checkpoint_hash == rows.checkpoint_hash.iloc[0]]
    differences = paired(rows, control, task).set_index("score") if len(control) else None
    for score in protocol.scores:
        values = rows[score].to_numpy(dtype=float)
        policy |= _named(score, (values.mean(), *rate_interval(values)))
        policy |= _named(f"{score}_difference", (np.nan,) * 3) | {f"{score}_mcnemar": np.nan}
        if differences is not None:
            *interval, p_value = differences.loc[score, ["difference", "low", "high", "p"]]
            policy |= _named(f"{score}_difference", interval) | {f"{score}_mcnemar": p_value}
    return policy


def _named(name: str, interval: tuple[float, float, float]) -> dict[str, float]:
    return dict(zip((name, f"{name}_low", f"{name}_high"), interval, strict=True))
