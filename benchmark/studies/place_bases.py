"""Where to put each target arm for this task, by its own reachability map: the setting `best`.

python -m benchmark.studies.place_bases
"""

from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.settings.command import run_command
from benchmark.settings.map_config import MapConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.robot_config import check_targets
from benchmark.settings.setting import check_counts, check_setting
from envs.block_push.task import BLOCK_PUSH
from richmap.outputs import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from richmap.maps.base_placement import BasePlacement
    from richmap.maps.reachability_map import ReachabilityMap

TILT = 0.1
"""The tool points down, or tilts by this, in [rad], to one of eight sides. A map keeps directions that far apart: its
answer for one direction alone hangs on which ones it happened to keep, on whole rings about the base."""
PLACES_X, PLACES_Y = np.round(np.arange(-0.4, 0.201, 0.02), 2), np.round(np.arange(-0.2, 0.201, 0.04), 2)
"""Candidates for the base at the table's height, in [m]."""
SHORTLIST = 0.95
"""Places that score at least this much of the best score are told apart by feasibility: the map's cells are wider than
what is between them."""


@dataclass
class PlaceBasesConfig:
    """Finds where each target arm stands best for this task, by its reachability map, and its branch there."""

    robots: list[str] = field(default_factory=lambda: ["ur3", "ur5", "ur10"])
    """Arms, as in robots=[ur3,ur5]."""
    episodes: int = 30
    """Demonstrations whose positions are to be reached, from the scene of seed 0 on; a whole number from 1 to 1000."""
    stride: int = 8
    """Every so many control steps a position is taken; a whole number >= 1."""
    margin: float = 0.1
    """How far from the edge of the reach a position should be, in m, from 0 to 0.5."""
    output_dir: str = "results"
    """Folder of base_placement.md; the figure goes to its folder figures."""
    workers: int = 2
    """Processes that sample where a map is to be built; a whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)

    def __post_init__(self) -> None:
        check_targets(self.robots)
        check_setting(1 <= self.episodes <= 1000, "episodes", self.episodes, "a whole number from 1 to 1000")
        check_counts(self, "stride", "workers")
        check_setting(0 <= self.margin <= 0.5, "margin", self.margin, "a number from 0 to 0.5")
        check_folder(self.output_dir)


@dataclass(frozen=True)
class CandidateBases:
    """What the map says about each place for an arm's base, and what the arm in its branches does about the path."""

    robot: str
    placement: "BasePlacement"
    """The map's answer for all candidates, x slowest."""
    path: np.ndarray
    """Flange positions that the task takes, (n, 3), in [m]."""
    shares: dict[str, dict[int, float]]
    """By branch and candidate: share of the path's positions over which the tool can be held upright in that
    branch. For the candidates of the shortlist and for those along x at y = 0."""

    @property
    def shortlist(self) -> np.ndarray:
        """Candidates that score nearly as high as the best."""
        return np.flatnonzero(self.placement.score >= SHORTLIST * self.placement.score.max())

    @property
    def chosen(self) -> tuple[int, str]:
        """Candidate and branch with the largest feasible share of the shortlist; of equal ones the highest score."""
        pairs = [(int(i), branch) for i in self.shortlist for branch in self.shares]
        return max(pairs, key=lambda pair: (round(self.shares[pair[1]][pair[0]], 3), self.placement.score[pair[0]]))


