"""Settings that several commands share: names, defaults, units and what is allowed."""

import math
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING

from benchmark.settings.limits import check_memory, memory
from benchmark.settings.recipe import USUAL, check_recipe
from benchmark.settings.scenes import VALIDATION, check_scenes
from benchmark.settings.setting import SettingError, check_setting
from benchmark.settings.task import chosen_task
from policies.methods import METHODS, said_of_each
from richmap.robots import ROBOTS
from richmap.similarity.energy_settings import CHOICES, EnergySettings

if TYPE_CHECKING:
    from richmap.robots.robot import RobotDescription

SOURCE = "xarm6"
"""The arm that policies are trained on; its base frame is the world frame."""

PAPER_ARMS = (SOURCE, "ur3", "ur5", "ur10")
"""The source and the arms that the paper transfers to: what lists of arms hold unless told otherwise."""

SETTINGS = ("original", "embodied", "best")
"""What an arm may do and where it stands (`envs.arm.place_arm.BINDS`)."""

ORACLE_METHODS = {"plain": "plain_oracle", "aware": "aware_oracle"}
"""Scripted oracles (`envs.block_push.oracle`, `envs.block_push.aware_oracle`), and what stands in the column `method`
of their episodes."""

ORACLES = tuple(ORACLE_METHODS)

CLASS_IN_FILE = r".+\.py:\w+"
"""How a class in a file is written."""

ENTRY_NAME = r"[a-z0-9][a-z0-9_-]{0,39}"  # What an entry may be called.


@dataclass(unsafe_hash=True)
class RobotConfig:
    """Which arm."""

    name: str = "xarm6"
    """One of the arms that are known, or custom."""
    path: str = ""
    """With robot=custom: URDF, xacro or MJCF (.xml) file of the arm."""
    base: str = ""
    """With robot=custom: the link or body that is fixed to the world; its frame is the base frame."""
    end_effector: str = ""
    """With robot=custom: the link, body or site that carries the tool."""
    approach: str = "z"
    """With robot=custom: the axis of the end effector that is the approach direction: x, y, z, -x, -y or -z."""
    srdf: str = ""
    """With robot=custom: SRDF file that says which pairs of links never touch; empty for none."""
    ignore: list[list[str]] = field(default_factory=list, hash=False)
    """With robot=custom: further pairs of links that are not checked for collision, as in [[base,hand],[base,arm]]."""

    def __post_init__(self) -> None:
        needed = ("path", "base", "end_effector")
        for name in (*needed, "approach", "srdf", "ignore"):
            value, custom = getattr(self, name), self.name == "custom"
            if value == "z":
                continue
            if custom and not value and name in needed:
                raise SettingError(
                    f"robot=custom needs robot.{name}. Give all of: robot=custom robot.path=robot.urdf "
                    "robot.base=<link> robot.end_effector=<link>."
                )
            if value and not custom:
                raise SettingError(f"robot.{name}={value} goes with robot=custom. Here robot={self.name}.")

    def load(self) -> "RobotDescription":
        """Description of the arm; what is worth knowing of one that does not ship is printed.

        Raises:
            SettingError: If a custom arm lacks something.
        """
        from richmap.robots.custom import custom_robot
        from richmap.robots.robots import load_robot

        if self.name != "custom":
            return load_robot(self.name)
        try:
            robot = custom_robot(self.path, self.base, self.end_effector, self.approach, self.srdf or None, self.ignore)
        except ValueError as error:
            raise SettingError(f"robot=custom: {error}") from error
        _introduce(robot)
        return robot


@cache
def _introduce(robot: "RobotDescription") -> None:
    """Say once what was left out of an arm's file, or taken for granted."""
    from richmap.motion.remarks import remarks

    print(f"{robot.name}:", *remarks(robot), sep="\n  ")


