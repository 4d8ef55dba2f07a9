"""Does similarity predict transfer? Energy and discrepancy along the paths of direct transfer, against its success.

python -m benchmark.prediction
"""

from dataclasses import dataclass, field
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING
from warnings import catch_warnings, simplefilter

import numpy as np

from benchmark.command import SettingError, check_setting, run_command
from benchmark.config import SETTINGS, SOURCE, TASK_ARMS, EnergyConfig, MapConfig, check_folder, check_targets
from benchmark.outputs import replacing

if TYPE_CHECKING:
    from collections.abc import Callable

    import pandas as pd
    from matplotlib.figure import Figure
    from rich.console import Console

    from envs.arms import ArmSetting

CELL = 0.05
"""Edge of the cells of the table that success is counted in, in [m]."""
LEAST_SCENES = 20
"""Scenes that pass a cell for it to count."""
RESAMPLES = 2000
"""Of the scenes, for the intervals."""
PREDICTORS = {
    "energy": "mean energy E along the path",
    "mmd": "mean MMD along the path, over the steps in cells that both arms reach",
    "infeasible": "share of the path where the target arm cannot hold its tool",
}
"""The last is no similarity: it needs the target arm alone."""
PATHS = {
    SOURCE: "the xArm6's own path in the same scene, known before anything is transferred",
    "target": "the path that the target arm drove, with all that went wrong on it",
}


