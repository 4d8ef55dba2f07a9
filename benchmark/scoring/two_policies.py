"""Two policies on the same scenes: pairs of episodes, and what they come to."""

from typing import TYPE_CHECKING

from benchmark.scoring.anytime import anytime_difference, evidence, first_clear
from benchmark.settings.setting import SettingError
from richmap.progress import number_of

if TYPE_CHECKING:
    import pandas as pd

OF_TASK = ["group", "task_id"]


def paired_episodes(a: "pd.DataFrame", b: "pd.DataFrame") -> "pd.DataFrame":
    """Episodes of both with the same scene: `group`, `task_id`, `seed`, and the success of each, `a` and `b`.

    Args:
        a: As `benchmark.scoring.eval_info.read_eval_info` gives them.
        b: Likewise. Where one of the two does not say its seeds, the i-th episode is taken to be that of the other.

    Raises:
        SettingError: If they are not of the same scenes.
    """
    import pandas as pd

    ours, theirs = dict([*a.groupby(OF_TASK)]), dict([*b.groupby(OF_TASK)])
    if ours.keys() != theirs.keys():
        raise SettingError(
            f"a is of {_names(ours)}, and b of {_names(theirs)}. Run lerobot-eval with the same --env.type and "
            "--env.task for both."
        )
    seeded, parts = a.attrs["seeded"] and b.attrs["seeded"], []
    for key, one in ours.items():
        other, name = theirs[key], f"{key[0]} {key[1]}".strip()
        envs = one.env.iloc[0], other.env.iloc[0]
        if all(envs) and envs[0] != envs[1]:
            raise SettingError(f"a is of {envs[0]}, and b of {envs[1]}. Evaluate both on the same arm and setting.")
        if len(one) != len(other):
            raise SettingError(
                f"{name}: a has {number_of('episode', len(one))}, and b {len(other)}. Run both with the same "
                "--eval.n_episodes and --seed."
            )
        if seeded and sorted(one.seed) != sorted(other.seed):
            raise SettingError(
                f"{name}: a has seeds {one.seed.min()} to {one.seed.max()}, and b {other.seed.min()} to "
                f"{other.seed.max()}: not the same scenes. Run both with the same --seed and --eval.n_episodes."
            )
        if seeded:
            one, other = one.sort_values("seed"), other.sort_values("seed")
        elif b.attrs["seeded"]:
            one = one.assign(seed=other.seed.to_numpy())
        parts.append(one[[*OF_TASK, "seed"]].assign(a=one.success.to_numpy(), b=other.success.to_numpy()))
    return pd.concat(parts, ignore_index=True)


def _names(tasks: dict) -> str:
    return ", ".join(f"{group} {number}".strip() for group, number in tasks)


def comparison_text(pairs: "pd.DataFrame", names: tuple[str, str], alpha: float | None = None) -> str:
    """What pairs come to, for people: success of each, their difference, and how many differ.

    Args:
        pairs: As `paired_episodes` gives them.
        names: Of the two.
        alpha: With it the figures are those that hold whenever one stops (`benchmark.scoring.anytime`); None for those
            of a number of pairs that was fixed beforehand.
    """
    from benchmark.scoring.statistics import LEVEL, paired_difference, paired_p_value, rate_interval

    bound = f", with {100 * LEVEL:g} % intervals" if alpha is None else ""
    lines = [f"{number_of('pair', len(pairs))}. Success in percent{bound}:"]
    for letter, name in zip("ab", names, strict=True):
        success = pairs[letter].to_numpy(float)
        low, high = rate_interval(success)
        interval = f" [{100 * low:.1f}, {100 * high:.1f}]" if alpha is None else ""
        lines.append(f"  {letter}: {100 * success.mean():.1f}{interval}  {name}")
    a, b = pairs.a.to_numpy(float), pairs.b.to_numpy(float)
    if len(tasks := [*pairs.groupby(OF_TASK)]) > 1:
        lines += [
            f"  {group} {number}: a {100 * part.a.mean():.1f}, b {100 * part.b.mean():.1f}, n {len(part)}"
            for (group, number), part in tasks
        ]
    signs = (a - b).astype(int)
    won, lost = int((signs > 0).sum()), int((signs < 0).sum())
    differ = f"{won + lost} pairs differ: a won {won}, b {lost}."
    if alpha is None:
        lines.append(f"a minus b on the same scenes, in points: {_points(paired_difference(a, b))}.")
        lines.append(f"{differ} Exact sign test: p = {paired_p_value(a, b):.2g}.")
        return "\n".join(lines)
    e, after = float(evidence(signs).max()), first_clear(signs, alpha)
    interval = _points(anytime_difference(signs, alpha))
    lines.append(f"a minus b on the same scenes, in points: {interval}, at {100 * (1 - alpha):g} % whenever one stops.")
    said = "not clear yet" if after is None else f"clear after {after} pairs"
    lines.append(f"{differ} Evidence, at its greatest: e = {e:.3g} ({1 / alpha:g} is clear): {said}.")
    return "\n".join(lines)


def _points(interval: tuple[float, float, float]) -> str:
    mean, low, high = (100 * value for value in interval)
    return f"{mean:+.1f} [{low:+.1f}, {high:+.1f}]"
