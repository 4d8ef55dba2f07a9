"""Success against the scale of guidance, arm by arm and method by method, with intervals.

python -m benchmark.lambda_curves
python -m benchmark.lambda_curves recipe=clean
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.command import SettingError, run_command
from benchmark.config import FIRST_TEST_SEED, TASK_ARMS
from benchmark.outputs import replacing
from benchmark.recipe import SHIPPED, USUAL, check_recipe, recipe_folder

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

NAMES = {"score": "Score", "p2": "Both blocks placed (p2)"}
"""What is drawn, a row each."""


@dataclass
class LambdaCurvesConfig:
    """Draws score and p2 against lambda from the stored test episodes of the paper's protocol, beside its figures."""

    recipe: str = USUAL
    """Whose episodes are drawn (see benchmark.leaderboard)."""
    output_dir: str = "results"
    """Folder below which every episodes.parquet is read; figures/success_against_lambda.svg and .png go to it, for
    clean to its folder clean."""

    def __post_init__(self) -> None:
        check_recipe(self.recipe, SHIPPED)


def main(config: LambdaCurvesConfig) -> None:
    """Draw what is stored."""
    import pandas as pd

    from benchmark.arm import of_arm
    from benchmark.known_policies import shipped
    from benchmark.ranking import PAPER, as_usual, counted, leaderboard
    from benchmark.trusted_rows import read_all_episodes
    from envs.arms import arm_setting

    every = read_all_episodes(Path(config.output_dir), FIRST_TEST_SEED)
    rows = as_usual(counted(every, PAPER, shipped(config.recipe)))
    episodes = pd.concat([of_arm(rows, arm_setting(robot, *PAPER.settings)) for robot in TASK_ARMS])
    if episodes.empty:
        raise SettingError(
            f"There are no test episodes of the paper's protocol under {config.output_dir}. Make some: "
            f"python -m benchmark.run -m experiment=transfer recipe={config.recipe}"
        )
    figure = curves(leaderboard(episodes, PAPER))
    for ending in ("svg", "png"):
        folder = recipe_folder(Path(config.output_dir), config.recipe)
        file = folder / "figures" / f"success_against_lambda.{ending}"
        with replacing(file) as path:
            figure.savefig(path, dpi=150)
        print(file)


def curves(table: "pd.DataFrame") -> "Figure":
    """A column per arm; a line per method and size of cells, of one colour in all panels, from direct transfer at 0 on;
    the paper's figures as dashes. A scale is in its method's own unit.

    Args:
        table: `benchmark.ranking.leaderboard` by the paper's protocol.
    """
    import numpy as np
    import pandas as pd
    from matplotlib.figure import Figure

    from benchmark.guidance_figures import method_and_cells
    from benchmark.published import TABLE_3

    arms = [robot for robot in TASK_ARMS if robot in set(table.robot)]
    table = table.assign(line=[method_and_cells(row) for _, row in table.iterrows()])
    colors = {name: f"C{number}" for number, name in enumerate(table.sort_values("method").line.unique())}
    figure = Figure(figsize=(3.2 * len(arms) + 0.6, 2.6 * len(NAMES) + 0.4), layout="constrained")
    panels = figure.subplots(len(NAMES), len(arms), squeeze=False, sharex=True, sharey="row")
    for line, (name, title) in zip(panels, NAMES.items(), strict=True):
        for ax, robot in zip(line, arms, strict=True):
            of_arm = table[table.robot == robot]
            direct, guided = of_arm[of_arm.method == "direct"], of_arm[of_arm.method != "direct"]
            for of_method in [rows for _, rows in guided.groupby(["line", "field_fingerprint"])] or [direct]:
                rows = of_method if of_method is direct else pd.concat([direct, of_method]).sort_values("lambda")
                low, high = (100 * rows[f"{name}_{end}"].to_numpy(float) for end in ("low", "high"))
                mean, what = 100 * rows[name].to_numpy(float), of_method.line.iloc[0]
                ax.errorbar(
                    rows["lambda"], mean, np.stack([mean - low, high - mean]), marker="o", markersize=3, linewidth=1,
                    elinewidth=0.6, color=colors[what], label=f"{what}: mean of the policies, 95 % interval",
                )  # fmt: skip
                least, most = (100 * rows[f"{name}_{end}"].to_numpy(float) for end in ("least", "most"))
                ax.plot(rows["lambda"], least, color="0.5", linewidth=0.6)
                ax.plot(rows["lambda"], most, color="0.5", linewidth=0.6, label="least and most of any policy")
            if name == "score":
                published = {"published, direct": TABLE_3[robot].direct, "published, guided": TABLE_3[robot].guided}
                for (label, figures), dash in zip(published.items(), (":", "--"), strict=True):
                    if figures is not None:
                        ax.axhline(100 * figures[0], color="k", linewidth=0.8, linestyle=dash, label=label)
            n = f"n = {direct.n.iloc[0]} each" if len(direct) else ""
            ax.set(title=f"{robot}, {n}", xlabel="λ, or scale of the method")
            ax.grid(alpha=0.3)
        line[0].set_ylim(top=101)  # Of the whole row, so not before all is drawn: it ends the search for the bottom.
        line[0].set_ylabel(f"{title} [%]")
    if (farthest := table["lambda"].max()) > 1:  # Beyond the paper's range they double.
        ticks = [0, 0.2, 0.4, 0.6, 0.8, *2 ** np.arange(np.log2(farthest) + 0.5)]
        for ax in panels.flat:
            ax.set_xscale("symlog", linthresh=1, linscale=2)
            ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
            ax.set_xlim(-0.05, 1.15 * farthest)
            ax.xaxis.minorticks_off()
    shown = dict(pair[::-1] for ax in panels.flat for pair in zip(*ax.get_legend_handles_labels(), strict=True))
    figure.legend(shown.values(), shown, fontsize=6, loc="outside lower center", ncols=3)
    return figure


if __name__ == "__main__":
    run_command(main, LambdaCurvesConfig, "lambda_curves")
