"""Somebody else's entry: a folder with a policy, a guidance class or both, and what has to be known of them."""

import hashlib
import json
import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from omegaconf import DictConfig, OmegaConf

from benchmark.artifacts.checkpoint import GUIDED, Checkpoint
from benchmark.artifacts.fields import guidance_field
from benchmark.artifacts.known_policies import checkpoint_folder
from benchmark.rollouts.guidance_class import GuidanceClass
from benchmark.rollouts.make_condition import make_condition
from benchmark.settings.config import LimitsConfig, RunConfig
from benchmark.settings.entry_config import EntryConfig
from benchmark.settings.setting import SettingError
from benchmark.settings.typed import typed
from policies.method import is_of
from richmap.given_files import check_no_aliases, given_text

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from benchmark.rollouts.rollout import Rollout
    from envs.arm.placed_arm import PlacedArm
    from envs.task import Task


LARGEST = 4 << 30
"""Bytes of a file of an entry."""
MOST_BYTES = 10_000
"""Of an entry.yaml."""
MOST_BRACKETS = 20
"""Likewise: YAML takes long over nested ones."""


@dataclass(frozen=True)
class Entry:
    """A folder and what its `entry.yaml` says; or a class in a file, and what that says of itself."""

    folder: Path
    about: EntryConfig
    default_scale: float | None = None
    """Of a class in a file, if it names one."""
    pattern: str = "*"
    """Which of the folder's files are the entry's."""
    run: int = 1
    """Which of its final runs this is: one with other files is a further one."""

    @classmethod
    def load(cls, folder: Path) -> "Entry":
        """The entry in a folder.

        Raises:
            SettingError: If it is none, or says what it cannot.
        """
        file = folder / "entry.yaml"
        if not file.is_file():
            raise SettingError(f"entry={folder} is no entry: it lacks entry.yaml. See docs/submit.md.")
        try:
            text = given_text(file, MOST_BYTES)
            if text.count("[") + text.count("{") > MOST_BRACKETS:
                raise SettingError(f"{file} cannot be read: it has lists in lists. It is a few lines of key: value.")
            check_no_aliases(text)
            said = OmegaConf.load(file)
            if "${" in str(OmegaConf.to_container(said, resolve=False)):
                raise SettingError(f"{file} has ${{...}}. What it says stands in the file itself: write the value.")
        except SettingError:
            raise
        except Exception as error:  # What YAML makes of a value raises whatever it comes across.
            raise SettingError(f"{file} cannot be read: {' '.join(str(error).split()) or repr(error)}") from error
        known = [each.name for each in fields(EntryConfig)]
        if not isinstance(said, DictConfig):
            raise SettingError(f"{file} is not lines of key: value. It may say: {', '.join(known)}.")
        if unknown := sorted(map(str, {*said} - {*known})):
            raise SettingError(f"{file}: there is no {', '.join(unknown)}. It may say: {', '.join(known)}.")
        said = OmegaConf.create({key: value for key, value in said.items() if value is not None})
        try:
            about = typed(said, EntryConfig)
        except SettingError as error:
            raise SettingError(f"{file}: {error}") from error
        return cls(folder, about)

    @classmethod
    def of_class(cls, text: str, limits: LimitsConfig) -> "Entry":
        """A class in a file, written `path/to/mine.py:Mine`, with the Python files beside it; called `mine`.

        Raises:
            SettingError: If the file does not have such a class, or one of our methods is called so.
        """
        file, name = text.rsplit(":", 1)
        guidance = GuidanceClass(Path(file), name, limits.seconds, limits.memory)
        said = guidance.attributes()
        called = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", name).lower()
        about = {"name": called, "author": "nobody", "description": name, "guidance": f"{guidance.file.name}:{name}"}
        try:
            made = EntryConfig(**about, field=said.field_kind, scale=said.default_scale or 0.0)
        except SettingError as error:
            raise SettingError(f"{text} is called as its class is, {called}. {error}") from error
        return cls(guidance.file.parent, made, said.default_scale, "*.py")

    @property
    def kind(self) -> str | None:
        """Of the field that its class is made with."""
        return None if self.about.field == "none" else self.about.field

    @property
    def method(self) -> str:
        """What it is called in tables: its name, with the number of a further final run, as in `mine~2`."""
        return self.about.name if self.run == 1 else f"{self.about.name}~{self.run}"

    def numbered(self, rows: "pd.DataFrame") -> "Entry":
        """The same entry with the number of the final run that it is after these rows, of its earlier ones."""
        made = {}
        for method, files in () if rows.empty else zip(rows.method, rows.entry_hash, strict=True):
            made[run_of(method)] = files
        known = [number for number, files in made.items() if files == self.files_hash]
        return replace(self, run=known[0] if known else max(made, default=0) + 1)

    def at(self, scale: float) -> "Entry":
        """The same entry with its class made at another scale."""
        return replace(self, about=replace(self.about, scale=scale))

    @cached_property
    def files_hash(self) -> str:
        """SHA-256 over the names and contents of its files, but for hidden ones and Python's own; of `entry.yaml` over
        what it says, without the scale, which a row has beside it.

        Raises:
            SettingError: If one is a link, whose target could change unseen.
        """
        digest = hashlib.sha256()
        for path in sorted(self.folder.rglob("*") if self.pattern == "*" else self.folder.glob(self.pattern)):
            name = path.relative_to(self.folder)
            if _unhashed(name):
                continue
            if path.is_symlink() and self.pattern == "*":
                raise SettingError(f"{path} is a link. An entry holds its files itself: copy it there.")
            if path.is_file():
                if (size := path.stat().st_size) > LARGEST:
                    raise SettingError(f"{path} has {size / 1e9:.0f} GB. Allowed: {LARGEST / 1e9:.1f} GB.")
                content = path.read_bytes()
                if name == Path("entry.yaml"):
                    content = json.dumps(self._said, sort_keys=True).encode()
                digest.update(os.fsencode(name.as_posix()) + f"\0{len(content)}\0".encode() + content)
        return digest.hexdigest()

    @property
    def _said(self) -> dict[str, object]:
        """What its `entry.yaml` says that is not the usual, without the scale."""
        said = [(each.name, getattr(self.about, each.name), each.default) for each in fields(self.about)]
        return {name: value for name, value, usual in said if name != "scale" and value != usual}

    def checkpoints(self, seeds: list[int], task: str, ranks: Iterable[int] = (1,)) -> list[Path]:
        """Folders of its policies: its own, or ours for a task of these training seeds, of each those of these ranks.

        Raises:
            SettingError: If one is not there, or is to be guided and cannot be.
        """
        if not self.about.policy:
            return [checkpoint_folder(seed, rank, task=task) for seed in seeds for rank in ranks]
        checkpoint = Checkpoint.from_path(str(self._inside(self.about.policy)))
        if checkpoint.type == GUIDED and checkpoint.guidance_scale:
            raise SettingError(
                f"{self.folder / 'entry.yaml'}: policy={self.about.policy} is saved with guidance of its own "
                f"(guidance_scale={checkpoint.guidance_scale:g}), which is not used here. Set it to 0 in its "
                "config.json, and bring a class as guidance."
            )
        if self.about.guidance and checkpoint.type != GUIDED:
            raise SettingError(
                f"{self.folder / 'entry.yaml'}: guidance needs a policy of type {GUIDED}, whose sampling can be "
                f"guided; policy={self.about.policy} is of type {checkpoint.type}. Leave one of them out."
            )
        return [checkpoint.folder]

    def rollout(
        self, config: RunConfig, task: "Task", arm: "PlacedArm", checkpoint: Path, console: "Console"
    ) -> "Rollout":
        """What is rolled out on an arm; builds the field if one is needed and not in the cache.

        Raises:
            SettingError: If its class cannot be made.
        """
        from benchmark.rollouts.rollout import Rollout

        about = self.about
        if not is_of(self.kind, task.space):
            raise SettingError(
                f"{self.method} asks for a field of {self.kind}, of a tool that is held upright at one height, block "
                f"push's, unlike that of {task.name}. Ask for energy, coverage, branch_coverage or witness."
            )
        if about.policy and Checkpoint(checkpoint).type == GUIDED:
            sampler, steps = Checkpoint(checkpoint).sampler  # As it was saved, whatever ours are sampled by.
            config = replace(config, sampler=sampler, sampling_steps=steps)
        field, path = guidance_field(self.kind, arm, config.map, config.energy, config.workers, console)
        condition = make_condition(config, task, arm, self.method, about.scale, checkpoint, field, self.files_hash)
        guidance = self.guidance(config.limits, Path(config.output_dir))
        if guidance is not None:
            guidance.make(about.scale, path, arm.base[:2], 0, task.space.action.width)
        return Rollout(task, arm, condition, checkpoint, path, guidance, self.kind)

    def guidance(self, limits: LimitsConfig, rows: Path) -> GuidanceClass | None:
        """Its class, if it brings one, and what that may take; it may not change the folder of its rows."""
        if not self.about.guidance:
            return None
        file, name = self.about.guidance.rsplit(":", 1)
        return GuidanceClass(self._inside(file), name, limits.seconds, limits.memory, rows, self.files_hash)

    def _inside(self, path: str) -> Path:
        """A path of the folder's."""
        inside = (self.folder / path).resolve()
        if not inside.is_relative_to(self.folder.resolve()):
            raise SettingError(f"{self.folder / 'entry.yaml'}: {path} lies outside of the entry. Copy it there.")
        if _unhashed(inside.relative_to(self.folder.resolve())):
            raise SettingError(
                f"{self.folder / 'entry.yaml'}: {path} is hidden, or Python's own, and could change unseen. Rename it."
            )
        return inside


def run_of(method: str) -> int:
    """Which of an entry's final runs a row is of, by its method."""
    _, _, number = method.partition("~")
    return int(number or 1)


def _unhashed(name: Path) -> bool:
    """Whether a file of an entry is left out of its hash: hidden ones and Python's own."""
    return any(part.startswith(".") or part == "__pycache__" for part in name.parts)