@dataclass
class PredictionConfig:
    """Correlates energy, MMD and infeasibility along the path with success of direct transfer, scene by scene."""

    robots: list[str] = field(default_factory=lambda: list(TASK_ARMS[1:]))
    """Target arms, as in robots=[ur3,ur5]."""
    settings: list[str] = field(default_factory=lambda: list(SETTINGS))
    """Settings of the arms, also with another wrist or base; those without stored episodes are left out."""
    episodes: str = "results"
    """Folder under which episodes.parquet are read, of test seeds (100000 on) and lambda = 0."""
    output_dir: str = "results"
    """Folder of prediction.md and prediction.parquet; the figure goes to its folder figures."""
    seed: int = 0
    """Of the resampling, a whole number >= 0."""
    workers: int = 2
    """Processes that sample for maps that are not in the cache. A whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)

    def __post_init__(self) -> None:
        check_targets(self.robots)
        for name in self.settings or [None]:
            check_setting(name in SETTINGS, "settings", name, ", ".join(SETTINGS))
        for name, least in (("seed", 0), ("workers", 1)):
            check_setting(getattr(self, name) >= least, name, getattr(self, name), f"a whole number >= {least}")
        check_folder(self.output_dir)


def main(config: PredictionConfig) -> None:
    """Write the table and the figure from the stored episodes; maps come from the cache, or are built first."""
    import pandas as pd
    from rich.console import Console

    from benchmark.arm import arm_columns, setting_text, stored_arms

    console, output_dir = Console(), Path(config.output_dir)
    direct = direct_episodes(Path(config.episodes))
    rows, drawn, means = [], {}, []
    for arm in stored_arms(direct, config.robots, config.settings):
        pairs = with_source(direct, arm)
        if pairs.empty:
            continue
        fields = transfer_fields(arm, config, console)
        scenes, visits = by_scene(pairs, fields)
        about = {"robot": arm.robot, "setting": setting_text(arm_columns(arm)), "scenes": len(scenes)}
        about |= {"models": pairs.checkpoint.nunique(), "p2": scenes.p2.mean()}
        rows += [about | row for row in correlations(scenes, visits, fields, config.seed)]
        drawn[about["robot"], about["setting"]] = scenes
        means.append(about | scenes[[f"{name}_{SOURCE}" for name in PREDICTORS]].mean().to_dict())
    if not rows:
        raise SettingError(
            f"{config.episodes} holds no episodes of direct transfer on test seeds of {SOURCE} and of "
            f"{', '.join(config.robots)} with the same policies. "
            "Make them: python -m benchmark.run -m experiment=transfer"
        )
    table, of_arms = pd.DataFrame(rows), pd.DataFrame(means)
    with replacing(output_dir / "prediction.parquet") as path:
        table.to_parquet(path, index=False)
    with replacing(output_dir / "prediction.md") as path:
        path.write_text(markdown(table, of_arms, config.seed))
    for ending in ("svg", "png"):
        with replacing(output_dir / "figures" / f"prediction.{ending}") as path:
            prediction_figure(drawn).savefig(path, dpi=120)
    console.print(f"Table: {output_dir / 'prediction.md'}", soft_wrap=True)


def direct_episodes(folder: Path) -> "pd.DataFrame":
    """Stored episodes of direct transfer that a protocol counts, with their paths, of the usual policies that ship."""
    from benchmark.config import FIRST_TEST_SEED
    from benchmark.known_policies import shipped
    from benchmark.ranking import as_usual, counted_by_any
    from benchmark.trusted_rows import read_all_episodes

    table = as_usual(counted_by_any(read_all_episodes(folder, FIRST_TEST_SEED), shipped()))
    return table if table.empty else table[table.method == "direct"]


def with_source(direct: "pd.DataFrame", arm: "ArmSetting") -> "pd.DataFrame":
    """Episodes of an arm beside those of the source with the same policy, sampler and scene (suffix `_source`)."""
    from benchmark.arm import of_arm

    same = ["checkpoint_hash", "episode_seed", "sampler", "sampling_steps", "batch_shape", "code_version"]
    source = direct[direct.robot == SOURCE]
    nearest = source.assign(other=source.setting != arm.name).sort_values("other", kind="stable")
    source = nearest.drop_duplicates(same)  # It has one base and wrist in all settings; `best` has no rows of its own.
    return of_arm(direct, arm).merge(source[[*same, "path_x", "path_y"]], on=same, suffixes=("", "_source"))


@dataclass(frozen=True)
class TransferFields:
    """What paths are measured by; each function takes places of the flange, (n, 2) in [m], and gives (n,)."""

    energy: "Callable[[np.ndarray], np.ndarray]"
    mmd: "Callable[[np.ndarray], np.ndarray]"
    """NaN where not both arms have directions."""
    infeasible: "Callable[[np.ndarray], np.ndarray]"


def transfer_fields(arm: "ArmSetting", config: PredictionConfig, console: "Console") -> TransferFields:
    """Energy, MMD and infeasibility of an arm where it stands."""
    from benchmark.build_maps import energy_field, robot_map
    from benchmark.feasibility_field import feasibility_field
    from envs.arms import COMMON_BASE, HEIGHT
    from richmap.robots import load_robot
    from richmap.similarity import similarity

    description = load_robot(arm.robot)
    energy, _ = energy_field(description, arm.base, config.map, config.energy, config.workers, console)
    source = robot_map(load_robot(SOURCE), COMMON_BASE, config.map, config.workers, console)
    target = robot_map(description, arm.base, config.map, config.workers, console)
    similar = similarity(source, target, arm.base, config.energy.scales)
    distance, _ = feasibility_field(arm, console)
    return TransferFields(
        energy=lambda xy: energy.value_and_gradient(np.insert(xy, 2, HEIGHT, axis=1))[0],
        mmd=lambda xy: similar.mmd[similar.grid.cells_of(np.insert(xy, 2, HEIGHT, axis=1))],
        infeasible=lambda xy: (distance.value_and_gradient(np.insert(xy, 2, HEIGHT, axis=1))[0] > 0).astype(float),
    )


def by_scene(pairs: "pd.DataFrame", fields: TransferFields) -> tuple["pd.DataFrame", np.ndarray]:
    """One row per scene, means over the policies.

    Returns:
        p2, and each predictor on each path as column `<predictor>_<path>`; and which cells of the table (flat, of
        `cells`) the source's path passes in each scene, as a share of the policies, (scenes, cells).
    """
    import pandas as pd

    rows, visits = [], []
    for _, pair in pairs.iterrows():
        row = {"episode_seed": pair.episode_seed, "p2": float(pair.p2)}
        for path, suffix in ((SOURCE, "_source"), ("target", "")):
            xy = np.column_stack([pair[f"path_x{suffix}"], pair[f"path_y{suffix}"]]) / 1000
            for name in PREDICTORS:
                values = getattr(fields, name)(xy)
                row[f"{name}_{path}"] = np.nanmean(values) if np.isfinite(values).any() else np.nan
            if path == SOURCE:
                visits.append(visited(xy))
        rows.append(row)
    seeds = pairs.episode_seed.to_numpy()
    order = np.unique(seeds)
    shares = np.stack([np.mean([v for v, s in zip(visits, seeds, strict=True) if s == seed], axis=0) for seed in order])
    return pd.DataFrame(rows).groupby("episode_seed").mean().reset_index(), shares


def cells() -> np.ndarray:
    """Centres of the cells of the table, (n, 2) in [m]."""
    from envs.workspace import WORKSPACE

    x, y = (np.arange(low + CELL / 2, high, CELL) for low, high in WORKSPACE.T)
    return np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)


def visited(xy: np.ndarray) -> np.ndarray:
    """Which of the cells a path, (n, 2) in [m], passes."""
    from envs.workspace import WORKSPACE

    columns, lines = np.round((WORKSPACE[1] - WORKSPACE[0]) / CELL).astype(int)
    index = np.floor((xy - WORKSPACE[0]) / CELL).astype(int)
    index = index[((index >= 0) & (index < (columns, lines))).all(1)]
    passed = np.zeros(columns * lines, dtype=bool)
    passed[index[:, 0] * lines + index[:, 1]] = True
    return passed


def correlations(
    scenes: "pd.DataFrame", visits: np.ndarray, fields: TransferFields, seed: int
) -> list[dict[str, object]]:
    """Spearman's correlation of each predictor with success, with its 95 % bootstrap interval over scenes."""
    rows = []
    p2 = scenes.p2.to_numpy()
    for path in PATHS:
        for name in PREDICTORS:
            x = scenes[f"{name}_{path}"].to_numpy()
            rows.append(
                {"over": "scenes", "path": path, "predictor": name, "n": int(np.isfinite(x).sum())}
                | _interval(lambda chosen, x=x: _spearman(x[chosen], p2[chosen]), len(p2), seed)
            )
        ours, theirs = (scenes[f"{name}_{path}"].to_numpy() for name in ("infeasible", "energy"))
        rows.append(
            {"over": "scenes", "path": path, "predictor": "infeasible minus energy", "n": len(p2)}
            | _interval(
                lambda chosen, a=ours, b=theirs: _spearman(a[chosen], p2[chosen]) - _spearman(b[chosen], p2[chosen]),
                len(p2), seed,
            )
        )  # fmt: skip
    enough = (visits > 0).sum(0) >= LEAST_SCENES
    for name in PREDICTORS:
        x = getattr(fields, name)(cells()[enough])

        def over_cells(chosen: np.ndarray, x: np.ndarray = x) -> float:
            weight = visits[chosen][:, enough]
            rate = (weight * p2[chosen, None]).sum(0) / np.maximum(weight.sum(0), 1e-12)
            return _spearman(x[weight.sum(0) > 0], rate[weight.sum(0) > 0])

        rows.append(
            {"over": "cells", "path": SOURCE, "predictor": name, "n": int(enough.sum())}
            | _interval(over_cells, len(p2), seed)
        )
    return rows


