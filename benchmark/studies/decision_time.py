"""How long methods take to decide: time of the processor per control step, at the scale that was chosen for each.

python -m benchmark.studies.decision_time
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.settings.chosen_scales import USUAL_FOLDER, chosen_scales
from benchmark.settings.command import run_command
from benchmark.settings.config import RunConfig
from benchmark.settings.paths import check_file
from benchmark.settings.scenes import VALIDATION, check_scenes
from benchmark.settings.setting import check_choice, check_counts, check_setting
from benchmark.settings.task import chosen_task
from policies.methods import GUIDED

if TYPE_CHECKING:
    from benchmark.rollouts.rollout import Rollout


@dataclass
class DecisionTimeConfig:
    """Which tasks' methods are timed, on which arm, and on how many episodes."""

    tasks: list[str] = field(default_factory=lambda: ["block_push", "press_buttons"])
    """Tasks, as in tasks=[block_push]."""
    methods: list[str] = field(default_factory=list)
    """Methods, as in methods=[eadp]; empty for direct transfer and all that have a scale in scales_dir."""
    scale: float | None = None
    """Of these methods; null for that in scales_dir."""
    robot: str = "ur3"
    """An arm that ships, where it usually stands."""
    episodes: int = 5
    """Validation scenes, one at a time, after one that does not count; a whole number >= 1."""
    scales_dir: str = USUAL_FOLDER
    """Folder of the chosen scales."""
    output: str = "results/decision_times.csv"
    """Table that rows go to, in place of older ones of the same task, method and scale."""
    workers: int = 2
    """Processes that sample, where a method's map is to be built."""

    def __post_init__(self) -> None:
        for name in self.tasks:
            chosen_task(name)
        for name in self.methods:
            check_choice("methods", name, GUIDED)
        check_setting(self.scale is None or bool(self.methods), "scale", self.scale, "null without methods")
        check_counts(self, "episodes")
        check_scenes(VALIDATION.start, self.episodes + 1)
        check_file(self.output)


def main(config: DecisionTimeConfig) -> None:
    """Time each method, and store and print the table."""
    import pandas as pd

    from benchmark.artifacts.known_policies import checkpoint_folder
    from benchmark.artifacts.outputs import store_rows
    from benchmark.rollouts.make_rollout import make_rollout
    from benchmark.scoring.decision_time import KEY
    from benchmark.settings.robot_config import RobotConfig
    from richmap.progress import plain_console

    console, rows = plain_console(), []
    for task in config.tasks:
        chosen = chosen_scales(config.scales_dir, task)
        scales = {"direct": 0.0} | {name: float(said["scale"]) for name, said in chosen.items() if said["scale"]}
        for name in config.methods:
            known = config.scale is not None or name in scales
            check_setting(known, "methods", name, f"with scale=null one of {', '.join(scales)}, in {task}")
        if config.methods:
            scales = {name: scales[name] if config.scale is None else config.scale for name in config.methods}
        for method, scale in scales.items():
            run = RunConfig(
                RobotConfig(config.robot), task, scale, method, device="cpu", batch_size=1, workers=config.workers
            )
            rollout = make_rollout(run, scale, checkpoint_folder(run.seed, task=task), console)
            rows.append({"task": task, "method": method, "lambda": scale, **timed(rollout, config.episodes)})
    table = store_rows(Path(config.output), pd.DataFrame(rows), KEY)
    console.print(table.to_markdown(index=False), soft_wrap=True)


def timed(rollout: "Rollout", episodes: int) -> dict[str, object]:
    """Time of the processor that the policy takes for an action, of one thread: mean and longest, in [ms]."""
    from time import process_time

    from benchmark.rollouts.rollout import load_policy

    policy, spent = load_policy(rollout), list[float]()
    act = policy.select_action

    def watched(*arguments: object, **named: object) -> object:
        begun = process_time()
        action = act(*arguments, **named)  # type: ignore[arg-type]
        spent.append(process_time() - begun)
        return action

    rollout.play([VALIDATION.start])  # Loops are compiled here.
    policy.select_action = watched  # type: ignore[method-assign, assignment]
    for seed in VALIDATION[1 : episodes + 1]:
        rollout.play([seed])
    load_policy.cache_clear()
    steps = len(spent)
    mean, longest = 1e3 * sum(spent) / steps, 1e3 * max(spent)
    return {"robot": rollout.arm.robot, "steps": steps, "mean_ms": round(mean, 2), "longest_ms": round(longest, 1)}


if __name__ == "__main__":
    run_command(main, DecisionTimeConfig, "studies.decision_time")