def main(config: PlaceBasesConfig) -> None:
    """Score places for each arm's base by its map, choose the branch there by feasibility, and write both down."""
    from benchmark.artifacts.maps import robot_map
    from benchmark.rollouts.arm_oracle import demonstrated_path
    from richmap.progress import plain_console
    from richmap.robots.robots import load_robot

    console, output_dir = plain_console(), Path(config.output_dir)
    path = demonstrated_path(BLOCK_PUSH, config.episodes, console)
    arms = []
    for name in config.robots:
        of_arm = robot_map(load_robot(name), (0.0, 0.0, 0.0), config.map, config.workers, console)
        arms.append(place(of_arm, path[:: config.stride], config.margin, console))
        chosen, branch = arms[-1].chosen
        console.print(f"{name}: base {arms[-1].placement.bases[chosen, :3].tolist()} m, branch {branch}")
    with replacing(output_dir / "base_placement.md") as file:
        file.write_text(markdown(arms, config))
    figure = output_dir / "figures" / "base_placement.png"
    with replacing(figure) as file:
        draw(arms).savefig(file, dpi=120)
    console.print(f"Table: {output_dir / 'base_placement.md'}, figure: {figure}", soft_wrap=True)


def place(of_arm: "ReachabilityMap", path: np.ndarray, margin: float, console: "Console") -> CandidateBases:
    """Score all candidates by the map, and the shortlist and those along x by feasibility in each branch."""
    from richmap.maps.base_placement import place_base
    from richmap.progress import progress_bar
    from richmap.robots.robots import robot_file

    robot = of_arm.construction.robot
    bases = np.array([(x, y, 0.0, 0.0) for x, y in product(PLACES_X, PLACES_Y)])
    with console.status(f"Scoring {len(bases)} places of {robot}"):
        towards = np.tile(directions(), (len(path), 1))
        placement = place_base(of_arm, np.repeat(path, len(directions()), axis=0), towards, bases, margin)
    arm = CandidateBases(robot, placement, path, {branch: {} for branch in [*robot_file(robot).branches] or ["found"]})
    asked = sorted({*arm.shortlist.tolist(), *np.flatnonzero(bases[:, 1] == 0).tolist()})
    with progress_bar(console) as progress:
        for candidate in progress.track(asked, description=f"Feasibility of {robot}"):
            for branch, shares in arm.shares.items():
                shares[candidate] = feasible_share(robot, branch, tuple(bases[candidate, :3]), path)
    return arm


def directions() -> np.ndarray:
    """Approach directions, (9, 3), that a place for the base is scored by: down, and tilted to eight sides."""
    side = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    tilted = np.column_stack([np.sin(TILT) * np.cos(side), np.sin(TILT) * np.sin(side), np.full(8, -np.cos(TILT))])
    return np.vstack([[0.0, 0.0, -1.0], tilted])


def feasible_share(robot: str, branch: str, base: tuple[float, float, float], path: np.ndarray) -> float:
    """Share of the path's positions over which the arm holds its tool upright in its branch."""
    from envs.arm.feasibility import Feasibility, feasibility
    from envs.block_push.arm import block_push_arm
    from envs.block_push.workspace import HEIGHT

    try:
        arm = block_push_arm(robot, base=base, branch=branch)
    except ValueError:  # No branch is found from there.
        return 0.0
    causes = feasibility(arm, path[:, :2], HEIGHT)
    return float((causes == Feasibility.FEASIBLE).mean())


TEXT = """# Where the arms stand best

Made by `python -m benchmark.studies.place_bases`: {poses} flange positions of the xArm6's oracle in the scenes of the
first
{episodes} demonstrations, tool down or {tilt} rad beside it, and {places} places for the base at the table's height
(x {x0:g} to {x1:g} m, y {y0:g} to {y1:g} m), scored by the arm's own reachability map (cells of {cell} m). *Reached*:
share of the poses in the map. *Score*: the same, each pose counted as the share of its neighbourhood of {margin} m that
is in the map too. *Out*, *in*: share of the positions over which the arm holds its tool upright in that branch of its
wrist, free of self-collision and within the joint limits.

The map chooses the places that score at least {shortlist:.0f} % of its best; among those the arm in its better branch
does, and of equal ones the higher score. That is the setting `best` (its file in `richmap/robots`).

{table}

The map holds every branch of the arm, while the arm sits in one: its favourite is not the branch's. Along y = 0:

{differences}

![scores over the table, and along x the map beside the branches](figures/base_placement.png)
"""


