"""Does guidance act where the failures are? The energy's slope where episodes of direct transfer end.

python -m benchmark.failure_places
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.command import SettingError, check_setting, run_command
from benchmark.config import SETTINGS, TASK_ARMS, EnergyConfig, MapConfig, check_folder, check_targets
from benchmark.outputs import replacing

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from envs.arms import ArmSetting
    from richmap.energy import EnergyField

LAST = 10
"""Steps, a second, over which the place is averaged where an episode ends."""
PLACED = "both blocks placed"
"""Stands for the cause of an episode that did not fail."""
AT_BORDER = 0.01
"""An episode ends at the border of what the arm can hold if it ends no farther inside of it than this, in [m]."""
FLAT = 0.01
"""Slope, in [1/m], below which guidance does nothing: with λ = 1 the first action moves by a tenth of a millimetre."""
DRAWN = 300
"""Ends of successful episodes in a picture, at most."""


@dataclass
class FailurePlacesConfig:
    """Compares where episodes of direct transfer end, cause by cause, with what the energy's slope is there."""

    robots: list[str] = field(default_factory=lambda: list(TASK_ARMS[1:]))
    """Target arms, as in robots=[ur3,ur5]."""
    settings: list[str] = field(default_factory=lambda: list(SETTINGS))
    """Settings of the arms, also with another wrist or base; those without stored episodes are left out."""
    episodes: str = "results"
    """Folder under which episodes.parquet are read, of test seeds (100000 on) and lambda = 0."""
    output_dir: str = "results"
    """Folder of failure_places.md; the figure goes to its folder figures."""
    workers: int = 2
    """Processes that sample for maps that are not in the cache. A whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)

    def __post_init__(self) -> None:
        check_targets(self.robots)
        for name in self.settings or [None]:
            check_setting(name in SETTINGS, "settings", name, ", ".join(SETTINGS))
        check_setting(self.workers >= 1, "workers", self.workers, "a whole number >= 1")
        check_folder(self.output_dir)


def main(config: FailurePlacesConfig) -> None:
    """Write the table and the figure from the stored episodes; maps come from the cache, or are built first."""
    import pandas as pd
    from rich.console import Console

    from benchmark.arm import arm_columns, of_arm, setting_text, stored_arms
    from benchmark.build_maps import energy_field
    from benchmark.config import FIRST_TEST_SEED
    from benchmark.feasibility_field import feasibility_field
    from benchmark.known_policies import shipped
    from benchmark.ranking import PAPER, as_usual, counted, counted_by_any
    from benchmark.trusted_rows import read_all_episodes
    from richmap.robots import load_robot

    console, output_dir = Console(), Path(config.output_dir)
    episodes = as_usual(counted_by_any(read_all_episodes(Path(config.episodes), FIRST_TEST_SEED), shipped()))
    tables, curves, drawn = [], [], []
    for arm in stored_arms(episodes, config.robots, config.settings):
        rows = of_arm(episodes, arm)
        about = {"robot": arm.robot, "setting": setting_text(arm_columns(arm))}
        energy, _ = energy_field(load_robot(arm.robot), arm.base, config.map, config.energy, config.workers, console)
        distance, _ = feasibility_field(arm, console)
        ends = ends_of(rows[rows.method == "direct"], arm, energy, distance)
        tables.append(by_cause(ends).assign(**about))
        drawn.append((arm, energy, ends))
        of_field = (rows.method == "paper") & (rows.cell_size == config.map.cell_size)
        curve = counted(rows[(rows.method == "direct") | of_field], PAPER, shipped())
        if curve["lambda"].nunique() > 1:
            scaled = ends_of(curve, arm, energy, distance).assign(scale=curve["lambda"].to_numpy())
            curves.append(along_scale(scaled).assign(**about))
    if not drawn:
        raise SettingError(
            f"{config.episodes} holds no episodes of direct transfer on test seeds of {', '.join(config.robots)}. "
            "Make them: python -m benchmark.run -m experiment=transfer"
        )
    for ending in ("svg", "png"):
        with replacing(output_dir / "figures" / f"failure_places.{ending}") as path:
            places_figure(drawn).savefig(path, dpi=110)
    with replacing(output_dir / "failure_places.md") as path:
        path.write_text(markdown(pd.concat(tables, ignore_index=True), curves))
    console.print(f"Table: {output_dir / 'failure_places.md'}", soft_wrap=True)


def ends_of(
    episodes: "pd.DataFrame", arm: "ArmSetting", energy: "EnergyField", distance: "EnergyField"
) -> "pd.DataFrame":
    """Where each episode ends, and what guidance would do there.

    Args:
        episodes: Rows with `failure_cause`, and the flange's path in [mm] in `path_x` and `path_y`.
        arm: The arm as it stood.
        energy: The field in the world frame.
        distance: That to the border of what the arm can hold, above 0 beyond it, in [m], likewise.

    Returns:
        A row per episode: its cause; `x`, `y` and the distance `radius` from the base's axis, in [m]; whether that is
        at the `border`; there the energy, the length `slope` of its gradient in the plane and how guidance pushes
        `outward`, -∂E/∂R, both in [1/m]; and the least distance from the base's axis of the whole episode, `nearest`,
        and the push outward there, `outward_nearest`.
    """
    import pandas as pd

    from envs.arms import HEIGHT

    def outward(xy: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        from_base = xy - np.array(arm.base[:2])
        return -(gradient[:, :2] * from_base).sum(1) / np.linalg.norm(from_base, axis=1)

    paths = [np.column_stack([x, y]) / 1000 for x, y in zip(episodes.path_x, episodes.path_y, strict=True)]
    radii = [np.linalg.norm(path - np.array(arm.base[:2]), axis=1) for path in paths]
    xy = np.array([path[-LAST:].mean(axis=0) for path in paths])
    nearest = np.array([path[radius.argmin()] for path, radius in zip(paths, radii, strict=True)])
    flange = np.insert(xy, 2, HEIGHT, axis=1)
    value, gradient = energy.value_and_gradient(flange)
    return pd.DataFrame(
        {
            "cause": episodes.failure_cause.fillna(PLACED).to_numpy(dtype=object),
            "x": xy[:, 0],
            "y": xy[:, 1],
            "radius": np.linalg.norm(xy - np.array(arm.base[:2]), axis=1),
            "border": distance.value_and_gradient(flange)[0] > -AT_BORDER,
            "energy": value,
            "slope": np.linalg.norm(gradient[:, :2], axis=1),
            "outward": outward(xy, gradient),
            "nearest": [radius.min() for radius in radii],
            "outward_nearest": outward(nearest, energy.gradient(np.insert(nearest, 2, HEIGHT, axis=1))),
        }
    )


def by_cause(ends: "pd.DataFrame") -> "pd.DataFrame":
    """For each cause the number of episodes, how many of them end at the border, median and tenth to ninetieth
    percentile of the rest that `ends_of` gives, and the share where the field is flat; the most frequent cause first,
    successes last."""
    import pandas as pd

    rows = []
    order = [cause for cause in ends.cause.value_counts().index if cause != PLACED]
    for cause in [*order, *([PLACED] if (ends.cause == PLACED).any() else [])]:
        group = ends[ends.cause == cause]
        row = {"cause": cause, "n": len(group), "border": group.border.sum(), "flat": (group.slope < FLAT).mean()}
        for name in ("radius", "energy", "slope", "outward", "nearest", "outward_nearest"):
            low, row[name], high = np.quantile(group[name], [0.1, 0.5, 0.9])
            row |= {f"{name}_low": low, f"{name}_high": high}
        rows.append(row)
    return pd.DataFrame(rows)


def along_scale(ends: "pd.DataFrame") -> "pd.DataFrame":
    """For each λ: episodes, those that failed, those of them that end at the border, and failures by cause."""
    import pandas as pd

    rows = []
    for scale, group in ends.groupby("scale"):
        failed = group[group.cause != PLACED]
        row = {"scale": scale, "n": len(group), "failed": len(failed), "border": failed.border.sum()}
        rows.append(row | {"causes": failed.groupby("cause").border.agg(["size", "sum"]).sort_values("size")[::-1]})
    return pd.DataFrame(rows)


TEXT = """# Does guidance act where the failures are?

