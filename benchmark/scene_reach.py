"""What scenes ask of an arm's reach, and who places both blocks in them: is it the method that fails, or the arm?

python -m benchmark.scene_reach
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.command import SettingError, check_setting, run_command
from benchmark.config import FIRST_TEST_SEED, ORACLE_METHODS, SETTINGS, TASK_ARMS, check_folder, check_targets
from benchmark.outputs import replacing

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure
    from rich.console import Console

    from envs.arms import ArmSetting

EDGES = (-np.inf, 0.0, 0.01, 0.02, 0.03, 0.05, np.inf)
"""Of the groups of scenes by what they ask, in [m]: the first asks nothing."""
GROUPS = ["0", "up to 1", "1 to 2", "2 to 3", "3 to 5", "over 5"]
"""Their names, in [cm]."""
DRAWN = ("direct", "paper", "chunk_feasibility", "reorder", "hand-over", *ORACLE_METHODS.values())
"""Methods that are drawn, each in its colour, beside direct transfer with a tool that may lean."""


@dataclass
class SceneReachConfig:
    """Sorts the test scenes by how far beyond the arm's reach straight pushes lead, and counts p2 in each group."""

    robots: list[str] = field(default_factory=lambda: list(TASK_ARMS[1:]))
    """Target arms, as in robots=[ur3,ur5]."""
    settings: list[str] = field(default_factory=lambda: ["embodied", "best"])
    """Settings of the arms, with any base and wrist; those without stored episodes of direct transfer are left out."""
    episodes: str = "results"
    """Folder under which episodes.parquet are read, of the strict protocol and of the oracles."""
    output_dir: str = "results"
    """Folder of scene_reach.md; the figure goes to its folder figures."""

    def __post_init__(self) -> None:
        check_targets(self.robots)
        for name in self.settings or [None]:
            check_setting(name in SETTINGS, "settings", name, ", ".join(SETTINGS))
        check_folder(self.output_dir)


def main(config: SceneReachConfig) -> None:
    """Write the tables and the figure from the stored episodes."""
    from rich.console import Console

    from benchmark.arm import stored_arms
    from benchmark.known_policies import shipped
    from benchmark.ranking import STRICT, as_usual, counted
    from benchmark.trusted_rows import read_all_episodes

    console, folder = Console(), Path(config.episodes)
    every = read_all_episodes(folder, FIRST_TEST_SEED)
    episodes = as_usual(counted(every, STRICT, shipped()))
    tables = {}
    for arm in stored_arms(episodes, config.robots, config.settings):
        rows, oracles = with_leaning_tools(episodes, arm), oracle_rows(every, arm)
        table = by_demand(rows, oracles, demands(arm, rows.episode_seed.unique(), console))
        tables[arm] = table.merge(to_ceiling(rows, oracles), on="method", how="left")
    if not tables:
        raise SettingError(
            f"{config.episodes} holds no episodes of the strict protocol of {', '.join(config.robots)}. "
            "Make them: python -m benchmark.run -m experiment=methods"
        )
    for ending in ("svg", "png"):
        with replacing(Path(config.output_dir) / "figures" / f"scene_reach.{ending}") as path:
            reach_figure(tables).savefig(path, dpi=110)
    file = Path(config.output_dir) / "scene_reach.md"
    with replacing(file) as path:
        path.write_text(markdown(tables))
    console.print(f"Table: {file}", soft_wrap=True)


def by_scale(episodes: "pd.DataFrame") -> "pd.DataFrame":
    """The episodes, those of a method that was run at several scales, or with several fields' cells, as methods of
    their own."""
    method = episodes.method
    for name, text in (("lambda", ", λ {:g}"), ("cell_size", ", cells {:g} m")):
        several = episodes.groupby("method")[name].transform("nunique") > 1
        method = method.where(~several, method + episodes[name].map(text.format))
    return episodes.assign(method=method)


