"""The value of an arm: how episodes end on it, learnt from whole ones that are imagined on its kinematic twin.

python -m benchmark.learn_value task=press_buttons robot=ur3
"""

from dataclasses import dataclass, field
from pathlib import Path

from benchmark.settings.command import run_command
from benchmark.settings.config import RunConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.recipe import USUAL, check_recipe
from benchmark.settings.robot_config import ArmConfig, RobotConfig, robot_field
from benchmark.settings.scenes import IMAGINED
from benchmark.settings.setting import SettingError, check_choice, check_counts, check_setting
from benchmark.settings.task import chosen_task
from richmap.robots import SETTINGS


@dataclass
class LearnValueConfig:
    """Learns the value of an arm, by which method=value_on_arm chooses, and puts it in the cache."""

    robot: RobotConfig = robot_field("ur3")
    """Arm: one that ships, or custom."""
    task: str = "press_buttons"
    """What is to be done: press_buttons."""
    setting: str = "embodied"
    """What the arm may do (see benchmark.run)."""
    recipe: str = USUAL
    """What the policies that act learned from (see benchmark.run)."""
    seeds: list[int] = field(default_factory=lambda: [42, 43, 44])
    """Training seeds of the policies that act in the imagined episodes, in each scene another one."""
    scenes: int = 2000
    """Scenes of each round, every fifth of which is not learnt from; they are drawn from seeds from 60000 to 99999."""
    each: int = 1
    """Episodes in each scene, by one policy after another; a whole number >= 1."""
    rounds: int = 0
    """Further rounds, each of as many scenes, in which the value learnt before chooses; a whole number >= 0."""
    samples: int = 16
    """Chunks of which it chooses one then; a whole number >= 1."""
    steps: int = 100
    """Of training; a whole number >= 1."""
    seed: int = 0
    """Of training, a whole number >= 0."""
    output_dir: str = "outputs/values"
    """Folder of what is imagined, from which a run that was killed goes on."""
    workers: int = 2
    """Processes that imagine; the value does not depend on it. A whole number >= 1."""
    arm: ArmConfig = field(default_factory=ArmConfig)

    def __post_init__(self) -> None:
        task = chosen_task(self.task)
        check_setting(task.name == "press_buttons" and task.model is not None, "task", self.task, "press_buttons")
        check_choice("setting", self.setting, SETTINGS)
        check_recipe(self.recipe)
        own = bool(self.seeds) and len({*self.seeds}) == len(self.seeds)
        check_setting(own, "seeds", self.seeds, "different training seeds, as in seeds=[42,43]")
        check_counts(self, "each", "samples", "steps", "workers")
        for name in ("rounds", "seed"):
            check_setting(getattr(self, name) >= 0, name, getattr(self, name), "a whole number >= 0")
        check_setting(self.scenes >= 10, "scenes", self.scenes, "a whole number >= 10")
        drawn = self.scenes * (self.rounds + 1)
        check_setting(drawn <= len(IMAGINED), "scenes", self.scenes, f"{len(IMAGINED)} at most in all rounds")
        check_folder(self.output_dir)


def main(config: LearnValueConfig) -> None:
    """Learn it, and say how well it tells the ends of episodes."""
    from benchmark.artifacts.arm_values import value_file
    from benchmark.artifacts.known_policies import checkpoint_folder
    from benchmark.episodes.arm import chosen_arm
    from benchmark.rollouts.value_learning import Learning, learn_value

    task = chosen_task(config.task)
    run = RunConfig(robot=config.robot, task=config.task, setting=config.setting, arm=config.arm)
    arm = chosen_arm(run, task)
    checkpoints = tuple(checkpoint_folder(seed, 1, config.recipe, config.task) for seed in config.seeds)
    value, quality = learn_value(
        Learning(
            task, arm, checkpoints, config.scenes, config.each, config.rounds, config.samples, config.steps,
            config.seed, Path(config.output_dir), config.workers,
        )
    )  # fmt: skip
    file = value_file(arm)
    try:
        value.save(file)
    except OSError as error:
        raise SettingError(f"{file} cannot be written ({error.strerror}). Choose another XDG_CACHE_HOME.") from error
    print(f"{arm.robot}: {quality}.\nValue: {file}")


if __name__ == "__main__":
    run_command(main, LearnValueConfig, "learn_value", goes_on=True)
