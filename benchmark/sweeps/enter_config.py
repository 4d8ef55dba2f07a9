"""Settings of `benchmark.enter`."""

from dataclasses import dataclass, field, fields
from pathlib import Path

from benchmark.scoring.ranking import Protocol, protocols_of
from benchmark.settings.config import ConditionConfig, LimitsConfig, RunConfig
from benchmark.settings.map_config import EnergyConfig, MapConfig
from benchmark.settings.robot_config import PAPER_ARMS, RobotConfig
from benchmark.settings.scenes import FIRST_TEST_SEED, VALIDATION
from benchmark.settings.setting import check_setting
from benchmark.settings.suite import suite_conditions, suite_scenes
from benchmark.settings.task import chosen_task

SUITE_EPISODES = 50
"""Validation scenes of a condition of a suite."""


@dataclass
class EnterConfig:
    """Evaluates somebody else's entry on the test episodes, or on a suite, or checks a table that was sent with it."""

    task: str = "block_push"
    """What is to be done (see benchmark.run)."""
    entry: str = ""
    """Folder of the entry: entry.yaml, and what it names. Its code is run: read it first."""
    table: str = ""
    """A table of episodes that was sent with the entry, a folder or one Parquet file: nothing is stored, the table is
    checked. Empty to evaluate."""
    replays: int | None = None
    """With table=: how many of its rows, drawn at random, are rolled out again; null for all of them (6,000 take about
    20 minutes). If all of n come out alike, fewer than 3 / n of the table are edited, at 95 %."""
    robots: list[str] = field(default_factory=lambda: list(PAPER_ARMS))
    """Arms, as in robots=[ur3,ur5]; the protocol has all four."""
    settings: list[str] = field(default_factory=lambda: ["embodied"])
    """What the arms may do (see benchmark.run): embodied, best or both, as in settings=[embodied,best], by the strict
    protocol (100 episodes of the best policy of each seed), or original by the paper's (50 of three of each)."""
    episodes: int | None = None
    """Number of episodes per arm, setting and policy; null for the protocol's."""
    seed_start: int | None = None
    """Seed of the first episode; null for the protocol's. From 100000 on are test episodes, by which nothing is chosen:
    tune on those from 50000 on, the validation episodes."""
    scale: list[float] = field(default_factory=list)
    """Scales to try instead of the one in entry.yaml, as in scale=[0.25,0.5], on validation episodes alone; empty for
    that one."""
    suite: str = ""
    """Conditions on all of which the entry is rolled out, in place of task, robots and settings (see benchmark.run), on
    50 validation scenes unless final=true: full for its place among all methods, a policy of its own on a suite of its
    task, such as push-v1."""
    only: list[str] = field(default_factory=list)
    """With suite=: some of its conditions by name, as in only=[push-ur5-elbow]; empty for all."""
    final: bool = False
    """With suite=: whether it is rolled out on the suite's test scenes, true or false. A final run with other files of
    the entry than the one before is a further row, as my-entry~2."""
    seeds: list[int] = field(default_factory=lambda: [42, 43, 44])
    """Training seeds of the policies that an entry without a policy of its own guides."""
    output_dir: str = "results/entries"
    """Folder in which a folder of the entry's name gets its episodes and entry.yaml."""
    device: str = "cpu"
    """Where the policy runs: cpu, as those that it is compared with, cuda, or auto (cuda if there is one)."""
    batch_size: int | None = None
    """Rows of the batch in which the policy is evaluated (see benchmark.run); null for the protocol's, as those have
    that it is compared with."""
    workers: int = 2
    """Processes that roll out or sample; results do not depend on it. A whole number >= 1."""
    map: MapConfig = field(default_factory=MapConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)
    limits: LimitsConfig = field(default_factory=LimitsConfig)

    def __post_init__(self) -> None:
        some = self.replays is None or self.replays >= 1
        check_setting(some, "replays", self.replays, "a whole number >= 1, or null for all rows")
        self._begin_suite()
        check_setting(bool(self.robots), "robots", self.robots, f"some of {', '.join(PAPER_ARMS)}")
        protocols = protocols_of(chosen_task(self.task))
        allowed = " or ".join(", ".join(protocol.settings) for protocol in protocols)
        fits = any({*self.settings} <= {*protocol.settings} for protocol in protocols)
        check_setting(bool(self.settings) and fits, "settings", self.settings, allowed)
        self.episodes = self.protocol.episodes if self.episodes is None else self.episodes
        self.seed_start = self.protocol.scenes.start if self.seed_start is None else self.seed_start
        self.batch_size = self.protocol.batch_size if self.batch_size is None else self.batch_size
        check_setting(bool(self.seeds), "seeds", self.seeds, "one or more whole numbers")
        tuned = not self.scale or self.scenes.start < FIRST_TEST_SEED
        check_setting(tuned, "scale", self.scale, "none on test episodes; try scales with seed_start=50000")
        for name in ("robots", "settings", "seeds", "scale", "only"):
            given = getattr(self, name)
            check_setting(len({*given}) == len(given), name, given, "each of them once")
        self.runs("")

    def _begin_suite(self) -> None:
        """Take the scenes that a suite has."""
        if not self.suite:
            check_setting(not self.final, "final", self.final, "false without suite=")
            check_setting(not self.only, "only", self.only, "empty without suite=")
            return
        known = suite_conditions(self.suite)
        check_setting({*self.only} <= {*known}, "only", self.only, f"some of {', '.join(known)}")
        scenes = suite_scenes(self.suite)
        if self.final:
            tests = scenes.start >= FIRST_TEST_SEED
            check_setting(tests, "suite", self.suite, "with final=true, one that has test scenes, such as full")
            given = self.seed_start is None and self.episodes is None
            check_setting(given, "final", self.final, "false with scenes of your own (seed_start, episodes)")
            self.seed_start, self.episodes = scenes.start, len(scenes)
            return
        self.seed_start = VALIDATION.start if self.seed_start is None else self.seed_start
        self.episodes = SUITE_EPISODES if self.episodes is None else self.episodes
        inside = VALIDATION.start <= self.seed_start <= VALIDATION.stop - self.episodes
        validation = f"validation scenes, {VALIDATION[0]} to {VALIDATION[-1]}, without final=true"
        check_setting(inside, "seed_start", self.seed_start, validation)

    @property
    def scenes(self) -> range:
        """Seeds of the episodes."""
        assert self.seed_start is not None and self.episodes is not None
        return range(self.seed_start, self.seed_start + self.episodes)

    @property
    def protocol(self) -> Protocol:
        """The one that counts episodes of these settings."""
        return next(
            protocol for protocol in protocols_of(chosen_task(self.task)) if self.settings[0] in protocol.settings
        )

    @property
    def conditions(self) -> dict[str, ConditionConfig]:
        """Those of the suite that are asked for."""
        return {name: each for name, each in suite_conditions(self.suite).items() if name in (self.only or [name])}

    def runs(self, name: str) -> list[list[RunConfig]]:
        """Settings of the rollouts of what is called so, task by task: of each arm and setting, or of a suite."""
        names = {each.name for each in fields(RunConfig)} & {*vars(self)} - {"output_dir"}
        given = {each: getattr(self, each) for each in names} | {"output_dir": str(Path(self.output_dir, name))}
        if self.suite:
            return [[part] for part in RunConfig(conditions=self.conditions, **given).parts]
        arms = [(robot, setting) for setting in self.settings for robot in self.robots]
        return [[RunConfig(robot=RobotConfig(robot), setting=setting, **given) for robot, setting in arms]]