def with_leaning_tools(episodes: "pd.DataFrame", arm: "ArmSetting") -> "pd.DataFrame":
    """The episodes on an arm; those with another weight of orientation, otherwise alike, as methods of their own."""
    import pandas as pd

    from benchmark.arm import of_arm

    if episodes.empty:
        return episodes
    rows = [by_scale(of_arm(episodes, arm))]
    for weight in sorted({*episodes.orientation_weight} - {arm.orientation_weight}):
        leaning = of_arm(episodes, replace(arm, orientation_weight=weight))
        rows.append(leaning.assign(method=leaning.method + f", orientation weight {weight:g}"))
    return pd.concat(rows)


def demands(arm: "ArmSetting", seeds: np.ndarray, console: "Console") -> "pd.Series":
    """What the scene of each episode seed asks of the arm, in [m]; its index are the seeds.

    Of the two ways to give each block a target the less demanding one; of its two straight pushes the more demanding
    one: how far the tool gets beyond the border of what the arm can hold (`policies.push_reach.overreach`).
    """
    import pandas as pd

    from benchmark.feasibility_field import feasibility_field
    from envs.arms import HEIGHT
    from envs.scene import draw_scene
    from policies.push_reach import overreach

    scenes = [draw_scene(int(seed)) for seed in seeds]
    blocks = np.array([(scene.block[:2], scene.block2[:2]) for scene in scenes])
    targets = np.array([(scene.target[:2], scene.target2[:2]) for scene in scenes])
    distance, _ = feasibility_field(arm, console)
    beyond = overreach(distance, blocks, targets, 0.0, HEIGHT)  # (n, block, target)
    straight, crossed = (np.diagonal(x, axis1=1, axis2=2).max(1) for x in (beyond, beyond[:, :, ::-1]))
    return pd.Series(np.minimum(straight, crossed), index=seeds)


def oracle_rows(episodes: "pd.DataFrame", arm: "ArmSetting") -> "pd.DataFrame":
    """The episodes of both oracles on an arm that stood alike; none if not played."""
    from benchmark.arm import of_arm

    return of_arm(episodes[episodes.method.isin(ORACLE_METHODS.values())], arm)


def by_demand(episodes: "pd.DataFrame", oracles: "pd.DataFrame", asked: "pd.Series") -> "pd.DataFrame":
    """p2 of each method in each group of scenes, with its interval for other trainings and scenes.

    Args:
        episodes: Rows of all methods.
        oracles: Rows of the oracles, or none.
        asked: What each scene asks, by episode seed, in [m].

    Returns:
        A row for each method and group that has scenes: `method`, `group` (number in `GROUPS`), `scenes`, `p2`,
        `p2_low` and `p2_high`. Methods come in order of their p2 in all scenes, the oracles last.
    """
    import pandas as pd

    from benchmark.statistics import Crossed, clustered_mean

    asked = asked.groupby(np.searchsorted(EDGES[1:], asked, side="left")).apply(lambda of_group: of_group.index)
    means = episodes.groupby("method").p2.mean().sort_values(ascending=False, kind="stable")
    every = pd.concat([episodes, oracles])
    rows = []
    for method in [*means.index, *(name for name in every.method.unique() if name not in means.index)]:
        of_method = every[every.method == method]
        for group, seeds in asked.items():
            there = of_method[of_method.episode_seed.isin(seeds)]
            values = Crossed(*(there[name].to_numpy() for name in ("p2", "training_seed", "episode_seed")))
            p2 = dict(zip(("p2", "p2_low", "p2_high"), clustered_mean(values), strict=True))
            rows.append({"method": method, "group": int(group), "scenes": there.episode_seed.nunique()} | p2)
    return pd.DataFrame(rows)


def to_ceiling(episodes: "pd.DataFrame", oracles: "pd.DataFrame") -> "pd.DataFrame":
    """p2 of each method minus that of the oracle that knows the arm, over all scenes that both have.

    Args:
        episodes: Rows of all methods.
        oracles: Rows of the oracles, or none.

    Returns:
        A row for each method, none without that oracle: `method`, `gap`, `gap_low` and `gap_high`, for other training
        seeds and scenes.
    """
    import pandas as pd

    from benchmark.statistics import Crossed, clustered_difference

    columns = ["method", "gap", "gap_low", "gap_high"]
    if oracles.empty:
        return pd.DataFrame(columns=columns)
    ceiling = oracles[oracles.method == ORACLE_METHODS["aware"]]
    pairs = episodes.merge(ceiling[["episode_seed", "p2"]], on="episode_seed", suffixes=("", "_ceiling"))
    pairs = pairs.assign(value=pairs.p2.astype(float) - pairs.p2_ceiling.astype(float))
    rows = []
    for method, of_method in pairs.groupby("method"):
        values = Crossed(*(of_method[name].to_numpy() for name in ("value", "training_seed", "episode_seed")))
        rows.append((method, *clustered_difference(values)))
    return pd.DataFrame(rows, columns=columns)