Made by `python -m benchmark.failure_places` from the stored episodes of direct transfer (λ = 0, test seeds): where the
flange is in an episode's last second, and what the energy's slope is there. Medians, in brackets the tenth and the
ninetieth percentile of the episodes. *R*: distance from the base's axis. *Outward*: how λ∇E pushes along it, -∂E/∂R;
below 0 it pulls inward. *Flat*: share of the episodes that end where the slope is below {flat:g} per metre, so that
guidance does nothing. *Nearest R*: the least of the whole episode, and the push outward there; what an arm runs into
near its base it may leave again before the episode ends. *At the border*: how many end no farther than {border:g} m
inside of what the arm can hold, or beyond it. A cause says what came first (`envs/failure.py`): a policy that stands
still before a block is `dithering` also where the arm could not reach behind that block.

{table}
{curves}

![where episodes end, over the energy](figures/failure_places.png)

Colour: energy, bright where the arms differ; arrows: where guidance pushes; dots: where episodes of direct transfer
end.
"""


def markdown(table: "pd.DataFrame", curves: "list[pd.DataFrame]") -> str:
    """The document: the tables of all arms by cause, one below the other, and those by scale, one for each arm."""
    import pandas as pd

    from benchmark.scores import causes_text

    def spread(name: str, form: str) -> list[str]:
        columns = (name, f"{name}_low", f"{name}_high")
        return [
            f"{value:{form}} [{low:{form}}, {high:{form}}]"
            for value, low, high in zip(*(table[c] for c in columns), strict=True)
        ]

    shown = pd.DataFrame(
        {
            "arm": table.robot,
            "setting": table.setting,
            "ended by": table.cause,
            "n": table.n,
            "at the border": table.border,
            "R [m]": spread("radius", ".3f"),
            "E": spread("energy", ".3f"),
            "slope [1/m]": spread("slope", ".3f"),
            "outward [1/m]": spread("outward", "+.3f"),
            "nearest R [m]": spread("nearest", ".3f"),
            "outward there [1/m]": spread("outward_nearest", "+.3f"),
            "flat [%]": (100 * table.flat).map("{:.0f}".format),
        }
    )
    parts = []
    for curve in curves:
        causes = [{c: f"{n} ({border})" for c, n, border in of.itertuples()} for of in curve.causes]
        shown_curve = pd.DataFrame(
            {
                "λ": curve.scale,
                "n": curve.n,
                "failed": curve.failed,
                "of these at the border": curve.border,
                "by cause (of these at the border)": [causes_text(each) for each in causes],
            }
        )
        title = f"With λ∇E on the {curve.robot[0]}, setting {curve.setting[0]}:"
        parts.append(f"\n{title}\n\n{shown_curve.to_markdown(index=False)}\n")
    table = shown.to_markdown(index=False, disable_numparse=True)
    return TEXT.format(flat=FLAT, border=AT_BORDER, table=table, curves="".join(parts))


def places_figure(drawn: "list[tuple[ArmSetting, EnergyField, pd.DataFrame]]") -> "Figure":
    """An arm as it stood in each panel: energy at the flange's height, where guidance pushes, where episodes end."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    from benchmark.arm import arm_columns, setting_text
    from benchmark.top_view import annotate, slope_over_table
    from envs.arms import HEIGHT
    from envs.failure import CAUSES

    columns = min(3, len(drawn))
    lines = -(-len(drawn) // columns)
    figure = Figure(figsize=(4.0 * columns, 4.1 * lines + 0.7), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False, sharex=True, sharey=True).ravel()
    colours = dict(zip(CAUSES, _COLOURS, strict=True))
    for ax, (arm, energy, ends) in zip(panels, drawn, strict=False):
        points, slope = slope_over_table(energy, HEIGHT)
        flange = np.insert(points, 2, HEIGHT, axis=-1).reshape(-1, 3)
        value = energy.value_and_gradient(flange)[0].reshape(points.shape[:2])
        mesh = ax.pcolormesh(*points.T, value.T, cmap="Greys_r", vmin=0, rasterized=True)
        every = (slice(None, None, 6),) * 2
        pushed = np.where(np.linalg.norm(slope, axis=-1, keepdims=True) > FLAT, -slope, np.nan)[every]
        ax.quiver(*points[every].T, *pushed.T, color="tab:cyan", angles="xy", scale=6, width=3e-3)
        annotate(ax, arm)
        placed = ends[ends.cause == PLACED].head(DRAWN)
        ax.plot(placed.x, placed.y, ".", color="tab:green", markersize=2, alpha=0.5)
        for cause, group in ends[ends.cause != PLACED].groupby("cause"):
            ax.plot(group.x, group.y, ".", color=colours[cause], markersize=5)
        ax.set(title=f"{arm.robot}, {setting_text(arm_columns(arm))}", xlabel="x [m]", ylabel="y [m]")
        ax.label_outer()
        figure.colorbar(mesh, ax=ax, label="E", shrink=0.7)
    for ax in panels[len(drawn) :]:
        ax.set_axis_off()
    present = [cause for cause in CAUSES if any((ends.cause == cause).any() for _, _, ends in drawn)]
    dots = [Line2D([], [], marker=".", linestyle="", color=colours[cause], label=cause) for cause in present]
    dots.append(Line2D([], [], marker=".", linestyle="", color="tab:green", label=PLACED))
    figure.legend(handles=dots, loc="outside lower center", ncol=5, fontsize=8, frameon=False)
    return figure


_COLOURS = (
    "red",
    "magenta",
    "purple",
    "hotpink",
    "brown",
    "gold",
    "tan",
    "navy",
    "deepskyblue",
    "blue",
    "orange",
    "olive",
)
"""Of the causes of failure, in their order."""


if __name__ == "__main__":
    run_command(main, FailurePlacesConfig, "failure_places")