def over_arms(means: "pd.DataFrame") -> list[dict[str, object]]:
    """Spearman's correlation of each predictor's mean on the source's path with p2, arm by arm, and Fisher's interval;
    arms are too few to resample. NaN where all are alike."""
    from scipy.stats import pearsonr, rankdata

    p2, rows = means.p2.to_numpy(), []
    for name in PREDICTORS:
        x = means[f"{name}_{SOURCE}"].to_numpy()
        known = not np.isnan(r := _spearman(x, p2))
        low, high = pearsonr(rankdata(x), rankdata(p2)).confidence_interval() if known else (np.nan, np.nan)
        rows.append({"predictor": name, "r": r, "low": low, "high": high})
    return rows


def _spearman(x: np.ndarray, y: np.ndarray) -> float:
    """NaN if either says nothing."""
    from scipy.stats import rankdata

    known = np.isfinite(x) & np.isfinite(y)
    if known.sum() < 3 or np.ptp(x[known]) == 0 or np.ptp(y[known]) == 0:
        return np.nan
    return float(np.corrcoef(rankdata(x[known]), rankdata(y[known]))[0, 1])


def _interval(statistic: "Callable[[np.ndarray], float]", n: int, seed: int) -> dict[str, float]:
    """The statistic of all scenes, and its normal bootstrap interval on Fisher's scale.

    Ties among resampled scenes bias what they give, which percentiles would take over, and a correlation ends at 1. A
    difference of two correlations may exceed that, but is small here, where the scale is nearly straight.
    """
    from scipy.stats import DegenerateDataWarning, bootstrap, norm

    from benchmark.statistics import LEVEL

    value = statistic(np.arange(n))
    if np.isnan(value):
        return {"r": np.nan, "low": np.nan, "high": np.nan}
    with catch_warnings():
        simplefilter("ignore", DegenerateDataWarning)  # Of resamples in which all succeed or fail; they do not count.
        resampled = bootstrap(
            (np.arange(n),), statistic, n_resamples=RESAMPLES, vectorized=False, method="basic", rng=seed
        ).bootstrap_distribution
    within = 1 - 1e-9
    spread = np.nanstd(np.arctanh(np.clip(resampled, -within, within)))
    half = norm.ppf((1 + LEVEL) / 2) * spread
    low, high = np.tanh(np.arctanh(np.clip(value, -within, within)) + [-half, half])
    return {"r": value, "low": float(low), "high": float(high)}