TEXT = """# What scenes ask of an arm

Made by `python -m benchmark.scene_reach` from the stored episodes of the strict protocol. Scenes are sorted by how far
beyond the border of what the arm can hold their straight pushes lead the tool, in cm: of the two ways to give each
block a target the less demanding one, of its two pushes the more demanding one. p2 in percent, in brackets 95 %
intervals for other training seeds and scenes. *Orientation weight*: of the inverse kinematics, 1 m/rad where none is
named; with less the tool leans where that brings it nearer to its command. The oracles' rows are those of
`benchmark.oracle`; they do not lean. The last column is p2 of all scenes minus that of the oracle that knows the arm,
its ceiling, in points.

{tables}

![p2 by what a scene asks](figures/scene_reach.png)
"""


def markdown(tables: "dict[ArmSetting, pd.DataFrame]") -> str:
    """The document: a table for each arm as it stood."""
    from benchmark.scores import difference_text, with_interval

    parts = []
    for arm, table in tables.items():
        scenes = table.groupby("group").scenes.max()
        shown = table.assign(
            text=[with_interval(row, "p2") for _, row in table.iterrows()],
            title=[f"{GROUPS[group]} cm, {scenes[group]} scenes" for group in table.group],
        )
        order = [f"{GROUPS[group]} cm, {scenes[group]} scenes" for group in scenes.index]
        wide = shown.pivot(index="method", columns="title", values="text").loc[table.method.unique(), order]
        gaps = table.drop_duplicates("method").set_index("method")
        wide[f"minus {ORACLE_METHODS['aware']}"] = [difference_text(gaps.loc[method], "gap") for method in wide.index]
        parts.append(f"## {arm_title(arm)}\n\n{wide.to_markdown(disable_numparse=True)}")
    return TEXT.format(tables="\n\n".join(parts))


def arm_title(arm: "ArmSetting") -> str:
    """The arm and its setting, and what is otherwise than on the setting's arm."""
    from benchmark.arm import arm_columns, setting_text

    return f"{arm.robot}, {setting_text(arm_columns(arm))}"


def reach_figure(tables: "dict[ArmSetting, pd.DataFrame]") -> "Figure":
    """p2 over the groups of scenes, a panel for each arm that is asked for what it cannot do."""
    from matplotlib.figure import Figure

    asked = {arm: table for arm, table in tables.items() if table.group.nunique() > 1} or tables
    figure = Figure(figsize=(5.2 * len(asked), 4.0), layout="constrained")
    for ax, (arm, table) in zip(figure.subplots(1, len(asked), squeeze=False)[0], asked.items(), strict=True):
        drawn = [name for name in table.method.unique() if name in DRAWN or "weight" in name]
        for shift, method in enumerate(drawn):
            rows = table[table.method == method]
            p2, low, high = (100 * rows[name].to_numpy() for name in ("p2", "p2_low", "p2_high"))
            x = rows.group + 0.08 * (shift - (len(drawn) - 1) / 2)
            colour = f"C{DRAWN.index(method)}" if method in DRAWN else "black"
            style = {"color": colour, "fmt": "o-", "markersize": 4, "linewidth": 0.8, "label": method}
            ax.errorbar(x, p2, np.stack([p2 - low, high - p2]), **style)
        scenes = table.groupby("group").scenes.max()
        ax.set_xticks(scenes.index, [f"{GROUPS[group]}\nn = {scenes[group]}" for group in scenes.index])
        ax.set(title=arm_title(arm), xlabel="beyond reach [cm]; scenes", ylabel="p2 [%]", ylim=(-2, 102))
        ax.legend(fontsize="small")
    return figure


if __name__ == "__main__":
    run_command(main, SceneReachConfig, "scene_reach")
