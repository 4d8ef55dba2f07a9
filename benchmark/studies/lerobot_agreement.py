"""Success under LeRobot's own evaluation beside ours, on the same episode seeds.

    python -m benchmark.studies.lerobot_agreement robot=ur3 episodes=200

`lerobot-eval` finds policy and environment as plugins and never comes near `benchmark.rollouts.rollout`. It seeds
episode i of
a run with `--seed` + i, in batches of a vector environment that starts finished episodes over by itself; what comes
after an episode's end it leaves out. Its noise is torch's own, so rates are compared, not episodes.
"""

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from benchmark.artifacts.known_policies import chosen_checkpoint
from benchmark.artifacts.outputs import store_rows
from benchmark.rollouts.make_rollout import make_rollout
from benchmark.rollouts.missing_episodes import play_and_store
from benchmark.scoring.eval_info import read_eval_info
from benchmark.settings.command import run_command
from benchmark.settings.config import RunConfig
from benchmark.settings.paths import check_folder
from benchmark.settings.robot_config import PAPER_ARMS, RobotConfig, robot_field
from benchmark.settings.scenes import check_scenes
from benchmark.settings.setting import check_choice, check_counts
from richmap.outputs import replacing
from richmap.robots import SETTINGS

if TYPE_CHECKING:
    import pandas as pd

    from benchmark.rollouts.rollout import Rollout

PART = 100
"""Episodes per call of `lerobot-eval`, which draws a video of the first ten each time; a killed run loses one call."""

ABOUT = ["robot", "setting", "checkpoint"]

KEY = ["robot", "setting", "checkpoint_hash", "episode_version", "episode_seed"]
"""What an episode of the two evaluations must share."""


@dataclass
class LerobotAgreementConfig:
    """Compares the success that lerobot-eval measures with that of our rollouts, on the same episodes."""

    robot: RobotConfig = robot_field("ur3", PAPER_ARMS)
    """Arm: xarm6, ur3, ur5 or ur10."""
    setting: str = "embodied"
    """What the arm may do: original, embodied or best (see benchmark.run)."""
    episodes: int = 200
    """Number of episodes; a whole number >= 1."""
    seed: int = 42
    """Training seed of the policy (see benchmark.run)."""
    checkpoint: int = 1
    """Which of that seed's checkpoints (see benchmark.run)."""
    policy: str = ""
    """Folder of a LeRobot checkpoint to evaluate instead (see benchmark.run)."""
    seed_start: int = 50_000
    """Seed of the first episode."""
    batch_size: int = 10
    """Environments that LeRobot steps together, and rows of our batches; a whole number >= 1."""
    workers: int = 2
    """Processes of our rollouts; a whole number >= 1."""
    output_dir: str = "results"
    """Folder of lerobot_agreement.md; episodes go to its folder lerobot_agreement."""

    def __post_init__(self) -> None:
        check_choice("robot", self.robot.name, PAPER_ARMS)
        check_counts(self, "episodes", "batch_size", "workers")
        check_scenes(self.seed_start, self.episodes)
        check_folder(self.output_dir)
        check_choice("setting", self.setting, SETTINGS)


def main(config: LerobotAgreementConfig) -> None:
    """Evaluate with lerobot-eval and with our rollouts, store both, and write the comparison."""
    from richmap.progress import plain_console

    console, output_dir = plain_console(), Path(config.output_dir)
    folder = output_dir / "lerobot_agreement"
    shared = {field.name: getattr(config, field.name) for field in fields(config)}
    run = RunConfig(**{**shared, "output_dir": str(folder), "device": "cpu"})
    rollout = make_rollout(run, 0.0, chosen_checkpoint(run), console)
    play_and_store([rollout], run, console)
    evaluate(rollout, config, folder)
    table = compare(folder)
    with replacing(output_dir / "lerobot_agreement.md") as path:
        path.write_text(HEADER + table.to_markdown(index=False) + "\n")
    console.print(table.T.to_string(header=False))
    console.print(f"Table: {output_dir / 'lerobot_agreement.md'}", soft_wrap=True)


