"""The scale of each method of guidance: swept by factors of two on validation episodes, up to collapse.

python -m benchmark.scales robot=ur3 methods=[paper,feasibility]
"""

from benchmark.episodes.arm import alike, base_of
from benchmark.scoring.own_results import results_text
from benchmark.scoring.scale_table import CHOSEN_FOR, scale_table
from benchmark.settings.command import run_command
from benchmark.settings.task import chosen_task
from benchmark.sweeps.scale_sweep import ScalesConfig, budget, markdown, sweep, swept_methods
from policies.methods import DIRECT, METHODS
from richmap.outputs import replacing


def main(config: ScalesConfig) -> None:
    """Print the budget, roll out every scale that is not stored yet, and write table and figures."""
    from benchmark.artifacts.known_policies import checkpoint_folder

    checkpoints = [checkpoint_folder(seed, config.checkpoint, config.recipe, config.task) for seed in config.seeds]
    from benchmark.rollouts.arm_oracle import demonstrated_path
    from benchmark.rollouts.make_rollout import make_rollout
    from benchmark.scoring.guidance_figures import draw_fields, draw_success
    from richmap.progress import plain_console

    console, folder, task = plain_console(), config.folder, chosen_task(config.task)
    methods = swept_methods(config, console)
    console.print(budget(config, methods))
    direct = [
        make_rollout(config.run(seed), 0.0, path, console) for seed, path in zip(config.seeds, checkpoints, strict=True)
    ]
    table = scale_table(sweep(config, direct, methods, console), task)
    with replacing(folder / "scales.md") as path:
        path.write_text(markdown(table, task, methods))

    arm = alike(table, {name: getattr(direct[0].condition, name) for name in CHOSEN_FOR})
    base = base_of(direct[0].condition.row())[:2]
    chosen = {row["method"]: row["lambda"] for row in arm[arm.chosen].to_dict("records")}
    guidances = {
        method.name: method.make(chosen[method.name], base, config.seeds[0], task.space)
        for method in methods
        if method.name in chosen
    }
    drawn = {name: each for name, each in guidances.items() if each.samples == 1 or name in METHODS}
    figures = {
        "success_against_scale": draw_success(arm, task),
        "fields": draw_fields(drawn, base, demonstrated_path(task, 10, console), task.space.steps),
    }
    for name, figure in figures.items():
        file = folder / "figures" / f"{name}.png"
        with replacing(file) as path:
            figure.savefig(path, dpi=100)
        console.print(f"Figure: {file}", soft_wrap=True)
    print(results_text(arm, task))
    for method, scale in chosen.items():
        if method != DIRECT:
            print(f"Chosen: {method}, {scale:g}")
    console.print(f"Table: {folder / 'scales.md'}", soft_wrap=True)


if __name__ == "__main__":
    run_command(main, ScalesConfig, "scales", goes_on=True)