def robot_field(default: str, choices: tuple[str, ...] = (*ROBOTS, "custom")) -> RobotConfig:
    """The field of a schema that picks an arm."""
    return field(default_factory=partial(RobotConfig, default), metadata={"choices": choices})


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
    ground: float | None = None
    """Height above the base frame's origin, in m, that no link that moves may be below; null for no ground."""
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
        check_memory("map.target", self.target, self.target * 40 / 1e9)
        check_setting(self.device in ("cpu", "cuda"), "map.device", self.device, "cpu, cuda")
        check_setting(self.draw >= 1, "map.draw", self.draw, "a whole number >= 1")
        check_setting(self.turns.bit_count() == 1 <= self.turns, "map.turns", self.turns, "a power of two")
        check_memory("map.draw", self.draw, self.draw * 1e-5)
        check_memory("map.turns", self.turns, self.draw * self.turns * 5e-7)
        cells, bins = (2 * half_width / self.cell_size) ** 3, 24 / self.theta**2
        check_memory("map.cell_size", self.cell_size, cells * bins * 8 * 0.3 / 1e9)  # A third of the cells hold any.
        if self.ground is not None:
            check_setting(-10 <= self.ground <= 0.3, "map.ground", self.ground, "a number from -10 to 0.3, or null")


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
    yaw: float | None = None
    """Turn of the arm's base about the vertical, in rad, from -pi to pi; null for the setting's."""
    branch: str | None = None
    """Way of holding the tool: one that the arm's file names (a UR's wrist_out or wrist_in), or found (the best that is
    found); null for the setting's."""
    posture: list[float] | None = None
    """With the branch found: joint angles over the task's start that name it, in rad, instead of seeking them; null to
    seek them."""
    self_collision: bool | None = None
    """Whether links collide with each other, true or false; null for the setting's."""
    orientation_weight: float | None = None
    """Weight of orientation against position in the inverse kinematics, in m/rad, above 0; null for the default."""
    narrowed: list[float] = field(default_factory=list)
    """Joints whose limits are narrower than the arm's: number from 1 on, least and greatest angle in rad, one after
    another, as in arm.narrowed=[1,-1.05,1.05]; empty for none."""
    tool_length: float = 0.04
    """Of the tool, from the flange down, in m, from 0.02 to 0.3; its end is always held at the same height."""
    delay: float = 0.0
    """How late commands come to the arm, in s, from 0 to 1; a whole number of control steps of 0.1 s."""

    def __post_init__(self) -> None:
        base, weight = self.base, self.orientation_weight
        check_setting(0.02 <= self.tool_length <= 0.3, "arm.tool_length", self.tool_length, "a number from 0.02 to 0.3")
        steps = 10 * self.delay
        whole = 0 <= self.delay <= 1 and abs(steps - round(steps)) < 1e-9
        check_setting(whole, "arm.delay", self.delay, "tenths of a second from 0 to 1")
        if base is not None:
            near = len(base) == 3 and all(abs(x) <= 1 for x in base)
            check_setting(near, "arm.base", base, "[x,y,z] in m, each from -1 to 1")
        near = self.yaw is None or abs(self.yaw) <= math.pi
        check_setting(near, "arm.yaw", self.yaw, "a number from -pi to pi")
        if weight is not None:
            check_setting(0 < weight < math.inf, "arm.orientation_weight", weight, "a number above 0")


@dataclass
class ConditionConfig:
    """A condition of a suite: an arm, and how it stands and is limited."""

    robot: str = "ur3"
    """One of those that ship."""
    setting: str = "embodied"
    """What it may do (see benchmark.run)."""
    arm: ArmConfig = field(default_factory=ArmConfig)
    cause: str = ""
    """What direct transfer fails by there, for people."""
    saturated: bool = False
    """Whether direct transfer lacks next to nothing there: it shows harm, and counts for no share of head-room."""

    def __post_init__(self) -> None:
        check_setting(self.robot in ROBOTS, "robot", self.robot, ", ".join(ROBOTS))
        check_setting(self.setting in SETTINGS, "setting", self.setting, ", ".join(SETTINGS))


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
    video: bool = True
    """Whether the first episode of an evaluation is logged as a GIF, true or false."""

    def __post_init__(self) -> None:
        modes = ("online", "offline", "disabled")
        check_setting(self.mode in modes, "wandb.mode", self.mode, ", ".join(modes))
        check_folder(self.folder, "wandb.folder")


