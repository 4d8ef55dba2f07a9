"""Settings of the benchmark's commands: names, defaults, units and what is allowed."""

import math
import os
import re
from dataclasses import dataclass, field, fields
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.command import SettingError, check_setting
from policies.methods import METHODS
from richmap.energy_settings import CHOICES, EnergySettings

if TYPE_CHECKING:
    from richmap.robot import RobotDescription

SOURCE = "xarm6"
"""The arm that policies are trained on; its base frame is the world frame."""

TASK_ARMS = ("xarm6", "ur3", "ur5", "ur10")
"""The arms that do the block-push task (`envs.arms.ARMS`)."""

FIRST_TEST_SEED = 100_000
"""Episodes from this seed on are for final tables only, those from 50000 to 59999 for every choice."""

SETTINGS = ("original", "embodied", "best")
"""What an arm may do and where it stands (`envs.arms.SETTINGS`)."""

ORACLES = ("plain", "aware")
"""Scripted oracles (`envs.oracle`, `envs.aware_oracle`)."""


@dataclass(unsafe_hash=True)
class RobotConfig:
    """Which arm."""

    name: str = "xarm6"
    """One of the arms that are known, or custom."""
    path: str = ""
    """With robot=custom: URDF or MJCF (.xml) file of the arm."""
    base: str = ""
    """With robot=custom: the link or body that is fixed to the world; its frame is the base frame."""
    end_effector: str = ""
    """With robot=custom: the link, body or site whose +z is the approach direction."""

    def __post_init__(self) -> None:
        for name in ("path", "base", "end_effector"):
            value, custom = getattr(self, name), self.name == "custom"
            if custom and not value:
                raise SettingError(
                    f"robot=custom needs robot.{name}. Give all of: robot=custom robot.path=robot.urdf "
                    "robot.base=<link> robot.end_effector=<link>."
                )
            if value and not custom:
                raise SettingError(f"robot.{name}={value} goes with robot=custom. Here robot={self.name}.")

    def load(self) -> "RobotDescription":
        """Description of the arm.

        Raises:
            SettingError: If a custom arm lacks something.
        """
        from richmap.custom import custom_robot
        from richmap.robots import load_robot

        if self.name != "custom":
            return load_robot(self.name)
        try:
            return custom_robot(self.path, self.base, self.end_effector)
        except ValueError as error:
            raise SettingError(f"robot=custom: {error}") from error


@dataclass(unsafe_hash=True)
class MapConfig:
    """How finely a robot's workspace is divided, and when it counts as full."""

    cell_size: float = 0.05
    """Edge of a cubic cell (the paper's Delta), in m, above 0."""
    theta: float = 0.1
    """Least angle between two directions of a cell, in rad, above 0."""
    half_width: float = 1.0
    """The grid spans this far from the base along x and y, and up and down, in m, above 0."""
    z_offset: float = 0.2
    """How much the grid is raised against the base, in m."""
    stop_rate: float = 0.02
    """Building stops when a batch brings less than this fraction of new directions; between 0 and 1."""
    target: int = 0
    """Building stops at this many directions; 0 for no such target."""
    draw: int = 4096
    """Configurations that a worker draws at once; 1 or more."""
    turns: int = 128
    """Angles of joint 1 that each configuration is used at (orbit sampling); a power of two, 1 for plain sampling."""
    device: str = "cpu"
    """Where poses are compared with what is stored: cpu, or cuda (batched matrix products, as in the paper)."""
    seed: int = 0
    """Seed of the samples; a whole number >= 0."""

    def __post_init__(self) -> None:
        half_width = self.half_width
        check_setting(0 < half_width <= 10, "map.half_width", half_width, "a number above 0 and at most 10")
        check_setting(0 < self.cell_size <= half_width / 4, "map.cell_size", self.cell_size, "up to half_width / 4")
        check_setting(0.02 <= self.theta <= 1, "map.theta", self.theta, "a number from 0.02 to 1")
        check_setting(abs(self.z_offset) <= 10, "map.z_offset", self.z_offset, "a number from -10 to 10")
        check_setting(self.seed >= 0, "map.seed", self.seed, "a whole number >= 0")
        check_setting(0 < self.stop_rate < 1, "map.stop_rate", self.stop_rate, "a number between 0 and 1")
        check_setting(self.target >= 0, "map.target", self.target, "a whole number >= 0")
        check_setting(self.device in ("cpu", "cuda"), "map.device", self.device, "cpu, cuda")
        check_setting(self.draw >= 1, "map.draw", self.draw, "a whole number >= 1")
        check_setting(self.turns.bit_count() == 1 <= self.turns, "map.turns", self.turns, "a power of two")


@dataclass(unsafe_hash=True)
class EnergyConfig:
    """How similarity becomes an energy field; what the paper leaves open."""

    scales: int = 5
    """Bandwidths of the kernel that compares directions (the paper's M), from 1 to 7."""
    step: float = EnergySettings.step
    """Energy per cell of distance from the similar region (the paper's delta), unitless; from 0 to 1."""
    smoothing: float = EnergySettings.smoothing
    """Standard deviation of the Gaussian filter, in cells; from 0 to 10."""
    central_radius: float = EnergySettings.central_radius
    """Cells nearer to the base axis than this are never seeds, in m; from 0 to 0.5."""
    discrepancy: str = EnergySettings.discrepancy
    """What cells are compared by: mmd or mmd2, its square."""
    one_sided: str = EnergySettings.one_sided
    """Cells that one arm fills: masked (no discrepancy) or counted (that from an empty set)."""
    empty: str = EnergySettings.empty
    """Cells without a discrepancy: unfilled or seed."""

    def __post_init__(self) -> None:
        check_setting(1 <= self.scales <= 7, "energy.scales", self.scales, "a whole number from 1 to 7")
        for name, most in (("step", 1), ("smoothing", 10), ("central_radius", 0.5)):
            value = getattr(self, name)
            check_setting(0 <= value <= most, f"energy.{name}", value, f"a number from 0 to {most}")
        for name, allowed in CHOICES.items():
            check_setting(getattr(self, name) in allowed, f"energy.{name}", getattr(self, name), ", ".join(allowed))