def evaluate(rollout: "Rollout", config: LerobotAgreementConfig, folder: Path) -> None:
    """Runs lerobot-eval on the episodes that it has not been run on, and stores what it says of each."""
    import pandas as pd

    file = folder / "lerobot_eval.parquet"
    condition = rollout.condition
    about = {name: getattr(condition, name) for name in ("checkpoint", *KEY[:-1])}
    for first in range(config.seed_start, config.seed_start + config.episodes, PART):
        seeds = range(first, min(first + PART, config.seed_start + config.episodes))
        stored = pd.read_parquet(file) if file.exists() else pd.DataFrame(columns=[*about, "episode_seed"])
        same = (stored[list(about)] == pd.Series(about)).all(axis=1)
        if set(seeds) <= set(stored.episode_seed[same]):
            continue
        metrics = lerobot_eval(rollout, seeds, config.batch_size)
        rows = {**about, "episode_seed": seeds, "success": metrics["successes"], "sum_reward": metrics["sum_rewards"]}
        store_rows(file, pd.DataFrame(rows), KEY)


def lerobot_eval(rollout: "Rollout", seeds: range, batch_size: int) -> dict[str, list]:
    """What lerobot-eval says of the episodes with these seeds: its `successes` and `sum_rewards`.

    It runs in a folder that is not the project's, so that only what is installed can be found, and offline.

    Raises:
        RuntimeError: If it fails; what it says is on the terminal.
    """
    from envs import ENVIRONMENTS

    condition = rollout.condition
    settings = {
        "policy.path": rollout.checkpoint.resolve(),
        "policy.device": condition.device,
        "env.type": "guided_push",
        "env.task": ENVIRONMENTS[condition.robot],
        "env.setting": condition.setting,
        "eval.n_episodes": len(seeds),
        "eval.batch_size": min(batch_size, len(seeds)),
        "eval.use_async_envs": "false",
        "seed": seeds.start,
        "output_dir": "evaluation",
    }
    program = shutil.which("lerobot-eval", path=Path(sys.executable).parent)
    command = [program, *(f"--{name}={value}" for name, value in settings.items())]
    environment = os.environ | {"HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
    with TemporaryDirectory() as folder:
        if subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL).returncode != 0:
            raise RuntimeError(f"lerobot-eval failed: {' '.join(command)}")
        episodes = read_eval_info(Path(folder, "evaluation"))
    return {"successes": episodes.success.tolist(), "sum_rewards": episodes.reward.tolist()}


def compare(folder: Path) -> "pd.DataFrame":
    """One row per arm, setting, checkpoint and code: both rates of p2, and their paired difference, in percent."""
    import pandas as pd

    from benchmark.episodes.table import read_episodes
    from benchmark.scoring.statistics import paired_difference, paired_p_value, rate_interval

    ours, theirs = read_episodes(folder), pd.read_parquet(folder / "lerobot_eval.parquet")
    both = theirs.merge(ours.drop(columns="checkpoint").drop_duplicates(KEY, keep="last"), on=KEY)
    rows = []
    for (robot, setting, checkpoint, version), group in both.groupby([*ABOUT, "episode_version"]):
        a, b = group.success.to_numpy(dtype=float), group.p2.to_numpy(dtype=float)
        difference, low, high = (100 * x for x in paired_difference(a, b))
        shown = {
            name: f"{100 * rate.mean():.1f} [{100 * rate_interval(rate)[0]:.1f}, {100 * rate_interval(rate)[1]:.1f}]"
            for name, rate in (("lerobot-eval", a), ("benchmark.run", b))
        }
        rows.append(
            {
                "arm": robot,
                "setting": setting,
                "checkpoint": checkpoint,
                "n": len(group),
                "seeds": f"{group.episode_seed.min()}-{group.episode_seed.max()}",
                **shown,
                "difference": f"{difference:+.1f} [{low:+.1f}, {high:+.1f}]",
                "exact McNemar p": f"{paired_p_value(a, b):.2g}",
                "version": version,
            }
        )
    return pd.DataFrame(rows)


HEADER = """# LeRobot's evaluation and ours

Both blocks placed (p2, LeRobot's `success`), in percent, on the same episode seeds: `lerobot-eval`, which finds policy
and environment as plugins, and `benchmark.run`. The noise of the sampler differs, so rates are compared. Brackets: 95 %
intervals (Wilson), of the paired difference after Bonett & Price (2012). Made by
`python -m benchmark.studies.lerobot_agreement robot=… episodes=200` from `lerobot_agreement/*.parquet`.

"""


if __name__ == "__main__":
    run_command(main, LerobotAgreementConfig, "lerobot_agreement", goes_on=True)
