"""What the scripted oracles reach on each target arm, setting by setting and with one choice changed at a time.

python -m benchmark.studies.arms
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.episodes.arm import of_arm
from benchmark.rollouts.arm_oracle import ArmOracle, play_missing
from benchmark.settings.command import check_setting, run_command
from benchmark.settings.config import (
    ORACLE_METHODS,
    ORACLES,
    SETTINGS,
    check_folder,
    check_targets,
)
from benchmark.settings.scenes import FIRST_TEST_SEED, check_scenes
from envs.block_push.task import BLOCK_PUSH
from richmap.outputs import replacing

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from envs.arm.feasibility import TableFeasibility
    from envs.arm.placed_arm import PlacedArm

BASE_X = np.round(np.arange(-0.04, 0.141, 0.02), 2)
"""Base positions of the figure, in [m]; y and z are the common base's."""
WEIGHTS = (0.01, 0.1, 10.0)
"""Factors of the orientation's weight."""
RING_MODEL = {
    "ur3": {0.0: 70, 0.04: 93, 0.08: 97, 0.11: 88, 0.14: 68},
    "ur10": {0.0: 98, 0.04: 78, 0.08: 55, 0.11: 35, 0.14: 17},
}
"""p2 in percent by base x in [m], 60 episodes each, of the original environment's oracle whose tool is moved to the
nearest point of a ring about the base: .155 to .554 m for the UR3, .22 to 1.3 m for the UR10, both wrists out."""
FEASIBLE_COLOURS = {
    "FEASIBLE": "white",
    "OUT_OF_REACH": "0.55",
    "JOINT_LIMIT": "tab:purple",
    "WRONG_BRANCH": "tab:orange",
    "SELF_COLLISION": "tab:red",
}