@dataclass(unsafe_hash=True)
class LimitsConfig:
    """What a class of guidance from a file may take; its process is ended beyond that."""

    seconds: float = 300.0
    """Time for its answers to a batch of episodes, in s of the clock; from 1 to 86400."""
    memory: float = 4.0
    """Resident memory of its process, in GB; from 0.5 to what the machine has."""

    def __post_init__(self) -> None:
        check_setting(1 <= self.seconds <= 86400, "limits.seconds", self.seconds, "a number from 1 to 86400")
        most = f"a number from 0.5 to {memory():.0f}, what this machine has"
        check_setting(0.5 <= self.memory <= memory(), "limits.memory", self.memory, most)


def check_method(name: str, setting: str, methods: Iterable[str]) -> None:
    """Raise `SettingError` unless this is one of these methods, or a class in a file that is there."""
    if not re.fullmatch(CLASS_IN_FILE, name):
        check_setting(name in methods, setting, name, f"{', '.join(methods)}, or a class in a file, as in mine.py:Mine")
    elif not Path(file := name.rpartition(":")[0]).is_file():
        raise SettingError(f"{setting}={name}: there is no file {file}.")


@dataclass
class RunConfig:
    """Rolls out the xArm6's policy on an arm, without guidance and with it, on the same episodes, and compares."""

    robot: RobotConfig = robot_field("ur3")
    """Arm that acts: one that ships (xarm6 is the source itself), or custom."""
    task: str = "block_push"
    """What is to be done: block_push, press_buttons, or a task of your own as module:NAME (an `envs.task.Task`; its
    code is run)."""
    guidance_scale: float | None = field(default=0.0, metadata={"more": said_of_each("scale")})
    """Scale of the method, any number >= 0; 0 is direct transfer, null the one that benchmark.choose_scales
    chose for this method and task, on validation episodes of all conditions of a suite; of a class in a file, its
    default_scale."""
    method: str = field(default="paper", metadata={"more": said_of_each("text")})
    """Guidance, or direct for none, or a subclass of policies.guidance.Guidance in a file, as in path/to/mine.py:Mine
    (its code is run, in a process of its own); or plain_oracle or aware_oracle, scripted ones in place of a policy."""
    suite: str = ""
    """Conditions on all of which the method is rolled out, at its chosen scale, in place of robot, setting and arm:
    push-v1 (conditions with head-room) or official (four arms, embodied and best); a file of conf/suite each."""
    seeds: list[int] = field(default_factory=lambda: [42, 43, 44])
    """With suite=: training seeds of the policies, in place of seed."""
    conditions: dict[str, ConditionConfig] = field(default_factory=dict)
    """Of the suite, by name."""
    episodes: int = 50
    """Number of episodes per lambda; a whole number >= 1."""
    recipe: str = USUAL
    """What the policy learned from: robust (episodes most of which are disturbed on purpose) or clean (undisturbed
    episodes alone, as in the paper)."""
    seed: int = 42
    """Training seed of the policy, a whole number >= 0."""
    checkpoint: int = 1
    """Which of that seed's checkpoints, by rank on the validation episodes, from 1: seed<seed>-<checkpoint>, of other
    recipes than robust with the recipe's name before that; the one that ships, or else the one that
    benchmark.source_policies or benchmark.train left in outputs."""
    policy: str = ""
    """Folder of a LeRobot checkpoint to run instead, of any type that sees states or pictures; empty for the one that
    recipe, seed and checkpoint pick. One that is not of type guided_push samples as it was saved (not by sampler), and
    only with lambda=0."""
    setting: str = "embodied"
    """What the arm may do: embodied (joint limits and self-collision bind) or original (neither does, as where only the
    arm is swapped in the original task) or best (as embodied, with the base where benchmark.studies.place_bases finds
    the arm to reach the most)."""
    scales_dir: str = "results/scales"
    """With lambda=null: the folder of <task>.yaml, which holds the chosen scale of each method."""
    output_dir: str = "results"
    """Folder that results go to, such as episodes."""
    device: str = "auto"
    """Where the policy runs: cpu, cuda, or auto (cuda if there is one)."""
    seed_start: int = VALIDATION.start
    """Seed of the first episode: from 50000 to 59999 are validation episodes, for every choice; from 100000 on test
    episodes, for final figures: protocol=paper takes 50 from 100000 on, tables those from 150000 to 150099; 160000 to
    160099 are shut (docs/protocol.md)."""
    sampler: str = "DDIM"
    """Sampler of the diffusion policy: DDIM or DDPM."""
    sampling_steps: int = 10
    """Denoising steps per action chunk; a whole number from 1 to 100."""
    batch_size: int = 10
    """Rows of the batch in which the policy is evaluated; an episode's row and this number are stored with it, since
    float results depend on the batch's shape. A whole number >= 1."""
    workers: int = 2
    """Processes that roll out or sample; results do not depend on it. A whole number >= 1."""
    arm: ArmConfig = field(default_factory=ArmConfig)
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)
    wandb: WandbConfig = field(default_factory=WandbConfig)
    limits: LimitsConfig = field(default_factory=LimitsConfig)

    def __post_init__(self) -> None:
        chosen_task(self.task)
        scale = self.guidance_scale
        check_method(self.method, "method", [*METHODS, *ORACLE_METHODS.values()])
        check_setting(bool(self.conditions) or not self.suite, "suite", self.suite, "a file of conf/suite")
        if scale is not None:
            check_setting(math.isfinite(scale) and scale >= 0, "lambda", scale, "any number >= 0, or null")
            guided = self.method not in ("direct", *ORACLE_METHODS.values())
            check_setting(scale == 0 or guided, "lambda", scale, f"0 with method={self.method}")
        if scale is not None and self.method in METHODS and METHODS[self.method].counts:
            check_setting(scale == int(scale), "lambda", scale, f"a whole number of samples with method={self.method}")
        for name in ("episodes", "batch_size", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        check_setting(self.seed >= 0, "seed", self.seed, "a whole number >= 0")
        check_setting(self.checkpoint >= 1, "checkpoint", self.checkpoint, "a whole number >= 1")
        check_recipe(self.recipe)
        covered = scale == 0 or self.map.half_width >= 0.8
        check_setting(covered, "map.half_width", self.map.half_width, "0.8 or more, so that the field covers the table")
        check_scenes(self.seed_start, self.episodes)
        check_folder(self.output_dir)
        check_setting(self.setting in SETTINGS, "setting", self.setting, ", ".join(SETTINGS))
        check_setting(self.device in ("cpu", "cuda", "auto"), "device", self.device, "cpu, cuda, auto")
        check_setting(self.sampler in ("DDIM", "DDPM"), "sampler", self.sampler, "DDIM, DDPM")
        steps = self.sampling_steps
        check_setting(1 <= steps <= 100, "sampling_steps", steps, "a whole number from 1 to 100")


@dataclass
class OracleConfig:
    """Rolls out the scripted oracle on an arm: what the task allows there without a learned policy."""

    robot: RobotConfig = robot_field("ur3")
    """Arm: xarm6, ur3, ur5 or ur10."""
    task: str = "block_push"
    """What is to be done: block_push, press_buttons, or a task of your own as module:NAME (an `envs.task.Task`; its
    code is run)."""
    setting: str = "embodied"
    """What the arm may do: original, embodied or best (see benchmark.run)."""
    oracle: str = "plain"
    """Which oracle: plain (the original's, blind to the arm) or aware (a planner, which pushes from where the arm can
    be)."""
    episodes: int = 300
    """Number of episodes; a whole number >= 1."""
    seed_start: int = VALIDATION.start
    """Seed of the first episode."""
    output_dir: str = "outputs/oracle"
    """Folder of <robot>-<setting>/episodes (with what of the arm is changed, as ur10-embodied-wrist_out)."""
    workers: int = 2
    """Processes that roll out; results do not depend on it. A whole number >= 1."""
    arm: ArmConfig = field(default_factory=ArmConfig)

    def __post_init__(self) -> None:
        chosen_task(self.task)
        for name in ("episodes", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        check_scenes(self.seed_start, self.episodes)
        check_folder(self.output_dir)
        check_setting(self.oracle in ORACLES, "oracle", self.oracle, ", ".join(ORACLES))
        check_setting(self.setting in SETTINGS, "setting", self.setting, ", ".join(SETTINGS))


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
class VerifyMapsConfig:
    """Scores an arm's maps on poses that inverse kinematics has labelled, beside the paper's figures."""

    robot: RobotConfig = robot_field("panda")
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
        taken = [*METHODS, *ORACLE_METHODS.values()]
        named = re.fullmatch(ENTRY_NAME, self.name) and self.name not in taken
        check_setting(bool(named), "name", self.name, f"a-z, 0-9, - and _, up to 40, and none of {', '.join(taken)}")
        for name in ("author", "description"):
            value = getattr(self, name)
            check_setting(bool(value.strip()) and value.isprintable(), name, value, "one line of text")
        check_setting(bool(self.policy or self.guidance), "policy", self.policy, "a folder, unless there is guidance")
        form = not self.guidance or re.fullmatch(CLASS_IN_FILE, self.guidance)
        check_setting(bool(form), "guidance", self.guidance, "a file and its class, as in guidance.py:MyGuidance")
        check_setting(self.field in ("energy", "feasibility", "none"), "field", self.field, "energy, feasibility, none")
        check_setting(math.isfinite(self.scale), "scale", self.scale, "a number")


def check_targets(robots: list[str]) -> None:
    """Raise `SettingError` unless these are arms that a policy can be transferred to, one or more."""
    targets = [name for name in ROBOTS if name != SOURCE]
    for name in robots or ["[]"]:
        check_setting(name in targets, "robots", name, ", ".join(targets))


def in_tables(robot: str) -> int:
    """Where an arm comes in tables: the paper's first, then others that ship, then those that do not."""
    order = [*PAPER_ARMS, *(name for name in ROBOTS if name not in PAPER_ARMS)]
    return order.index(robot) if robot in order else len(order)


def check_folder(folder: str, setting: str = "output_dir") -> None:
    """Raise `SettingError` unless the folder, or the one to make it in, can be written to."""
    check_setting(bool(folder), setting, folder, "the name of a folder")
    existing = next(path for path in [Path(folder), *Path(folder).absolute().parents] if path.exists())
    allowed = f"a folder that can be written to; {existing} cannot. Choose another: {setting}=/some/folder"
    check_setting(existing.is_dir() and os.access(existing, os.W_OK), setting, folder, allowed)
    try:
        TemporaryFile(dir=existing).close()  # /proc and /sys say that they can be written to.
    except OSError as error:
        raise SettingError(f"{setting}={folder} is not allowed. Allowed: {allowed}.") from error


def check_file(file: str, setting: str = "output") -> None:
    """Raise `SettingError` unless a file of this name can be written: what is there and is no regular file stays."""
    path = Path(file)
    check_setting(bool(file) and bool(path.name), setting, file, "the name of a file")
    regular = path.is_file() or not (path.exists() or path.is_symlink())
    check_setting(regular, setting, file, f"a new file, or one to replace; {file} is there, and no regular file")
    check_folder(str(path.parent), setting)
