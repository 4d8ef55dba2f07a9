"""How fast environments are: control steps per second of one core, with the scripted oracle at the helm.

python -m benchmark.studies.environment_speed
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from benchmark.settings.command import run_command
from benchmark.settings.scenes import VALIDATION, check_scenes
from benchmark.settings.setting import check_choice, check_counts
from benchmark.settings.task import chosen_task
from richmap.robots import ROBOTS

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from envs.task import Task


@dataclass
class EnvironmentSpeedConfig:
    """Which environments are timed, and on how many episodes."""

    tasks: list[str] = field(default_factory=lambda: ["block_push", "press_buttons"])
    """Tasks, as in tasks=[block_push]."""
    robots: list[str] = field(default_factory=lambda: ["xarm6", "ur3", "ur5", "ur10", "panda", "gen3"])
    """Arms that ship, where they usually stand."""
    episodes: int = 10
    """Validation scenes of each arm; a whole number >= 1."""

    def __post_init__(self) -> None:
        for name in self.robots:
            check_choice("robots", name, ROBOTS)
        check_counts(self, "episodes")
        check_scenes(VALIDATION.start, self.episodes)


def main(config: EnvironmentSpeedConfig) -> None:
    """Print a row for each task and arm; time is that of the processor in `step`, without the oracle's."""
    import pandas as pd

    from richmap.progress import plain_console

    tasks = [chosen_task(name) for name in config.tasks]
    rows = [timed(task, robot, config.episodes) for task in tasks for robot in config.robots]
    plain_console().print(pd.DataFrame(rows).round(2).to_markdown(index=False), soft_wrap=True)


def timed(task: "Task", robot: str, episodes: int) -> "dict[str, str | float]":
    """Control steps per second of an arm's environment, milliseconds of a reset, and seconds that the first environment
    took to make and another one."""
    from time import process_time

    from envs.arm.place_arm import place_arm
    from envs.task import play_oracle

    arm, spent = place_arm(robot, task.poses), {"made": [0.0], "reset": [0.0], "step": [0.0]}

    def watched(what: str, function: "Callable") -> "Callable":
        def call(*arguments: "Any", **named: "Any") -> "Any":
            begun = process_time()
            try:
                return function(*arguments, **named)
            finally:
                spent[what].append(process_time() - begun)

        return call

    env, another = (watched("made", task.make)(arm) for _ in range(2))
    another.close()
    make = task.oracle("plain")(arm)
    play_oracle(env, VALIDATION.start, make)  # Loops are compiled here.
    env.reset, env.step = watched("reset", env.reset), watched("step", env.step)  # type: ignore[method-assign]
    for seed in range(VALIDATION.start, VALIDATION.start + episodes):
        play_oracle(env, seed, make)
    env.close()
    _, first, second = spent["made"]
    return {
        "task": task.name,
        "robot": robot,
        "steps": len(spent["step"]) - 1,
        "steps per second": (len(spent["step"]) - 1) / sum(spent["step"]),
        "a reset, ms": 1e3 * sum(spent["reset"]) / (len(spent["reset"]) - 1),
        "the first environment, s": first,
        "another one, s": second,
    }


if __name__ == "__main__":
    run_command(main, EnvironmentSpeedConfig, "studies.environment_speed")
