"""Two policies on the same scenes, of LeRobot's evaluation or rolled out here: pairs, their difference, a test.

python -m benchmark.compare_policies outputs/eval/a/eval_info.json outputs/eval/b/eval_info.json
python -m benchmark.compare_policies a=outputs/act b=outputs/diffusion robot=ur3 episodes=200 stop_early=true
"""

from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.settings.command import run_command
from benchmark.settings.config import RunConfig
from benchmark.settings.robot_config import ArmConfig, RobotConfig, robot_field
from benchmark.settings.scenes import VALIDATION
from benchmark.settings.setting import SettingError, check_setting

if TYPE_CHECKING:
    import pandas as pd


@dataclass
class ComparePoliciesConfig:
    """Compares two policies on the same scenes."""

    a: str = ""
    """One policy: the eval_info.json of lerobot-eval, or its folder; or a LeRobot checkpoint, which is rolled out: its
    folder, its name on the Hub, or the name of one that ships, as seed42-1."""
    b: str = ""
    """The other one, likewise."""
    stop_early: bool = False
    """Whether rolling out ends as soon as it is clear which one is better, by a test that holds whenever one stops; of
    files, from which pair on it is clear. true or false."""
    alpha: float = 0.05
    """With stop_early: how often a difference may be found where there is none; from 0.0001 to 0.5."""
    robot: RobotConfig = robot_field("ur3")
    """Arm on which checkpoints are rolled out (see benchmark.run)."""
    task: str = "block_push"
    """What is to be done (see benchmark.run)."""
    setting: str = "embodied"
    """What the arm may do (see benchmark.run)."""
    episodes: int = 50
    """Number of scenes, or with stop_early the most; a whole number >= 1."""
    seed_start: int = VALIDATION.start
    """Seed of the first scene (see benchmark.run)."""
    batch_size: int = 10
    """Rows of the batch in which a policy is evaluated (see benchmark.run)."""
    device: str = "auto"
    """Where policies run: cpu, cuda, or auto (cuda if there is one)."""
    workers: int = 2
    """Processes that roll out; results do not depend on it. A whole number >= 1."""
    output_dir: str = "outputs/compare_policies"
    """Folder that episodes are stored in; what is there is not rolled out again."""
    arm: ArmConfig = field(default_factory=ArmConfig)

    def __post_init__(self) -> None:
        check_setting(0.0001 <= self.alpha <= 0.5, "alpha", self.alpha, "a number from 0.0001 to 0.5")
        if not is_evaluation(Path(self.a)):  # Files are read, and nothing is stored.
            self.run("")

    def run(self, policy: str) -> RunConfig:
        """Settings of a policy's rollouts."""
        names = {each.name for each in fields(RunConfig)} & {*vars(self)}
        return RunConfig(policy=policy, method="direct", **{name: getattr(self, name) for name in names})


def main(config: ComparePoliciesConfig) -> None:
    """Print the success of both on the same scenes, its paired difference with an interval, and a test on the pairs
    that differ. a and b may be given without their names. Settings from robot on are for checkpoints."""
    from benchmark.scoring.eval_info import read_eval_info
    from benchmark.scoring.two_policies import comparison_text, paired_episodes

    for name in "ab":
        allowed = "an eval_info.json, or a LeRobot checkpoint, as in a=outputs/act b=outputs/diffusion"
        check_setting(bool(getattr(config, name)), name, getattr(config, name), allowed)
    are_files = [is_evaluation(Path(given)) for given in (config.a, config.b)]
    if are_files[0] != are_files[1]:
        raise SettingError(
            f"a={config.a} and b={config.b} are a file and a checkpoint. Give two eval_info.json, or two checkpoints: "
            "python -m benchmark.show table=<folder> eval_info=<folder> writes stored episodes as such a file."
        )
    alpha = config.alpha if config.stop_early else None
    if are_files[0]:
        a, b = read_eval_info(Path(config.a)), read_eval_info(Path(config.b))
        pairs = paired_episodes(a, b)
        if not (a.attrs["seeded"] and b.attrs["seeded"]):
            print("LeRobot's file says no seeds: these are pairs if both ran with the same --env and --seed.")
        print(comparison_text(pairs, (config.a, config.b), alpha))
        return
    pairs = rolled_out(config)
    print(comparison_text(pairs, (config.a, config.b), alpha))
    print(f"Episodes: {config.output_dir}")


def is_evaluation(path: Path) -> bool:
    """Whether this is a file of an evaluation, or the folder of one; else it is to be a checkpoint."""
    return path.is_file() or path.suffix == ".json" or (path / "eval_info.json").is_file()


def rolled_out(config: ComparePoliciesConfig) -> "pd.DataFrame":
    """Pairs of episodes of both checkpoints; with stop_early batch after batch, until it is clear."""
    import pandas as pd

    from benchmark.artifacts.known_policies import policy_folder
    from benchmark.rollouts.make_rollout import make_rollout
    from benchmark.rollouts.missing_episodes import play_and_store
    from benchmark.scoring.anytime import first_clear
    from benchmark.scoring.eval_info import episodes_for
    from benchmark.scoring.two_policies import paired_episodes
    from richmap.progress import plain_console

    console, run = plain_console(stderr=True), config.run("")
    folders = [policy_folder(given, config.task) for given in (config.a, config.b)]
    rollouts = [make_rollout(config.run(str(folder)), 0.0, folder, console) for folder in folders]
    parts = []
    for seeds in blocks(config):
        some = replace(run, seed_start=seeds.start, episodes=len(seeds))
        tables = play_and_store(rollouts, some, console, f"{config.robot.name}, two policies")
        parts.append(paired_episodes(*(episodes_for(table, rollouts[0].task) for table in tables)))
        pairs = pd.concat(parts, ignore_index=True)
        if config.stop_early and first_clear((pairs.a.astype(int) - pairs.b.astype(int)).to_numpy(), config.alpha):
            break
    return pairs


def blocks(config: ComparePoliciesConfig) -> list[range]:
    """The scenes in the parts after which it is looked whether it is clear: whole batches for all workers."""
    last, size = config.seed_start + config.episodes, config.batch_size * max(1, config.workers // 2)
    ends = [*range((config.seed_start // size + 1) * size, last, size), last] if config.stop_early else [last]
    return [range(first, end) for first, end in zip([config.seed_start, *ends], ends, strict=False)]


if __name__ == "__main__":
    run_command(main, ComparePoliciesConfig, "compare_policies", positional=("a", "b"))