@dataclass
class ArmsConfig:
    """Rolls the scripted oracles out on the target arms: each setting, single changes of it, where the tool can be."""

    robots: list[str] = field(default_factory=lambda: ["ur3", "ur5", "ur10"])
    """Arms, as in robots=[ur3,ur5]."""
    changed: list[str] = field(default_factory=lambda: list(SETTINGS))
    """Settings of which single choices are changed, as in changed=[embodied]."""
    episodes: int = 500
    """Number of episodes of each condition; a whole number >= 1."""
    seed_start: int = FIRST_TEST_SEED
    """Seed of the first episode: by default the policies' test scenes, to pair with; nothing is chosen by it."""
    demonstrations: int = 30
    """Demonstrations drawn over the table; a whole number from 1 to 1000."""
    spacing: float = 0.01
    """Of the points of the table in the pictures, in m, from 0.005 to 0.1."""
    output_dir: str = "results"
    """Folder of arms.md, arms/episodes and the figures in its folder figures."""
    workers: int = 2
    """Processes that roll out; results do not depend on it. A whole number >= 1."""

    def __post_init__(self) -> None:
        check_targets(self.robots)
        for name in self.changed:
            check_setting(name in SETTINGS, "changed", name, ", ".join(SETTINGS))
        for name in ("episodes", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        drawn = self.demonstrations
        check_setting(1 <= drawn <= 1000, "demonstrations", drawn, "a whole number from 1 to 1000")
        check_setting(0.005 <= self.spacing <= 0.1, "spacing", self.spacing, "a number from 0.005 to 0.1")
        check_scenes(self.seed_start, self.episodes)
        check_folder(self.output_dir)


@dataclass(frozen=True)
class OracleCondition:
    """An arm, and who moves it."""

    change: str
    """What differs from the setting; empty for the setting itself."""
    arm: "PlacedArm"
    oracle: str
    """`plain` or `aware`."""

    @property
    def player(self) -> ArmOracle:
        """Who plays its episodes."""
        return ArmOracle(BLOCK_PUSH, self.arm, self.oracle)

    @property
    def can_start(self) -> bool:
        """Whether the arm can hold its tool over the task's start."""
        from envs.arm.placed_arm import start_posture

        try:
            start_posture(self.arm, self.arm.kinematics(), BLOCK_PUSH.poses.start)
        except ValueError:
            return False
        return True


def main(config: ArmsConfig) -> None:
    """Play what is missing of each condition, store every episode, and write tables and figures."""
    import pandas as pd
    from rich.console import Console

    from benchmark.rollouts.arm_oracle import demonstrated_path

    console, output_dir = Console(), Path(config.output_dir)
    conditions = [c for robot in config.robots for c in arm_conditions(robot, config.changed)]
    players = dict.fromkeys(condition.player for condition in conditions if condition.can_start)
    seeds = range(config.seed_start, config.seed_start + config.episodes)
    episodes = pd.concat(play_missing([*players], seeds, output_dir / "arms", config.workers, "Oracles", console))
    figures = {"base_x": draw_base_x(episodes, conditions)}
    path = demonstrated_path(BLOCK_PUSH, config.demonstrations, console)
    for robot in config.robots:
        tables = [feasibility_table(robot, setting, config.spacing) for setting in SETTINGS]
        figures[robot] = draw_tables(tables, path)
    for name, figure in figures.items():
        with replacing(output_dir / "figures" / f"arms_{name}.png") as file:
            figure.savefig(file, dpi=120)
    with replacing(output_dir / "arms.md") as file:
        file.write_text(markdown(episodes, conditions, config))
    console.print(f"Table: {output_dir / 'arms.md'}", soft_wrap=True)


def arm_conditions(robot: str, changed: list[str]) -> list[OracleCondition]:
    """The settings with both oracles, and for the plain one single changes of the settings in `changed`."""
    from envs.arm.place_arm import other_branches
    from envs.block_push.arm import block_push_arm

    conditions = []
    for setting in SETTINGS:
        arm = block_push_arm(robot, setting)
        conditions += [OracleCondition("", arm, oracle) for oracle in ORACLES]
        if setting not in changed:
            continue
        weights = [arm.orientation_weight * factor for factor in WEIGHTS]
        bases = [(float(x), 0.0, 0.0) for x in BASE_X if (float(x), 0.0, 0.0) != arm.base]
        bumping = replace(arm, self_collision=not arm.self_collision)
        changes = [
            *((other.branch.replace("_", " "), other) for other in other_branches(arm, BLOCK_PUSH.poses)),
            (f"self-collision {'off' if arm.self_collision else 'on'}", bumping),
            *((f"orientation weight {weight:g}", replace(arm, orientation_weight=weight)) for weight in weights),
        ]
        if setting != "best":
            changes += [(f"base x {base[0]:+.2f}", block_push_arm(robot, setting, base=base)) for base in bases]
        conditions += [OracleCondition(text, other, "plain") for text, other in changes]
    return conditions


def rows_of(episodes: "pd.DataFrame", condition: OracleCondition) -> "pd.DataFrame":
    """The episodes of a condition."""
    return of_arm(episodes[episodes.method == ORACLE_METHODS[condition.oracle]], condition.arm)


def feasibility_table(robot: str, setting: str, spacing: float) -> "TableFeasibility":
    """Where the arm can hold its tool upright in this setting."""
    from envs.arm.feasibility import table_feasibility
    from envs.arm.place_arm import other_branches
    from envs.block_push.arm import block_push_arm
    from envs.block_push.workspace import HEIGHT, WORKSPACE

    arm = block_push_arm(robot, setting)
    return table_feasibility(arm, spacing, WORKSPACE, HEIGHT, other_branches(arm, BLOCK_PUSH.poses))


TEXT = """# What the arms allow

Made by `python -m benchmark.studies.arms`: the scripted oracles on each target arm, {episodes} episodes each from seed
{seed_start}, percent with 95 % Wilson intervals. *plain*: the original's oracle, which knows nothing of
the arm. *aware*: chooses plan, side and contact of every push by where the arm can be
(`envs.block_push.aware_oracle`); its score
is the arm's **ceiling**; what it gives up, having found no push, counts as `dithering`. A change is one choice other
than the setting's; all else stays. Rows:
`arms/episodes`, episode version {version}.

{tables}

![p2 over the base's x](figures/arms_base_x.png)

{pictures}
"""


def markdown(episodes: "pd.DataFrame", conditions: list[OracleCondition], config: ArmsConfig) -> str:
    """A table for each arm."""
    import pandas as pd

    tables = []
    for robot in config.robots:
        rows = [table_row(episodes, condition) for condition in conditions if condition.arm.robot == robot]
        tables.append(f"## {robot}\n\n{pd.DataFrame(rows).to_markdown(index=False, disable_numparse=True)}")
    pictures = [
        f"![{robot}: where on the table it can hold its tool upright](figures/arms_{robot}.png)"
        for robot in config.robots
    ]
    return TEXT.format(
        episodes=config.episodes,
        seed_start=config.seed_start,
        version=", ".join(map(str, episodes.episode_version.unique())),
        tables="\n\n".join(tables),
        pictures="\n\n".join(pictures),
    )


def table_row(episodes: "pd.DataFrame", condition: OracleCondition) -> dict[str, str]:
    """Scores of one condition."""
    from benchmark.scoring.scores import causes_text, with_interval
    from benchmark.scoring.statistics import rate_interval

    arm, rows = condition.arm, rows_of(episodes, condition)
    row = {
        "setting": arm.setting,
        "change": condition.change,
        "oracle": condition.oracle,
        "base x, y": f"{arm.base[0]:g}, {arm.base[1]:g}",
        "branch": arm.branch,
        "n": str(len(rows)),
    }
    shown = {"p1": "p1", "p2": "p2", "score": "mean_score", "success_at_end": "success_at_end"}
    if rows.empty:
        return row | dict.fromkeys(shown.values(), "") | {"failed by cause": "cannot hold its tool over the start"}
    for name, title in shown.items():
        values = rows[name].to_numpy(dtype=float)
        low, high = rate_interval(values)
        row[title] = with_interval({name: values.mean(), f"{name}_low": low, f"{name}_high": high}, name)
    return row | {"failed by cause": causes_text(rows.failure_cause.dropna().value_counts().to_dict())}


def draw_base_x(episodes: "pd.DataFrame", conditions: list[OracleCondition]) -> "Figure":
    """p2 of the plain oracle over the base's x, with its interval, setting by setting; and the ring model."""
    from matplotlib.figure import Figure

    from benchmark.scoring.statistics import rate_interval

    moved = [c for c in conditions if c.oracle == "plain" and c.change.startswith("base")]
    settings = list(dict.fromkeys(condition.arm.setting for condition in moved))
    robots = list(dict.fromkeys(condition.arm.robot for condition in moved))
    figure = Figure(figsize=(5.2 * len(settings), 4.2), layout="constrained")
    for ax, setting in zip(figure.subplots(1, len(settings), squeeze=False, sharey=True)[0], settings, strict=True):
        for colour, robot in enumerate(robots):
            points = []
            usual = [c for c in conditions if not c.change and c.oracle == "plain"]
            for condition in (c for c in [*usual, *moved] if (c.arm.robot, c.arm.setting) == (robot, setting)):
                values = rows_of(episodes, condition).p2.to_numpy(dtype=float)
                branch = condition.arm.branch.replace("_", " ")
                if len(values):
                    points.append((condition.arm.base[0], values.mean(), *rate_interval(values)))
            if not points:
                continue
            x, p2, low, high = np.array(sorted(points)).T
            ax.plot(x, 100 * p2, "o-", color=f"C{colour}", label=f"{robot}, {branch}, plain oracle")
            ax.fill_between(x, 100 * low, 100 * high, color=f"C{colour}", alpha=0.15)
            if robot in RING_MODEL and branch == "wrist out":
                ring = zip(*RING_MODEL[robot].items(), strict=True)
                ax.plot(*ring, "s:", color=f"C{colour}", label=f"{robot}, wrist out, ring model")
        ax.set(title=f"setting {setting}", xlabel="base x [m], towards the table", ylabel="p2 [%]", ylim=(0, 102))
        ax.legend(fontsize="small")
    return figure


def draw_tables(tables: "list[TableFeasibility]", path: np.ndarray) -> "Figure":
    """For each setting of an arm, the table with what keeps it from where, and the demonstrations over it."""
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    from envs.arm.feasibility import Feasibility

    figure = Figure(figsize=(3.4 * len(tables) + 0.6, 5.2), layout="constrained")
    colours = ListedColormap([FEASIBLE_COLOURS[cause.name] for cause in Feasibility])
    for ax, table in zip(figure.subplots(1, len(tables), squeeze=False)[0], tables, strict=True):
        arm = table.arm
        ax.pcolormesh(table.x, table.y, table.cause.T, cmap=colours, vmin=-0.5, vmax=len(Feasibility) - 0.5)
        ax.plot(*path[:, :2].T, ".", color="tab:blue", ms=1, alpha=0.4)
        share = 100 * (table.clearance(path[:, :2]) > 0).mean()
        ax.plot(*arm.base[:2], "k^", ms=8)
        ax.set(
            title=f"{arm.robot} {arm.setting}, branch {arm.branch}\n{share:.1f} % of the path feasible", aspect="equal"
        )
        ax.set(xlabel="x [m]", ylabel="y [m]", xlim=(-0.12, table.x[-1]), ylim=(table.y[0], table.y[-1]))
    patches = [
        Patch(facecolor=FEASIBLE_COLOURS[cause.name], edgecolor="0.5", label=cause.name.lower().replace("_", " "))
        for cause in Feasibility
    ]
    figure.legend(handles=patches, loc="outside lower center", ncol=len(patches), fontsize="small")
    return figure


if __name__ == "__main__":
    run_command(main, ArmsConfig, "arms")
