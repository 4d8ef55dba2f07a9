"""Which demonstrations a task's scripted expert gives: how many, and how they are disturbed."""

from dataclasses import asdict, dataclass, field
from pathlib import Path

from benchmark.settings.paths import check_folder
from benchmark.settings.scenes import VALIDATION
from benchmark.settings.setting import SettingError, check_setting
from benchmark.settings.task import chosen_task
from envs.demonstrator import Demonstrator


@dataclass
class CollectConfig:
    """Which demonstrations the expert gives; with all shares 0 clean ones alone, like the published data."""

    task: str = "block_push"
    """What is demonstrated: block_push or press_buttons."""
    episodes: int | None = None
    """Number of demonstrations; the disturbed ones are all successful, the clean ones as they come. None for the usual
    number, 1000 of block_push and 2500 of press_buttons."""
    seed_start: int = 0
    """Seed of the first episode's scene; seeds below 50000 are for demonstrations."""
    shares: list[str] = field(default_factory=list)
    """Share of episodes of a kind, as in shares=[noise:0.5,bursts:0]; what is not named is as usual, and the rest is
    clean. noise: noise on the executed action now and then (usually 0.2); bursts: and a few steps in a wrong direction
    (block_push 0.35, press_buttons 0.4); wide: like bursts, and from scenes all over the table (block_push 0.25);
    crowded: like bursts, with a block in or at a target, and other things close by (block_push 0.1); shown: like
    bursts, with buttons shown as pressed that are not (press_buttons 0.2)."""
    burst_probability: float = 0.03
    """Chance per step that a burst begins, in the kinds that have bursts."""
    detours: bool = True
    """Whether ways between pushes bend around blocks, but in clean episodes; the oracle's own are straight."""
    image_size: int = 0
    """Width and height of pictures, in pixels from 8 to 2048, that are stored as video in place of the environment's
    state, as in image_size=96; 0 for none. benchmark.train learns from states alone."""
    output_dir: str | None = None
    """Folder of the dataset; None for demonstrations/<task>."""
    workers: int = 2
    """Processes that simulate; the data do not depend on it."""

    def __post_init__(self) -> None:
        for name, number in {"episodes": self.count, "workers": self.workers}.items():
            check_setting(number >= 1, name, number, "a whole number >= 1")
        check_setting(self.count <= VALIDATION.start, "episodes", self.count, f"{VALIDATION.start} at most")
        last = VALIDATION.start - self.count
        check_setting(0 <= self.seed_start <= last, "seed_start", self.seed_start, f"a whole number from 0 to {last}")
        if self.output_dir is not None and not Path(self.output_dir, "meta", "collect.json").is_file():
            check_folder(self.output_dir)
        kinds = dict(self.demonstrator.kinds)
        for each in self.shares:
            kind, _, share = each.partition(":")
            right = kind in kinds and share.replace(".", "", 1).isdecimal()
            check_setting(right, "shares", each, f"kind:share, the kinds of {self.task}: {', '.join(kinds)}")
        shown = {"burst_probability": self.burst_probability} | {f"shares.{k}": v for k, v in self.of_kinds.items()}
        for name, value in shown.items():
            check_setting(0 <= value <= 1, name, value, "a number from 0 to 1")
        drawn = self.image_size == 0 or 8 <= self.image_size <= 2048
        check_setting(drawn, "image_size", self.image_size, "a whole number of pixels from 8 to 2048, or 0 for none")
        total = sum(self.of_kinds.values())
        check_setting(total <= 1 + 1e-9, "shares", total, "a sum of 1 at most; the rest is clean")

    @property
    def demonstrator(self) -> Demonstrator:
        """The task's.

        Raises:
            SettingError: If it has none.
        """
        demonstrator = chosen_task(self.task).demonstrator
        if demonstrator is None:
            raise SettingError(f"task={self.task}: it gives no demonstrations (envs.task.Task.demonstrator).")
        return demonstrator

    @property
    def count(self) -> int:
        """`episodes`, or the usual number."""
        return self.demonstrator.episodes if self.episodes is None else self.episodes

    @property
    def of_kinds(self) -> dict[str, float]:
        """`shares` of all kinds."""
        given = dict(each.split(":") for each in self.shares)
        return {kind: float(given.get(kind, share)) for kind, share in self.demonstrator.kinds}

    @property
    def folder(self) -> str:
        """`output_dir`, or the usual one."""
        return f"demonstrations/{self.task}" if self.output_dir is None else self.output_dir

    @property
    def recipe(self) -> dict[str, object]:
        """What decides the data: everything but where they are stored and how many processes work."""
        without = {"output_dir", "workers"} | ({"image_size"} if not self.image_size else set())
        settled = {**asdict(self), "episodes": self.count, "shares": self.of_kinds}
        return {key: value for key, value in settled.items() if key not in without}
