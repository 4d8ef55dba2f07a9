"""Figures of guidance: what each method asks for over the table, and success against its scale."""

import math
import textwrap
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from envs.task import Task
    from policies.guidance import Guidance
    from richmap.task_spaces.flange_steps import FlangeSteps

SPACING = 0.04
"""Between arrows, in [m]."""
PANELS = 4
"""Side by side."""
LEAST_WIDTH = 5.5
"""Of a figure, in inches: its title needs it."""


def draw_success(table: "pd.DataFrame", task: "Task") -> "Figure":
    """For each method of one arm the score that ranks against its scale, with 95 % intervals, beside direct transfer.

    Args:
        table: Rows of `benchmark.scoring.scale_table.scale_table`.
        task: What they are of.
    """
    name, direct = task.ranking[0], table[table.method == "direct"].iloc[0]
    curves = [
        rows
        for method in _order(table.method)
        for _, rows in table[table.method == method].groupby(["field_fingerprint", "entry_hash"])
        if method != "direct"
    ]
    figure, panels = _panels(len(curves), 2.6, sharey=True)
    for ax, rows in zip(panels, curves, strict=True):
        ax.axhspan(100 * direct[f"{name}_low"], 100 * direct[f"{name}_high"], color="0.9")
        ax.axhline(100 * direct[name], color="0.5", linewidth=1, label="direct transfer")
        low, high = 100 * rows[f"{name}_low"], 100 * rows[f"{name}_high"]
        ax.fill_between(rows["lambda"], low, high, alpha=0.25)
        if len(rows) == 1:  # Between one point and itself nothing is filled.
            ax.vlines(rows["lambda"], low, high, alpha=0.5)
        ax.plot(rows["lambda"], 100 * rows[name], ".-", label="with guidance")
        chosen = rows[rows.chosen]
        ax.plot(chosen["lambda"], 100 * chosen[name], "*", color="black", markersize=9, label="chosen")
        ax.set_xscale("log", base=2)
        ax.set_xticks(rows["lambda"], [f"{scale:g}" for scale in rows["lambda"]], rotation=60, fontsize="x-small")
        ax.set(title=method_and_cells(rows.iloc[0]), ylim=(0, 102))
    for ax in panels[::PANELS]:
        ax.set_ylabel(f"{name} [%]")
    figure.supxlabel("scale λ, in each method's own unit")
    title = f"{direct.robot}, {direct.setting}: {_text_of(task, name)}, n = {direct.n} a point"
    figure.suptitle(textwrap.fill(title, 26 * min(PANELS, len(curves))), fontsize="medium")
    panels[0].legend(fontsize="x-small", loc="lower left")
    return figure


def _text_of(task: "Task", name: str) -> str:
    """What a score of a task is."""
    return next(score.text for score in task.scores if score.name == name)


def draw_fields(
    guidances: "dict[str, Guidance]", base: tuple[float, float], path: np.ndarray, steps: "FlangeSteps"
) -> "Figure":
    """Where each method moves actions, as arrows over the table, above the demonstrations' path.

    Arrows are as long as the spacing where a method asks for most along that path; beyond, they grow no further.
    `reorder` moves no action; its panel shows the places that a push must not lead the tool to.

    Args:
        guidances: Methods by name, with their scales.
        base: Position of the arm's base, x and y in [m].
        path: Flange positions of demonstrations, (n, 3) in [m].
        steps: Of a task whose actions move the flange over the table.
    """
    from policies.block_push.reorder import Reorder

    x, y = np.arange(0.16, 0.71, SPACING), np.arange(-0.48, 0.49, SPACING)
    points = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    names = _order(guidances)
    visited = cKDTree(path[:, :2]).query(points)[0] < SPACING
    figure, panels = _panels(len(names), 4.2, sharex=True, sharey=True)
    for ax, name in zip(panels, names, strict=True):
        ax.plot(*path[:, :2].T, ".", color="0.7", markersize=1.5)
        ax.plot(*base, "s", color="black")
        ax.set(title=name, aspect="equal", xlim=(min(-0.05, base[0] - 0.05), 0.72), ylim=(-0.52, 0.52))
        if isinstance(guidances[name], Reorder):
            outside = guidances[name].margin + guidances[name].distance.value_and_gradient(steps.positions(points))[0]
            ax.contourf(x, y, outside.reshape(len(x), len(y)).T, (0, np.inf), colors="tab:blue", alpha=0.3)
            ax.set_title("reorder: pushes that lead\nthe tool here come last", fontsize="small")
            continue
        asked = asked_for(guidances[name], points, steps)
        length = np.linalg.norm(asked, axis=1) + 1e-12
        longest = length[visited].max() if length[visited].max() > 1e-3 * length.max() else length.max()
        moved = length > 0.02 * longest
        asked *= (np.minimum(length / longest, 1) / length)[:, None]
        ax.quiver(
            *points[moved].T, *asked[moved].T, angles="xy", scale_units="xy", scale=1 / SPACING, width=0.006,
            color="tab:blue",
        )  # fmt: skip
    figure.supxlabel("x [m]")
    figure.supylabel("y [m]")
    figure.suptitle("Where methods move actions, each in its own unit\n(grey: demonstrations; square: the arm's base)")
    return figure


def asked_for(guidance: "Guidance", points: np.ndarray, steps: "FlangeSteps") -> np.ndarray:
    """Direction, (n, 2), in which a method moves actions where the effector stands still at points, xy in [m].

    Lengths compare within a method only.
    """
    import torch

    state = torch.tensor(np.hstack([points, points]), dtype=torch.float64)
    still = torch.zeros(len(points), 1, 2, dtype=torch.float64)
    push = guidance.push(state)
    if push is not None:
        return -push.numpy()
    if guidance.looks_ahead:
        return -guidance.descent(still, state)[:, 0].numpy()
    if guidance.samples > 1:  # The sample that it leads to is the one that is furthest down.
        return -guidance.field.gradient(steps.positions(points)) @ steps.jacobian[:3]
    return guidance.correct(still, state)[:, 0].numpy()


def method_and_cells(row: "pd.Series") -> str:
    """What a row's method is called, with the cells of the field that it looks at."""
    return row.method if math.isnan(row.cell_size) else f"{row.method}, cells {row.cell_size:g} m"


def _order(names: Iterable[str]) -> list[str]:
    from policies.methods import METHODS

    return [*sorted({*names} - {*METHODS}), *(name for name in METHODS if name in {*names})]


def _panels(number: int, height: float, **options: object) -> tuple["Figure", list]:
    """A figure with that many panels, a few side by side."""
    from matplotlib.figure import Figure

    columns = min(PANELS, number)
    rows = math.ceil(number / columns)
    figure = Figure(figsize=(max(3.1 * columns + 0.6, LEAST_WIDTH), height * rows + 0.8), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, **options).ravel()
    for ax in panels[number:]:
        ax.remove()
    return figure, list(panels[:number])