@dataclass
class ArmConfig:
    """Single choices of an arm's setting, where they are not to be the setting's."""

    base: list[float] | None = None
    """Position of the arm's base in the world (the xArm6's base frame), [x,y,z] in m; null for the setting's."""
    wrist: str | None = None
    """Branch of the wrist, out or in; null for the setting's."""
    self_collision: bool | None = None
    """Whether links collide with each other, true or false; null for the setting's."""
    orientation_weight: float | None = None
    """Weight of orientation against position in the inverse kinematics, in m/rad, above 0; null for the default."""

    def __post_init__(self) -> None:
        base, weight = self.base, self.orientation_weight
        if base is not None:
            near = len(base) == 3 and all(abs(x) <= 1 for x in base)
            check_setting(near, "arm.base", base, "[x,y,z] in m, each from -1 to 1")
        check_setting(self.wrist in (None, "out", "in"), "arm.wrist", self.wrist, "out, in, null")
        if weight is not None:
            check_setting(0 < weight < math.inf, "arm.orientation_weight", weight, "a number above 0")


@dataclass(unsafe_hash=True)
class WandbConfig:
    """Whether runs are logged in Weights & Biases, and where."""

    mode: str = "disabled"
    """online, offline (kept on disk, for `wandb sync`) or disabled."""
    project: str = "guided-push"
    """Project that the runs go to."""
    folder: str = "outputs"
    """Folder that gets a folder `wandb`."""
    group: str = ""
    """What the runs belong to; empty for the sweep's folder, or else the output folder."""
    video: bool = False
    """Whether the first episode of an evaluation is logged as a GIF, true or false."""

    def __post_init__(self) -> None:
        modes = ("online", "offline", "disabled")
        check_setting(self.mode in modes, "wandb.mode", self.mode, ", ".join(modes))
        check_folder(self.folder, "wandb.folder")


