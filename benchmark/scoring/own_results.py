"""What a folder of episodes, a sweep, an entry or scales come to: a table by method, scale and arm, and curves."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmark.scoring.text_table import text_table
from benchmark.settings.config import ORACLE_METHODS

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from envs.task import Task

CURVES = "curves.png"
"""Beside the rows."""

PANELS = 3
"""Side by side."""

MOST_TICKS = 12
"""Scales that are written under a panel; of more, powers of two."""


def show_results(episodes: "pd.DataFrame", task: "Task", folder: Path) -> None:
    """Print the table of some episodes, and draw their curves into a folder, if there is more than direct transfer."""
    from benchmark.scoring.scale_table import scale_table
    from richmap.outputs import replacing

    table = scale_table(episodes, task)
    print(results_text(table, task))
    if (table["lambda"] > 0).any():
        file = folder / CURVES
        with replacing(file) as path:
            draw_curves(table, task).savefig(path, dpi=100)
        print(f"Curves: {file}")


def results_text(table: "pd.DataFrame", task: "Task", width: int | None = None) -> str:
    """The table for people: arm after arm, method and scale in a line, with paired differences to direct transfer.

    Args:
        table: Rows of `benchmark.scoring.scale_table.scale_table`.
        task: What they are of.
        width: In characters; the terminal's if None.
    """
    from benchmark.scoring.scores import difference_text, with_interval

    name, parts = task.ranking[0], []
    for arm, group in _by_arm(table):
        lines = [
            [
                _method(row, group),
                f"{row['lambda']:g}",
                str(row.n),
                with_interval(row, name),
                "" if row.method == "direct" else difference_text(row, f"{name}_difference"),
            ]
            for _, row in group.sort_values(["method", "lambda"], key=_direct_first).iterrows()
        ]
        n, oracles = group.checkpoints.max(), group.method.isin(ORACLE_METHODS.values()).all()
        policies = "no policy" if oracles else "1 policy" if n == 1 else f"{n} policies"
        parts += [
            f"{arm}; {policies}. {name} in percent, minus direct in points,",
            "both with 95 % intervals for other trainings and scenes.",
            text_table(["method", "lambda", "n", name, "minus direct"], lines, width),
            "",
        ]
    return "\n".join(parts).rstrip()


def draw_curves(table: "pd.DataFrame", task: "Task") -> "Figure":
    """The score that ranks against the scale of each method, a panel for each arm, beside direct transfer.

    Args:
        table: Rows of `benchmark.scoring.scale_table.scale_table`.
        task: What they are of.
    """
    from matplotlib.figure import Figure

    name, arms = task.ranking[0], _by_arm(table)
    rows = -(-len(arms) // PANELS)
    figure = Figure(figsize=(4 * min(len(arms), PANELS), 3.2 * rows + 0.4), layout="constrained")
    panels = figure.subplots(rows, min(len(arms), PANELS), squeeze=False, sharey=True).ravel()
    for ax, (arm, group) in zip(panels, arms, strict=False):
        for _, direct in group[group.method == "direct"].iterrows():
            ax.axhspan(100 * direct[f"{name}_low"], 100 * direct[f"{name}_high"], color="0.9")
            ax.axhline(100 * direct[name], color="0.5", linewidth=1, label="direct")
        for _, curve in group[group["lambda"] > 0].groupby(["method", "field_fingerprint", "entry_hash"]):
            values, low, high = (100 * curve[key].to_numpy() for key in (name, f"{name}_low", f"{name}_high"))
            errors = np.stack([values - low, high - values]).clip(0)
            label = _method(curve.iloc[0], group)
            ax.errorbar(curve["lambda"].to_numpy(), values, errors, fmt=".-", capsize=2, linewidth=1, label=label)
        ax.set(title=arm, ylim=(0, 102), xlabel="scale λ, in each method's own unit")
        ax.title.set_fontsize("small")
        if (group["lambda"] > 0).any():
            ax.set_xscale("log", base=2)
            scales = sorted({*group["lambda"]} - {0})
            if len(scales) <= MOST_TICKS:
                ax.set_xticks(scales, [f"{scale:g}" for scale in scales], rotation=60, fontsize="x-small")
            ax.legend(fontsize="x-small")
    for ax in panels[len(arms) :]:
        ax.remove()
    for ax in panels[: len(arms) : PANELS]:
        ax.set_ylabel(f"{name} [%]")
    return figure


def _by_arm(table: "pd.DataFrame") -> "list[tuple[str, pd.DataFrame]]":
    """Rows of each arm as it stood and was sampled for, and what to call it."""
    from benchmark.episodes.arm import setting_text
    from benchmark.scoring.scale_table import CHOSEN_FOR

    arms = []
    for _, group in table.groupby(CHOSEN_FOR, sort=True):
        first = group.iloc[0]
        sampled = "" if first.sampler == "none" else f", {first.sampler}-{first.sampling_steps}"
        arms.append((f"{first.robot}, {setting_text(first)}{sampled}", group))
    return arms


def _method(row: "pd.Series", of_arm: "pd.DataFrame") -> str:
    """A method, with the cells of its field where it was run with several, and likewise what its files hash to."""
    alike = of_arm[of_arm.method == row.method]
    cells = f", {1000 * row.cell_size:g} mm" if alike.cell_size.nunique() > 1 else ""
    version = f", files {row.entry_hash[:8]}" if alike.entry_hash.nunique() > 1 else ""
    return f"{row.method}{cells}{version}"


def _direct_first(column: "pd.Series") -> "pd.Series":
    return column.where(column != "direct", "") if column.name == "method" else column