def markdown(arms: list[CandidateBases], config: PlaceBasesConfig) -> str:
    """The found bases and branches, and where map and branch differ."""
    import pandas as pd

    rows, differences = [], []
    for arm in arms:
        bases, score = arm.placement.bases, arm.placement.score
        chosen, branch = arm.chosen
        common = int(np.flatnonzero((bases[:, :2] == 0).all(1))[0])
        for place, index in (("common", common), ("map's favourite", int(np.argmax(score))), ("best", chosen)):
            rows.append(
                {
                    "arm": arm.robot,
                    "base": place,
                    "x, y [m]": f"{bases[index, 0]:.2f}, {bases[index, 1]:.2f}",
                    "reached": f"{100 * arm.placement.reachable[index]:.1f} %",
                    "score": f"{score[index]:.3f}",
                    **{w: f"{100 * shares[index]:.1f} %" for w, shares in arm.shares.items()},
                    "branch": branch if place == "best" else "",
                }
            )
        along = np.flatnonzero(bases[:, 1] == 0)
        text = f"- {arm.robot}: the map's score is highest at x {bases[along[np.argmax(score[along])], 0]:.2f} m"
        for w, shares in arm.shares.items():
            share = np.array([shares[i] for i in along])
            most = bases[along[share > share.max() - 1e-9], 0]
            text += f"; {w}: {100 * share.max():.1f} % from x {most.min():.2f} to {most.max():.2f} m"
        differences.append(text + ".")
    return TEXT.format(
        poses=len(arms[0].path), episodes=config.episodes, tilt=TILT, places=len(PLACES_X) * len(PLACES_Y),
        x0=PLACES_X[0], x1=PLACES_X[-1], y0=PLACES_Y[0], y1=PLACES_Y[-1], cell=config.map.cell_size,
        margin=config.margin, shortlist=100 * SHORTLIST,
        table=pd.DataFrame(rows).to_markdown(index=False, disable_numparse=True), differences="\n".join(differences),
    )  # fmt: skip


def draw(arms: list[CandidateBases]) -> "Figure":
    """For each arm the score over all places, and along x what the map and the branches say."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2 * len(arms), 7.6), layout="constrained")
    above, below = figure.subplots(2, len(arms), squeeze=False)
    for ax, line, arm in zip(above, below, arms, strict=True):
        bases, score = arm.placement.bases, arm.placement.score
        mesh = ax.pcolormesh(PLACES_X, PLACES_Y, score.reshape(len(PLACES_X), len(PLACES_Y)).T, cmap="viridis")
        figure.colorbar(mesh, ax=ax, label="score of the map", shrink=0.8)
        ax.plot(*arm.path[:, :2].T, ".", color="0.5", ms=1, label="positions to reach")
        ax.plot(*bases[arm.shortlist, :2].T, ".", color="white", ms=2, label="shortlist")
        ax.plot(0, 0, "k+", ms=12, mew=2, label="common base")
        ax.plot(*bases[arm.chosen[0], :2], "*", color="tab:red", ms=14, mec="white", label="best base")
        ax.set(title=arm.robot, xlabel="x [m]", ylabel="y [m]", aspect="equal", xlim=(-0.45, 0.7), ylim=(-0.45, 0.45))
        along = np.flatnonzero(bases[:, 1] == 0)
        line.plot(PLACES_X, arm.placement.reachable[along], "k:", label="map: reached")
        line.plot(PLACES_X, score[along], "k", label="map: score")
        for branch, shares in arm.shares.items():
            line.plot(PLACES_X, [shares[i] for i in along], label=f"feasible, {branch}")
        line.set(xlabel="base x [m], y = 0", ylabel="share of the positions", ylim=(0, 1.02))
    above[0].legend(fontsize="x-small", loc="lower right", facecolor="0.8")
    below[0].legend(fontsize="small", loc="lower left")
    return figure


if __name__ == "__main__":
    run_command(main, PlaceBasesConfig, "place_bases")