@dataclass
class RunConfig:
    """Rolls out the xArm6's policy on an arm, without guidance and with it, on the same episodes, and compares."""

    robot: RobotConfig = field(default_factory=RobotConfig, metadata={"choices": TASK_ARMS})
    """Arm that acts: xarm6 (the source itself), ur3, ur5 or ur10."""
    guidance_scale: float | None = 0.0
    """Scale of the method, any number >= 0; 0 is direct transfer, null the one that benchmark.scales chose for this
    arm, setting and method on validation episodes. paper, shuffled, flipped: how much of the energy's slope in 1/m is
    added to the predicted noise in normalised action units (the paper's lambda). away, towards: the push in those
    units; ring, feasibility: the same at the border. projection: how far inside, in m. best_of_n: number of samples, a
    whole number. chunk: descent of the normalised actions per unit of slope. reorder: how far inside a push must keep
    the tool to be made first, in m."""
    method: str = "paper"
    """Guidance: paper (against the slope of the energy of similarity), shuffled (that slope turned at random in each
    cell), flipped (along it), away and towards (constant, from the base or to it), ring (back between two distances
    from the base), feasibility (from the border of what the arm can hold), projection (commands moved inside that
    border), best_of_n_energy and best_of_n_feasibility (the best of lambda samples), chunk and chunk_feasibility (down
    the slope along the whole chunk), reorder (what the arm cannot push is left for later), or direct (none)."""
    episodes: int = 50
    """Number of episodes per lambda; a whole number >= 1."""
    seed: int = 42
    """Training seed of the policy, a whole number >= 0."""
    checkpoint: int = 1
    """Which of that seed's checkpoints, by rank on the validation episodes, from 1: seed<seed>-<checkpoint>, the one
    that ships, or else the one that benchmark.source_policies or benchmark.train left in outputs."""
    policy: str = ""
    """Folder of a LeRobot checkpoint to run instead, of any type that needs no pictures; empty for the one that seed
    and checkpoint pick. One that is not of type guided_push samples as it was saved (not by sampler), and only with
    lambda=0."""
    setting: str = "embodied"
    """What the arm may do: embodied (joint limits and self-collision bind, wrist branch per arm) or original (neither
    binds, wrist-out, as where only the arm is swapped in the original task) or best (as embodied, base and wrist where
    benchmark.place_bases finds the arm to reach the most)."""
    scales_dir: str = "results/scales"
    """With lambda=null: folder of the episodes.parquet of benchmark.scales."""
    output_dir: str = "results"
    """Folder that results go to, such as episodes.parquet."""
    device: str = "auto"
    """Where the policy runs: cpu, cuda, or auto (cuda if there is one)."""
    seed_start: int = FIRST_TEST_SEED
    """Seed of the first episode; from 100000 on are test episodes, from 50000 on validation episodes."""
    sampler: str = "DDIM"
    """Sampler of the diffusion policy: DDIM or DDPM."""
    sampling_steps: int = 10
    """Denoising steps per action chunk; a whole number from 1 to 100."""
    slots: int = 10
    """Rows of the batch in which the policy is evaluated; an episode's row and this number are stored with it, since
    float results depend on the batch's shape. A whole number >= 1."""
    workers: int = 2
    """Processes that roll out or sample; results do not depend on it. A whole number >= 1."""
    arm: ArmConfig = field(default_factory=ArmConfig)
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)
    wandb: WandbConfig = field(default_factory=WandbConfig)

    def __post_init__(self) -> None:
        check_setting(self.robot.name in TASK_ARMS, "robot", self.robot.name, ", ".join(TASK_ARMS))
        scale = self.guidance_scale
        check_setting(self.method in METHODS, "method", self.method, ", ".join(METHODS))
        if scale is not None:
            check_setting(math.isfinite(scale) and scale >= 0, "lambda", scale, "any number >= 0, or null")
            check_setting(scale == 0 or self.method != "direct", "lambda", scale, "0 with method=direct")
        if scale is not None and METHODS[self.method].counts:
            check_setting(scale == int(scale), "lambda", scale, f"a whole number of samples with method={self.method}")
        for name in ("episodes", "slots", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        check_setting(self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        check_setting(self.checkpoint >= 1, "checkpoint", self.checkpoint, "a whole number >= 1")
        covered = scale == 0 or self.map.half_width >= 0.8
        check_setting(covered, "map.half_width", self.map.half_width, "0.8 or more, so that the field covers the table")
        check_seeds(self.seed_start, self.episodes)
        check_folder(self.output_dir)
        check_setting(self.setting in SETTINGS, "setting", self.setting, ", ".join(SETTINGS))
        check_setting(self.device in ("cpu", "cuda", "auto"), "device", self.device, "cpu, cuda, auto")
        check_setting(self.sampler in ("DDIM", "DDPM"), "sampler", self.sampler, "DDIM, DDPM")
        steps = self.sampling_steps
        check_setting(1 <= steps <= 100, "sampling_steps", steps, "a whole number from 1 to 100")


@dataclass
class ScalesConfig:
    """Sweeps the scale of each method of guidance on an arm, on validation episodes and up to collapse."""

    robot: RobotConfig = field(default_factory=RobotConfig, metadata={"choices": TASK_ARMS})
    """Arm that acts: ur3, ur5, ur10 or xarm6."""
    methods: list[str] = field(default_factory=lambda: [name for name in METHODS if name != "direct"])
    """Methods, as in methods=[paper,towards] (see benchmark.run)."""
    points: int = 9
    """Most scales of a method, each twice the one before; it ends sooner when the policy collapses. From 1 to 16."""
    seeds: list[int] = field(default_factory=lambda: [42, 43, 44])
    """Training seeds, whole numbers >= 0; one checkpoint of each is rolled out."""
    checkpoint: int = 1
    """Which of each seed's checkpoints, by rank on the validation episodes, from 1."""
    episodes: int = 100
    """Number of episodes per scale and checkpoint; a whole number >= 1. The same ones for all."""
    seed_start: int = 50_000
    """Seed of the first episode: choices are made on validation episodes, 50000 to 59999."""
    setting: str = "embodied"
    """What the arm may do (see benchmark.run)."""
    output_dir: str = "results/scales"
    """Folder of episodes.parquet, scales.md and the figures."""
    device: str = "auto"
    """Where the policy runs: cpu, cuda, or auto (cuda if there is one)."""
    sampler: str = "DDIM"
    """Sampler of the diffusion policy: DDIM or DDPM."""
    sampling_steps: int = 10
    """Denoising steps per action chunk; a whole number from 1 to 100."""
    slots: int = 10
    """Rows of the batch in which the policy is evaluated (see benchmark.run); a whole number >= 1."""
    workers: int = 2
    """Processes that roll out or sample; results do not depend on it. A whole number >= 1."""
    arm: ArmConfig = field(default_factory=ArmConfig)
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)

    def __post_init__(self) -> None:
        for name in self.methods or [None]:
            check_setting(name in METHODS and name != "direct", "methods", name, ", ".join([*METHODS][1:]))
        check_setting(1 <= self.points <= 16, "points", self.points, "a whole number from 1 to 16")
        check_setting(bool(self.seeds), "seeds", self.seeds, "one or more whole numbers")
        validation = 50_000 <= self.seed_start <= 60_000 - self.episodes
        check_setting(validation, "seed_start", self.seed_start, "from 50000 to 60000 - episodes, validation episodes")
        for seed in self.seeds:
            self.run(seed)

    def run(self, seed: int) -> RunConfig:
        """Settings of direct transfer with the policy of one training seed."""
        names = {each.name for each in fields(RunConfig)} - {"seed"}
        return RunConfig(**{name: value for name, value in vars(self).items() if name in names}, seed=seed)


@dataclass
class DashboardConfig:
    """Builds the workspace of a W&B project: curves over lambda, causes of failure, episodes, trainings."""

    project: str = WandbConfig.project
    """Project that the runs went to."""
    entity: str = ""
    """User or team of the project; empty for the account's own."""


@dataclass
class BuildMapsConfig:
    """Builds an arm's reachability map and, from the xArm6's and its own, the energy field; both are cached."""

    robot: RobotConfig = field(default_factory=RobotConfig)
    """Arm: xarm6, ur3, ur5, ur10, panda, iiwa7, ur5e, gen3, or custom."""
    workers: int = 2
    """Processes that sample; the map does not depend on it. A whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)

    def __post_init__(self) -> None:
        check_setting(self.workers >= 1, "workers", self.workers, "a whole number >= 1")


@dataclass
class MergeMapsConfig:
    """Merges maps of one arm, built from different seeds or on different machines, into one theta-separated map."""

    robot: RobotConfig = field(default_factory=RobotConfig)
    """Arm that all the maps are of."""
    inputs: list[str] = field(default_factory=list)
    """Map files, two or more, as in inputs=[a.safetensors,b.safetensors]; same grid and theta, each of its own seed."""
    output: str = "merged.safetensors"
    """File of the merged map."""

    def __post_init__(self) -> None:
        check_folder(str(Path(self.output).parent), "output")


@dataclass
class OracleConfig:
    """Rolls out the scripted oracle on an arm: what the task allows there without a learned policy."""

    robot: RobotConfig = field(default_factory=RobotConfig, metadata={"choices": TASK_ARMS})
    """Arm: xarm6, ur3, ur5 or ur10."""
    setting: str = "embodied"
    """What the arm may do: original, embodied or best (see benchmark.run)."""
    oracle: str = "plain"
    """Which oracle: plain (the original's, blind to the arm) or aware (pushes from where the arm can be; its score is
    the arm's ceiling)."""
    episodes: int = 300
    """Number of episodes; a whole number >= 1."""
    seed_start: int = 50_000
    """Seed of the first episode."""
    output_dir: str = "outputs/oracle"
    """Folder of oracle.json."""
    workers: int = 2
    """Processes that roll out; results do not depend on it. A whole number >= 1."""
    arm: ArmConfig = field(default_factory=ArmConfig)

    def __post_init__(self) -> None:
        check_setting(self.robot.name in TASK_ARMS, "robot", self.robot.name, ", ".join(TASK_ARMS))
        for name in ("episodes", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        check_seeds(self.seed_start, self.episodes)
        check_folder(self.output_dir)
        check_setting(self.oracle in ORACLES, "oracle", self.oracle, ", ".join(ORACLES))
        check_setting(self.setting in SETTINGS, "setting", self.setting, ", ".join(SETTINGS))


@dataclass
class LerobotAgreementConfig:
    """Compares the success that lerobot-eval measures with that of our rollouts, on the same episodes."""

    robot: RobotConfig = field(default_factory=RobotConfig, metadata={"choices": TASK_ARMS})
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
    slots: int = 10
    """Environments that LeRobot steps together, and rows of our batches; a whole number >= 1."""
    workers: int = 2
    """Processes of our rollouts; a whole number >= 1."""
    output_dir: str = "results"
    """Folder of lerobot_agreement.md; episodes go to its folder lerobot_agreement."""

    def __post_init__(self) -> None:
        check_setting(self.robot.name in TASK_ARMS, "robot", self.robot.name, ", ".join(TASK_ARMS))
        for name in ("episodes", "slots", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        check_seeds(self.seed_start, self.episodes)
        check_folder(self.output_dir)
        check_setting(self.setting in SETTINGS, "setting", self.setting, ", ".join(SETTINGS))


@dataclass
class ArmsConfig:
    """Rolls the scripted oracles out on the target arms: each setting, single changes of it, where the tool can be."""

    robots: list[str] = field(default_factory=lambda: ["ur3", "ur5", "ur10"])
    """Arms, as in robots=[ur3,ur5]."""
    changed: list[str] = field(default_factory=lambda: ["embodied"])
    """Settings of which single choices are changed, as in changed=[embodied,original]."""
    episodes: int = 500
    """Number of episodes of each condition; a whole number >= 1."""
    seed_start: int = 50_000
    """Seed of the first episode."""
    demonstrations: int = 30
    """Demonstrations drawn over the table; a whole number from 1 to 1000."""
    spacing: float = 0.01
    """Of the points of the table in the pictures, in m, from 0.005 to 0.1."""
    output_dir: str = "results"
    """Folder of arms.md, arms/oracle_episodes.parquet and the figures in its folder figures."""
    workers: int = 2
    """Processes that roll out; results do not depend on it. A whole number >= 1."""

    def __post_init__(self) -> None:
        check_targets(self.robots)
        for name in self.changed:
            check_setting(name in SETTINGS, "changed", name, ", ".join(SETTINGS))
        for name in ("episodes", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        drawn = self.demonstrations
        check_setting(1 <= drawn <= 1000, "demonstrations", drawn, "a whole number from 1 to 1000")
        check_setting(0.005 <= self.spacing <= 0.1, "spacing", self.spacing, "a number from 0.005 to 0.1")
        check_seeds(self.seed_start, self.episodes)
        check_folder(self.output_dir)


@dataclass
class PlaceBasesConfig:
    """Finds where each target arm stands best for this task, by its reachability map, and its wrist's branch there."""

    robots: list[str] = field(default_factory=lambda: ["ur3", "ur5", "ur10"])
    """Arms, as in robots=[ur3,ur5]."""
    episodes: int = 30
    """Demonstrations whose positions are to be reached, from the scene of seed 0 on; a whole number from 1 to 1000."""
    stride: int = 8
    """Every so many control steps a position is taken; a whole number >= 1."""
    margin: float = 0.1
    """How far from the edge of the reach a position should be, in m, from 0 to 0.5."""
    output_dir: str = "results"
    """Folder of base_placement.md; the figure goes to its folder figures."""
    workers: int = 2
    """Processes that sample where a map is to be built; a whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)

    def __post_init__(self) -> None:
        check_targets(self.robots)
        check_setting(1 <= self.episodes <= 1000, "episodes", self.episodes, "a whole number from 1 to 1000")
        for name in ("stride", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        check_setting(0 <= self.margin <= 0.5, "margin", self.margin, "a number from 0 to 0.5")
        check_folder(self.output_dir)


@dataclass
class SelfCollisionConfig:
    """Compares the convex parts that simulators collide with exact triangles, on configurations drawn afresh."""

    robots: list[str] = field(default_factory=lambda: [*TASK_ARMS, "panda", "iiwa7", "ur5e", "gen3"])
    """Arms, as in robots=[ur3,ur5]; their rows replace older ones in the table."""
    configurations: int = 20_000
    """Least number of configurations per arm, uniform within the joint limits; a whole number >= 1."""
    collisions: int = 400
    """Least number of colliding ones per arm: sampling goes on until there are as many; a whole number >= 1."""
    limit: int = 1_000_000
    """Sampling ends here even so; a whole number >= 1."""
    seed: int = 1000
    """Seed of the configurations. Those of seed 0 chose the pairs that are checked, so it is 1 or more."""
    output_dir: str = "results"
    """Folder of self_collision.parquet and self_collision.md."""

    def __post_init__(self) -> None:
        for name in ("configurations", "collisions", "limit", "seed"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")


@dataclass
class FieldSensitivityConfig:
    """Measures how the energy fields' slope along the demonstrations depends on what the paper leaves open."""

    robots: list[str] = field(default_factory=lambda: ["ur3", "ur5", "ur10"])
    """Arms, as in robots=[ur3,ur5]; their rows of this map.cell_size replace older ones in the table."""
    episodes: int = 30
    """Demonstrations whose positions count, from the scene of seed 0 on; a whole number from 1 to 1000."""
    output_dir: str = "results"
    """Folder of field_sensitivity.parquet and field_sensitivity.md; the figure goes to its folder figures."""
    workers: int = 2
    """Processes that sample where a map is to be built; a whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)

    def __post_init__(self) -> None:
        check_targets(self.robots)
        check_setting(1 <= self.episodes <= 1000, "episodes", self.episodes, "a whole number from 1 to 1000")
        check_setting(self.workers >= 1, "workers", self.workers, "a whole number >= 1")
        covered = self.map.half_width >= 0.8
        check_setting(covered, "map.half_width", self.map.half_width, "0.8 or more, so that the field covers the table")
        check_folder(self.output_dir)


@dataclass
class PicturesConfig:
    """Draws an arm's map and what it is good for; the map is built if it is not in the cache."""

    robot: RobotConfig = field(default_factory=RobotConfig)
    """Arm: xarm6, ur3, ur5, ur10, panda, iiwa7, ur5e, gen3, or custom."""
    workers: int = 2
    """Processes that sample; the map does not depend on it. A whole number >= 1."""
    output_dir: str = "results/figures"
    """Pictures go to its folder maps."""
    map: MapConfig = field(default_factory=MapConfig)

    def __post_init__(self) -> None:
        check_setting(self.workers >= 1, "workers", self.workers, "a whole number >= 1")
        check_folder(self.output_dir)


@dataclass
class ViewConfig:
    """Shows an arm and its map in three dimensions, in a web browser; the map is built if it is not in the cache."""

    robot: RobotConfig = field(default_factory=RobotConfig)
    """Arm: xarm6, ur3, ur5, ur10, panda, iiwa7, ur5e, gen3, or custom."""
    colour: str = "coverage"
    """What cells are coloured by: coverage, or mmd (discrepancy of directions against the xArm6's)."""
    cell: list[float] | None = None
    """A point of the cell whose directions are shown, [x,y,z] in m in the arm's base frame; null for a half-filled
    cell before the arm. The arm stands in a configuration that reaches this cell."""
    save: str = ""
    """Page (.html) to write without opening a browser; empty to write outputs/view/<robot>.html and open it."""
    workers: int = 2
    """Processes that sample; the map does not depend on it. A whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)

    def __post_init__(self) -> None:
        cell = self.cell
        check_setting(self.colour in ("coverage", "mmd"), "colour", self.colour, "coverage, mmd")
        check_setting(cell is None or len(cell) == 3, "cell", cell, "[x,y,z] in m, or null")
        check_setting(self.save == "" or self.save.endswith(".html"), "save", self.save, "a file name ending in .html")
        check_setting(self.workers >= 1, "workers", self.workers, "a whole number >= 1")
        if self.save:
            check_folder(str(Path(self.save).parent))


@dataclass
class CapabilityMapConfig:
    """Builds an arm's capability map, which holds full orientations; it is cached."""

    robot: RobotConfig = field(default_factory=RobotConfig)
    """Arm: xarm6, ur3, ur5, ur10, panda, iiwa7, ur5e, gen3, or custom."""
    cell_size: float = 0.05
    """Edge of a cubic cell, in m, above 0."""
    theta: float = 0.4
    """Least angle between two orientations of a cell, in rad, above 0."""
    half_width: float = 1.0
    """The grid spans this far from the base along x and y, and up and down, in m, above 0."""
    z_offset: float = 0.2
    """How much the grid is raised against the base, in m."""
    stop_rate: float = 0.005
    """Building stops when a draw brings less than this fraction of new orientations; between 0 and 1."""
    target: int | None = None
    """Building also stops at so many orientations; 0 for no such target, null for the paper's count where it has one
    (panda, iiwa7, ur5e, gen3)."""
    draw: int = 8192
    """Configurations that a worker draws at once; 1 or more."""
    turns: int = 64
    """Angles of joint 1 that each configuration is used at (orbit sampling); a power of two, 1 for plain sampling."""
    seed: int = 0
    """Seed of the samples; a whole number >= 0."""
    workers: int = 2
    """Processes that sample; the map does not depend on it. A whole number >= 1."""

    def __post_init__(self) -> None:
        half_width = self.half_width
        check_setting(0 < half_width <= 10, "half_width", half_width, "a number above 0 and at most 10")
        check_setting(0 < self.cell_size <= half_width / 4, "cell_size", self.cell_size, "up to half_width / 4")
        check_setting(0.1 <= self.theta <= 3, "theta", self.theta, "a number from 0.1 to 3")
        check_setting(abs(self.z_offset) <= 10, "z_offset", self.z_offset, "a number from -10 to 10")
        check_setting(0 < self.stop_rate < 1, "stop_rate", self.stop_rate, "a number between 0 and 1")
        check_setting((self.target or 0) >= 0, "target", self.target, "a whole number >= 0, null")
        check_setting(self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        for name in ("draw", "turns", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        check_setting(self.turns.bit_count() == 1, "turns", self.turns, "a power of two")


@dataclass
class ApproximateIkConfig:
    """Measures how near the configurations that a map stores are to asked poses, and what a few steps make of them."""

    robot: RobotConfig = field(default_factory=RobotConfig)
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


@dataclass
class FractionMapConfig:
    """How finely a map of fractions divides the turned workspace."""

    cell_size: float = 0.04
    """Edge of a cell, in m, from 0.01 to 0.2."""
    angles: int = 48
    """Cells along the angle between approach direction and vertical; from 4 to 180."""
    samples: int = 20_000_000
    """Configurations drawn to begin with; a whole number >= 1000."""

    def __post_init__(self) -> None:
        check_setting(0.01 <= self.cell_size <= 0.2, "fraction.cell_size", self.cell_size, "a number from 0.01 to 0.2")
        check_setting(4 <= self.angles <= 180, "fraction.angles", self.angles, "a whole number from 4 to 180")
        check_setting(self.samples >= 1000, "fraction.samples", self.samples, "a whole number >= 1000")


@dataclass
class MapGrowthConfig:
    """Scores an arm's map of directions while it is built, as in the paper's figure over inserted poses."""

    robot: RobotConfig = field(default_factory=RobotConfig)
    """Arm: xarm6, ur3, ur5, ur10, panda, iiwa7, ur5e, gen3, or custom; its rows replace older ones in the table."""
    millions: list[float] = field(default_factory=lambda: [0.2, 0.5, 1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 15.0, 18.0])
    """Inserted directions, in millions, at which the map is scored; once more at the end. Rising numbers above 0."""
    poses: int = 100_000
    """Poses of each test set; a whole number >= 100."""
    workers: int = 2
    """Processes that label and sample; results do not depend on it. A whole number >= 1."""
    output_dir: str = "results"
    """Folder of map_growth.parquet; the figure goes to its folder figures."""
    map: MapConfig = field(default_factory=lambda: MapConfig(stop_rate=0.01))
    """The map of directions; its z_offset is the paper's for the arm, whatever is set."""

    def __post_init__(self) -> None:
        rising = all(a < b for a, b in pairwise([0, *self.millions]))
        check_setting(rising, "millions", self.millions, "rising numbers above 0")
        for name, least in (("poses", 100), ("workers", 1)):
            check_setting(getattr(self, name) >= least, name, getattr(self, name), f"a whole number >= {least}")
        check_folder(self.output_dir)


@dataclass
class VerifyMapsConfig:
    """Scores an arm's maps on poses that inverse kinematics has labelled, beside the paper's figures."""

    robot: RobotConfig = field(default_factory=RobotConfig)
    """Arm: xarm6, ur3, ur5, ur10, panda, iiwa7, ur5e, gen3, or custom; its rows replace older ones in the tables."""
    poses: int = 200_000
    """Poses of each test set; a larger number adds to those that are in the cache. A whole number >= 100."""
    checked: int = 5_000
    """Poses of each test set whose labels are checked with ten times the effort; a whole number >= 100."""
    workers: int = 2
    """Processes that label and sample; results do not depend on it. A whole number >= 1."""
    output_dir: str = "results"
    """Folder of verify_maps.parquet, verify_labels.parquet and verify_maps.md."""
    maps: list[str] = field(default_factory=lambda: ["richmap", "fraction", "rm4d", "capability_map"])
    """Which maps, as in maps=[richmap,fraction]."""
    fraction: FractionMapConfig = field(default_factory=FractionMapConfig)
    map: MapConfig = field(default_factory=lambda: MapConfig(stop_rate=0.01))
    """The map of directions; its z_offset is the paper's for the arm, whatever is set."""

    def __post_init__(self) -> None:
        for name, least in (("poses", 100), ("checked", 100), ("workers", 1)):
            check_setting(getattr(self, name) >= least, name, getattr(self, name), f"a whole number >= {least}")
        check_folder(self.output_dir)


@dataclass
class SpeedConfig:
    """Measures queries, construction and MMD beside the paper's batched matrix products, in one run."""

    robots: list[str] = field(default_factory=lambda: ["panda", "iiwa7", "ur5e", "gen3"])
    """Arms, as in robots=[panda,ur5e]; MMD is that of the first one and each of the others."""
    parts: list[str] = field(default_factory=lambda: ["queries", "insertion", "sampling", "mmd"])
    """What is measured, as in parts=[queries]; insertion into a map of fine cells takes much memory."""
    batches: list[int] = field(default_factory=lambda: [100, 10_000, 1_000_000, 2_000_000])
    """Numbers of queries asked at once; whole numbers >= 1."""
    insertion_batches: list[int] = field(default_factory=lambda: [10_000, 1_000_000])
    """Numbers of poses offered at once; whole numbers >= 1."""
    sampled: int = 20_000
    """Configurations drawn at once for the speed of sampling; a whole number >= 1."""
    pairwise_cells: int = 400
    """Cells in which MMD is summed over all pairs; a whole number >= 1."""
    threads: list[int] = field(default_factory=lambda: [1, 2])
    """Numbers of threads; whole numbers from 1 to the number of processors."""
    repeats: int = 3
    """Measurements of which the least counts; a whole number >= 1."""
    device: str = "auto"
    """Where the matrix products run: cpu, cuda, or auto (cuda if there is one)."""
    seed: int = 1000
    """Seed of queries and poses; a whole number >= 0."""
    workers: int = 2
    """Processes that sample where a map is to be built; a whole number >= 1."""
    output_dir: str = "results"
    """Folder of speed.parquet and speed.md."""
    map: MapConfig = field(default_factory=lambda: MapConfig(stop_rate=0.01))

    def __post_init__(self) -> None:
        for name in ("batches", "insertion_batches", "threads"):
            values = getattr(self, name)
            check_setting(bool(values) and min(values) >= 1, name, values, "whole numbers >= 1")
        most = os.cpu_count() or 1
        check_setting(max(self.threads) <= most, "threads", self.threads, f"whole numbers from 1 to {most}")
        for name in ("sampled", "pairwise_cells", "repeats", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        parts = ("queries", "insertion", "sampling", "mmd")
        check_setting(set(self.parts) <= set(parts) and self.parts, "parts", self.parts, f"some of {', '.join(parts)}")
        check_setting(self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        check_setting(self.device in ("cpu", "cuda", "auto"), "device", self.device, "cpu, cuda, auto")
        check_folder(self.output_dir)


@dataclass
class EnvironmentSpeedConfig:
    """Measures control steps of each arm beside bare physics, chunks of actions plain and guided, and rollouts."""

    robots: list[str] = field(default_factory=lambda: list(TASK_ARMS))
    """Arms, as in robots=[ur3,ur5]; their rows replace older ones in the table."""
    episodes: int = 10
    """Episodes of the scripted oracle per arm; a whole number >= 1."""
    environments: list[int] = field(default_factory=lambda: [1, 50])
    """Numbers of environments that a chunk of actions is sampled for; whole numbers >= 1."""
    threads: list[int] = field(default_factory=lambda: [1, 2])
    """Numbers of threads that sample a chunk; whole numbers from 1 to the number of processors."""
    repeats: int = 20
    """Measurements of a chunk of which the least counts; a whole number >= 1."""
    rollout_episodes: int = 500
    """Episodes of the learned policy per arm, rolled out as benchmark.run does; 0 to leave them out."""
    seed: int = 42
    """Training seed of the policy (see benchmark.run)."""
    seed_start: int = 50_000
    """Seed of the first episode."""
    workers: int = 2
    """Processes that roll out; a whole number >= 1."""
    output_dir: str = "results"
    """Folder of environment_speed.parquet and environment_speed.md."""

    def __post_init__(self) -> None:
        for name in self.robots or [None]:
            check_setting(name in TASK_ARMS, "robots", name, ", ".join(TASK_ARMS))
        for name in ("environments", "threads"):
            values = getattr(self, name)
            check_setting(bool(values) and min(values) >= 1, name, values, "whole numbers >= 1")
        most = os.cpu_count() or 1
        check_setting(max(self.threads) <= most, "threads", self.threads, f"whole numbers from 1 to {most}")
        for name in ("episodes", "repeats", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        check_setting(self.rollout_episodes >= 0, "rollout_episodes", self.rollout_episodes, "a whole number >= 0")
        check_seeds(self.seed_start, max(self.episodes, self.rollout_episodes))
        check_folder(self.output_dir)


@dataclass
class ResponseConfig:
    """Measures how far a push on the predicted noise moves the first action, and success by denoising steps."""

    policies: list[str] = field(default_factory=list)
    """Checkpoints of type guided_push, as in policies=[results/checkpoints/seed42-1,outputs/x0/seed42-1]; empty for the
    one of seed."""
    seed: int = 42
    """Training seed of the policy (see benchmark.run)."""
    observations: int = 400
    """Observations from rollouts, 20 of an episode; a whole number >= 1."""
    steps: list[int] = field(default_factory=lambda: [1, 2, 3, 5, 10, 20, 50])
    """Numbers of denoising steps whose success is measured on the xArm6, each from 1 to 100."""
    episodes: int = 100
    """Episodes for each number of denoising steps; 0 to leave them out."""
    seed_start: int = 50_000
    """Seed of the first episode."""
    workers: int = 2
    """Processes that roll out; results do not depend on it. A whole number >= 1."""
    output_dir: str = "results"
    """Folder of response.parquet, response.md and the figure; episodes go to its folder response."""

    def __post_init__(self) -> None:
        for name, least in (("observations", 1), ("workers", 1), ("episodes", 0)):
            check_setting(getattr(self, name) >= least, name, getattr(self, name), f"a whole number >= {least}")
        possible = all(1 <= steps <= 100 for steps in self.steps)
        check_setting(possible, "steps", self.steps, "whole numbers from 1 to 100")
        check_seeds(self.seed_start, max(self.episodes, self.observations))
        check_folder(self.output_dir)


@dataclass
class EntryConfig:
    """What somebody else's entry says of itself in its `entry.yaml`; paths are relative to its folder."""

    name: str = ""
    """Name of the method in tables: small letters, digits, - and _."""
    author: str = ""
    """Who made it."""
    description: str = ""
    """What it does, in a line."""
    policy: str = ""
    """Folder of a LeRobot checkpoint of any type that needs no pictures; empty for our policies."""
    guidance: str = ""
    """Subclass of policies.guidance.Guidance, as in guidance.py:MyGuidance; empty for none."""
    field: str = "none"
    """Field that the class is made with: energy (of similarity to the source), feasibility (signed distance to the
    border of what the arm can hold, in m) or none."""
    scale: float = 0.0
    """Scale that the class is made with, in its own unit."""

    def __post_init__(self) -> None:
        named = re.fullmatch(r"[a-z0-9][a-z0-9_-]{0,39}", self.name) and self.name not in METHODS
        check_setting(bool(named), "name", self.name, f"a-z, 0-9, - and _, up to 40, and none of {', '.join(METHODS)}")
        for name in ("author", "description"):
            value = getattr(self, name)
            check_setting(value.strip() and value.isprintable(), name, value, "one line of text")
        check_setting(self.policy or self.guidance, "policy", self.policy, "a folder, unless there is guidance")
        form = not self.guidance or re.fullmatch(r".+\.py:\w+", self.guidance)
        check_setting(bool(form), "guidance", self.guidance, "a file and its class, as in guidance.py:MyGuidance")
        check_setting(self.field in ("energy", "feasibility", "none"), "field", self.field, "energy, feasibility, none")
        check_setting(math.isfinite(self.scale), "scale", self.scale, "a number")


@dataclass
class EnterConfig:
    """Evaluates somebody else's entry on the test episodes, or checks a table that was sent with it."""

    entry: str = ""
    """Folder of the entry: entry.yaml, and what it names. Its code is run: read it first."""
    table: str = ""
    """A table of episodes that was sent with the entry: nothing is stored, the table is checked. Empty to evaluate."""
    replays: int = 20
    """With table=: how many of its rows, drawn at random, are replayed; a whole number >= 0."""
    robots: list[str] = field(default_factory=lambda: list(TASK_ARMS))
    """Arms, as in robots=[ur3,ur5]; the protocol has all four."""
    settings: list[str] = field(default_factory=lambda: ["embodied"])
    """What the arms may do, embodied, best or both, as in settings=[embodied,best] (see benchmark.run)."""
    episodes: int = 500
    """Number of test episodes per arm, setting and policy, from seed 100000 on; the protocol has 500."""
    seeds: list[int] = field(default_factory=lambda: [42, 43, 44])
    """Training seeds of the policies, the best of each, that an entry without a policy of its own guides."""
    output_dir: str = "results/entries"
    """Folder in which a folder of the entry's name gets episodes.parquet and entry.yaml."""
    device: str = "auto"
    """Where the policy runs: cpu, cuda, or auto (cuda if there is one)."""
    slots: int = 10
    """Rows of the batch in which the policy is evaluated (see benchmark.run); a whole number >= 1."""
    workers: int = 2
    """Processes that roll out or sample; results do not depend on it. A whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)

    def __post_init__(self) -> None:
        check_setting(self.replays >= 0, "replays", self.replays, "a whole number >= 0")
        check_setting(bool(self.robots), "robots", self.robots, f"some of {', '.join(TASK_ARMS)}")
        for name in self.settings or [None]:
            check_setting(name in ("embodied", "best"), "settings", name, "embodied, best")
        check_setting(bool(self.seeds), "seeds", self.seeds, "one or more whole numbers")
        for robot in self.robots:
            self.run(robot, "embodied")

    def run(self, robot: str, setting: str) -> RunConfig:
        """Settings of an arm's rollouts."""
        names = {each.name for each in fields(RunConfig)} & {*vars(self)} - {"output_dir"}
        given = {name: getattr(self, name) for name in names}
        return RunConfig(robot=RobotConfig(robot), setting=setting, output_dir=self.output_dir, **given)


@dataclass
class ReplayConfig:
    """Replays stored rows, each alone, and compares every column to the last bit."""

    table: str = "results"
    """A table of episodes, or a folder: every episodes.parquet under it."""
    row: str = ""
    """The row's row_hash, or its first digits, 8 or more."""
    number: int = -1
    """The row's number in the table, from 0, instead; -1 for none."""
    random: int = 0
    """How many rows, drawn at random, instead of one; a whole number >= 0."""
    seed: int = 0
    """Seed of the draw; a whole number >= 0."""
    policy: str = ""
    """Folder of the row's policy, where it is none of ours; empty to look for its weights among ours."""
    entry: str = ""
    """Folder of the entry that the row is of (see benchmark.enter); empty for a row of our own methods."""
    workers: int = 2
    """Processes that sample where a map is to be built; a whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)

    def __post_init__(self) -> None:
        check_setting(not self.row or len(self.row) >= 8, "row", self.row, "8 or more digits of a row_hash")
        check_setting(self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        check_setting(self.workers >= 1, "workers", self.workers, "a whole number >= 1")


@dataclass
class LeaderboardConfig:
    """Turns all stored test episodes into LEADERBOARD.md and leaderboard.html, by both protocols."""

    output_dir: str = "results"
    """Folder below which every episodes.parquet is read, and to which both files go; moving pictures come from its
    folder figures, the oracles' scores from its folders arms and oracle."""


def check_targets(robots: list[str]) -> None:
    """Raise `SettingError` unless these are arms that a policy can be transferred to, one or more."""
    for name in robots or [None]:
        check_setting(name in TASK_ARMS[1:], "robots", name, ", ".join(TASK_ARMS[1:]))


def check_seeds(first: int, count: int) -> None:
    """NumPy's legacy generator, which draws the scenes, takes 32-bit seeds."""
    check_setting(0 <= first <= 2**32 - count, "seed_start", first, "a whole number from 0 to 2^32 - episodes")


def check_folder(folder: str, setting: str = "output_dir") -> None:
    """Raise `SettingError` unless the folder, or the one to make it in, can be written to."""
    existing = next(path for path in [Path(folder), *Path(folder).absolute().parents] if path.exists())
    usable = existing.is_dir() and os.access(existing, os.W_OK)
    check_setting(usable, setting, folder, f"a folder that can be written to; {existing} cannot")
