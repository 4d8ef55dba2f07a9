"""Which demonstrations the oracle gives: how many, and how they are disturbed."""

from dataclasses import asdict, dataclass

from benchmark.settings.command import check_setting
from benchmark.settings.paths import check_folder
from benchmark.settings.scenes import check_scenes


@dataclass
class CollectConfig:
    """Which demonstrations the oracle gives; with all shares 0 clean ones alone, like the published data."""

    episodes: int = 1000
    """Number of demonstrations; the disturbed ones are all successful, the clean ones as they come."""
    seed_start: int = 0
    """Seed of the first episode's scene; seeds 0 to 999 are for demonstrations."""
    share_noise: float = 0.2
    """Share of episodes with Gaussian noise on the executed action now and then."""
    share_bursts: float = 0.35
    """Share of episodes with that noise, and bursts of a few steps in a wrong direction."""
    share_wide: float = 0.25
    """Share of episodes like the last kind that also start from scenes all over the table."""
    share_crowded: float = 0.1
    """Share of episodes like the last kind but with a block in or at a target, and other things close by."""
    burst_probability: float = 0.03
    """Chance per step that a burst begins, in the kinds that have bursts."""
    detours: bool = True
    """Whether the oracle's ways between pushes bend around blocks, but in clean episodes; its own are straight."""
    image_size: int = 0
    """Width and height of pictures, in pixels from 8 to 2048, that are stored as video in place of the state of blocks
    and targets, as in image_size=96; 0 for none. benchmark.train learns from states alone."""
    output_dir: str = "demonstrations/robust"
    """Folder of the dataset."""
    workers: int = 2
    """Processes that simulate; the data do not depend on it."""

    def __post_init__(self) -> None:
        for name in ("episodes", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        check_scenes(self.seed_start, self.episodes)
        check_folder(self.output_dir)
        shares = ("share_noise", "share_bursts", "share_wide", "share_crowded")
        for name in (*shares, "burst_probability"):
            check_setting(0 <= getattr(self, name) <= 1, name, getattr(self, name), "a number from 0 to 1")
        drawn = self.image_size == 0 or 8 <= self.image_size <= 2048
        check_setting(drawn, "image_size", self.image_size, "a whole number of pixels from 8 to 2048, or 0 for none")
        total = sum(getattr(self, name) for name in shares)
        check_setting(total <= 1 + 1e-9, " + ".join(shares), total, "a sum of 1 at most; the rest is clean")

    @property
    def recipe(self) -> dict[str, object]:
        """What decides the data: everything but where they are stored and how many processes work."""
        without = {"output_dir", "workers"} | ({"image_size"} if not self.image_size else set())
        return {key: value for key, value in asdict(self).items() if key not in without}
