"""How good a start for inverse kinematics a map's stored configurations are, against random ones.

python -m benchmark.map_quality.approximate_ik robot=panda
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.settings.command import check_setting, run_command
from benchmark.settings.config import MapConfig, RobotConfig, check_folder, robot_field
from richmap.outputs import replacing

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

    from richmap.robots.robot import RobotDescription

    Poses = tuple[np.ndarray, np.ndarray]
    """Positions (n, 3) in the base frame, in [m], and orientations (n, 3, 3) of the flange."""

STEPS = (0, 1, 2, 3, 5, 10, 20)
"""Levenberg-Marquardt steps after which errors are looked at; 0 for the start itself."""

ASKED = {"direction": True, "pose": False}
"""What is to be reached: position and approach direction with any roll, or the whole pose."""


@dataclass
class ApproximateIkConfig:
    """Measures how near the configurations that a map stores are to asked poses, and what a few steps make of them."""

    robot: RobotConfig = robot_field("panda")
    """Arm: xarm6, ur3, ur5, ur10, panda, iiwa7, ur5e, gen3, or custom; its rows replace older ones in the table."""
    poses: int = 20_000
    """Number of configurations drawn, whose poses are asked for if they are free of self-collision; 100 or more."""
    seed: int = 1000
    """Seed of the configurations; a whole number >= 0."""
    output_dir: str = "results"
    """Folder of approximate_ik.parquet and approximate_ik.md."""
    workers: int = 2
    """Processes that sample where the map is to be built; a whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)

    def __post_init__(self) -> None:
        check_setting(self.poses >= 100, "poses", self.poses, "a whole number >= 100")
        check_setting(self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        check_setting(self.workers >= 1, "workers", self.workers, "a whole number >= 1")
        check_folder(self.output_dir)


def main(config: ApproximateIkConfig) -> None:
    """Measure one arm, and store and print its part of the table."""
    import numpy as np
    import pandas as pd
    from rich.console import Console

    from benchmark.artifacts.maps import robot_map
    from benchmark.artifacts.progress import progress_bar

    console = Console()
    robot = config.robot.load()
    of_robot = robot_map(robot, (0.0, 0.0, 0.0), config.map, config.workers, console)
    rng = np.random.default_rng((config.seed, 1))  # not those that a map of this seed is built from
    positions, rotations = reachable_poses(robot, rng, config.poses)
    row, angle = of_robot.nearest(positions, rotations[:, :, 2])
    found = angle < of_robot.construction.theta
    positions, rotations = positions[found], rotations[found]
    starts = {
        "map": of_robot.configurations(row[found]),
        "random": rng.uniform(robot.lower, robot.upper, (len(positions), len(robot.joints))),
    }
    rows = []
    with progress_bar(console) as bar:
        task = bar.add_task(f"Approximate IK of {robot.name}", total=len(starts) * len(ASKED) * len(STEPS))
        for start, joints in starts.items():
            for asked in ASKED:
                ready = joints if ASKED[asked] else turned_to_roll(robot, joints, rotations)
                for steps in STEPS:
                    row = descend(robot, ready, (positions, rotations), asked, steps)
                    rows.append({"robot": robot.name, "asked": asked, "start": start, "steps": steps, **row})
                    bar.advance(task)
    about = {
        "robot_fingerprint": robot.fingerprint,
        "cell_size": config.map.cell_size,
        "theta": config.map.theta,
        "inserted": of_robot.inserted,
        "map_hash": of_robot.content_hash,
        "seed": config.seed,
        "drawn": len(found),
    }
    output_dir = Path(config.output_dir)
    table = store(output_dir, pd.DataFrame(rows).assign(**about))
    console.print(markdown(table[table.robot == robot.name]), soft_wrap=True)
    with replacing(output_dir / "approximate_ik.md") as path:
        path.write_text(markdown(table))
    console.print(f"Table: {output_dir / 'approximate_ik.md'}", soft_wrap=True)


def reachable_poses(robot: "RobotDescription", rng: "np.random.Generator", n: int) -> "Poses":
    """Flange poses of n configurations drawn uniformly within the limits, those in self-collision left out."""
    from richmap.motion.collision import self_collision
    from richmap.motion.kinematics import flange_frames

    joints = rng.uniform(robot.lower, robot.upper, (n, len(robot.joints)))
    return flange_frames(robot, joints[~self_collision(robot)(joints)])


def turned_to_roll(robot: "RobotDescription", joints: "np.ndarray", rotations: "np.ndarray") -> "np.ndarray":
    """Configurations (n, dof) with the last joint turned so that the flange's roll is nearest to that of (n, 3, 3).

    A map of directions says nothing about the roll, which is the last joint's on an arm whose last axis is the approach
    direction; on another arm they stay as they are. A roll that is out of the last joint's limits becomes the upper.
    """
    import numpy as np

    from richmap.motion.kinematics import flange_frames, joint_frames

    way = joint_frames(robot)[-1][2, 2]
    if abs(way) < 1 - 1e-6:
        return joints
    turn = flange_frames(robot, joints)[1].transpose(0, 2, 1) @ rotations  # asked flange, in the flange that is there
    last = joints[:, -1] + np.sign(way) * np.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
    lower, upper = robot.lower[-1], robot.upper[-1]
    last = np.minimum(lower + (last - lower) % (2 * np.pi), upper)
    return np.column_stack([joints[:, :-1], last])


def descend(
    robot: "RobotDescription", joints: "np.ndarray", poses: "Poses", asked: str, steps: int
) -> dict[str, float]:
    """Errors that so many steps from these configurations (n, dof) leave, and how often the pose is reached.

    Args:
        robot: The arm.
        joints: Start for each pose, in [rad].
        poses: What to reach.
        asked: A key of `ASKED`.
        steps: Levenberg-Marquardt steps, at most: it ends as soon as the pose is reached.
    """
    import numpy as np

    from benchmark.scoring.statistics import rate_interval
    from richmap.motion.collision import self_collision
    from richmap.motion.inverse_kinematics import ANGLE_TOLERANCE, POSITION_TOLERANCE, refine

    found, off, angle = refine(robot, joints, *poses, iterations=steps, free_roll=ASKED[asked])
    converged = (off <= POSITION_TOLERANCE) & (angle <= ANGLE_TOLERANCE)
    low, high = rate_interval(converged.astype(float))
    return {
        "n": len(joints),
        "position_error_median": float(np.median(off)),
        "position_error_p90": float(np.quantile(off, 0.9)),
        "angle_error_median": float(np.median(angle)),
        "angle_error_p90": float(np.quantile(angle, 0.9)),
        "converged": float(converged.mean()),
        "converged_low": low,
        "converged_high": high,
        "converged_and_free": float((~self_collision(robot)(found[converged])).sum() / len(joints)),
    }


def store(output_dir: Path, rows: "pd.DataFrame") -> "pd.DataFrame":
    """Add an arm's rows to the table, in place of its older ones."""
    import pandas as pd

    file = output_dir / "approximate_ik.parquet"
    if file.exists():
        old = pd.read_parquet(file)
        rows = pd.concat([old[~old.robot.isin(rows.robot)], rows], ignore_index=True)
    with replacing(file) as path:
        rows.to_parquet(path, index=False)
    return rows


HEADER = """# Approximate inverse kinematics from a map

Poses of fresh configurations, uniform within the joint limits and free of self-collision. The map gives the
configuration that it stores with the direction nearest to the asked one; the other start is uniform within the limits.
From both the same Levenberg-Marquardt steps within the limits (`richmap/inverse_kinematics.py`) lead towards the
*direction* (position and approach direction, any roll) or the whole *pose*, for which the last joint is first turned to
the asked roll. Errors are those that are left after so
many steps (0: those of the start), as median and 90th percentile. *Converged*: within 1 mm and 0.01 rad, in percent,
with Wilson 95 % intervals; *and free*: of self-collision as well. Made by `python -m
benchmark.map_quality.approximate_ik`.

"""


def markdown(table: "pd.DataFrame") -> str:
    """The table for people."""
    import pandas as pd

    percent = 100 * table[["converged", "converged_low", "converged_high", "converged_and_free"]]
    shown = pd.DataFrame(
        {
            "arm": table.robot,
            "asked": table.asked,
            "start": table.start,
            "steps": table.steps,
            "n": table.n,
            "position error, mm": [
                f"{1e3 * a:.2f} / {1e3 * b:.2f}"
                for a, b in zip(table.position_error_median, table.position_error_p90, strict=True)
            ],
            "angle error, rad": [
                f"{a:.3f} / {b:.3f}" for a, b in zip(table.angle_error_median, table.angle_error_p90, strict=True)
            ],
            "converged": [f"{c:.1f} [{low:.1f}, {high:.1f}]" for c, low, high, _ in percent.itertuples(index=False)],
            "and free": [f"{free:.1f}" for free in percent.converged_and_free],
        }
    )
    return HEADER + shown.to_markdown(index=False) + "\n"


if __name__ == "__main__":
    run_command(main, ApproximateIkConfig, "approximate_ik")