TEXT = """# Does similarity predict transfer?

Direct transfer (λ = 0) on test seeds: Spearman's correlation of what a path meets with success (p2), scene by scene
(means over the policies), and over the {cell:g} m cells of the table (success of the scenes whose path on the xArm6
passes a cell, for cells that {least} scenes pass, against the value at its centre). Brackets: 95 % intervals for other
scenes and the same policies (bootstrap on Fisher's scale, seed {seed}). If similarity predicts transfer, energy and MMD
go with failure: r is well below 0. A dash: all scenes are alike. Made by `python -m benchmark.prediction` from the
stored episodes. Arms stand as in their setting, or with what is named changed; tools are upright.

Predictors: {predictors}. `infeasible minus energy` is the difference of their r: below 0, the arm alone predicts
better. Over cells `infeasible` is 0 or 1: where few cells are out of reach its r stays far from -1, and varies little.

Paths: {paths}.
"""


OVER_ARMS = """## Over arms and settings

Means over the scenes of the predictors on the xArm6's path, beside p2. Spearman's correlation with p2 over these {n}
arms, with Fisher's interval, as if they were drawn at random: {correlations}.

{table}
"""


def markdown(table: "pd.DataFrame", means: "pd.DataFrame", seed: int) -> str:
    """The document: a table over arms, and one per arm.

    Args:
        table: Correlations of each arm.
        means: Scenes, p2 and means of the predictors on the source's path of each arm.
        seed: Of the resampling.
    """
    import pandas as pd

    def text(row: "pd.Series | dict") -> str:
        return "–" if np.isnan(row["r"]) else f"{row['r']:+.2f} [{row['low']:+.2f}, {row['high']:+.2f}]"

    by_arm = {"arm": means.robot, "setting": means.setting, "scenes": means.scenes, "p2 [%]": 100 * means.p2}
    by_arm |= {name: means[f"{name}_{SOURCE}"] for name in PREDICTORS}

    parts = [
        TEXT.format(
            cell=CELL,
            least=LEAST_SCENES,
            seed=seed,
            predictors="; ".join(f"`{name}`, {said}" for name, said in PREDICTORS.items()),
            paths="; ".join(f"`{name}`, {said}" for name, said in PATHS.items()),
        ),
        OVER_ARMS.format(
            n=len(means),
            correlations=", ".join(f"`{row['predictor']}` {text(row)}" for row in over_arms(means)),
            table=pd.DataFrame(by_arm)
            .sort_values("p2 [%]")
            .to_markdown(index=False, floatfmt=("", "", "", ".1f", ".4f", ".4f", ".3f")),
        ),
    ]
    for (robot, setting), group in table.groupby(["robot", "setting"], sort=False):
        shown = pd.DataFrame(
            {
                "over": group.over + " (" + group.n.astype(str) + ")",
                "path": group.path,
                "predictor": group.predictor,
                "r": [text(row) for _, row in group.iterrows()],
            }
        )
        first = group.iloc[0]
        parts += [
            f"## {robot}, {setting}\n",
            f"{first.scenes} scenes, {first.models} policies, p2 {100 * first.p2:.1f} %.\n",
            shown.to_markdown(index=False, disable_numparse=True) + "\n",
        ]
    return "\n".join(parts)


def prediction_figure(drawn: "dict[tuple[str, str], pd.DataFrame]") -> "Figure":
    """Success against each predictor on the source's path, an arm a row: scenes in tenths, with 95 % intervals."""
    from matplotlib.figure import Figure

    from benchmark.statistics import rate_interval

    figure = Figure(figsize=(3.4 * len(PREDICTORS), 2.5 * len(drawn) + 0.8), layout="constrained")
    panels = figure.subplots(len(drawn), len(PREDICTORS), squeeze=False, sharey=True, sharex="col")
    for line, ((robot, setting), scenes) in zip(panels, drawn.items(), strict=True):
        for ax, name in zip(line, PREDICTORS, strict=True):
            x, p2 = scenes[f"{name}_{SOURCE}"].to_numpy(), scenes.p2.to_numpy()
            known = np.isfinite(x)
            for tenth in np.array_split(np.flatnonzero(known)[np.argsort(x[known])], 10):
                if len(tenth):
                    low, high = rate_interval(p2[tenth])
                    ax.plot([x[tenth].mean()] * 2, [100 * low, 100 * high], color="tab:blue", alpha=0.4)
                    ax.plot(x[tenth].mean(), 100 * p2[tenth].mean(), "o", color="tab:blue", markersize=4)
            ax.set(title=f"{robot}, {setting}", ylim=(-2, 102))
        line[0].set_ylabel("p2 [%]")
    for ax, text in zip(panels[-1], PREDICTORS.values(), strict=True):
        ax.set_xlabel(fill(text.split(",")[0], 32), fontsize="small")
    figure.suptitle(f"Direct transfer against what the {SOURCE}'s path in the same scene meets, tenths of the scenes")
    return figure


if __name__ == "__main__":
    run_command(main, PredictionConfig, "prediction")
