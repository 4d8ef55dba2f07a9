"""How a command's settings are composed: its schema, what its groups can be, and the files in `conf/`."""

from contextlib import AbstractContextManager
from pathlib import Path

from hydra import initialize, initialize_config_dir
from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

from benchmark.settings.chosen_scales import chosen_scales
from benchmark.settings.overrides import quoted
from benchmark.settings.setting import as_typed, choices_of
from policies.methods import DIRECT

CONF = Path(__file__).parents[1] / "conf"

QUIET = {
    "defaults": [{"override /hydra/job_logging": "none"}, {"override /hydra/hydra_logging": "none"}],
    "hydra": {
        "run": {"dir": "."},
        "output_subdir": None,
        "callbacks": {"run": {"_target_": "benchmark.settings.run_folder.RunStart"}},
    },
}
"""Hydra keeps no log and no folder of its own for a run."""


def register(schema: type, name: str) -> None:
    """Tell Hydra of a command's schema, of what its groups can be, and, if no file does, how it is composed.

    In the files `${chosen:folder,task}` is direct transfer and the methods that have a chosen scale in a folder of
    chosen scales, to sweep over.
    """
    OmegaConf.register_new_resolver("chosen", _chosen, replace=True)
    store, plain, choices = ConfigStore.instance(), as_typed(schema), choices_of(schema)
    for group in [name for name, node in store.repo.items() if isinstance(node, dict) and name != "hydra"]:
        del store.repo[group]  # Of a command that this process ran before: here it can be a setting.
    for group, values in choices.items():
        for value in values:
            store.store(group=group, name=value, node={"name": value})
    store.store(f"{name}_schema", plain)
    store.store("quiet", QUIET, package="_global_")
    if not _has_files(name):
        chosen = [{group: plain[group]["name"]} for group in choices]
        store.store(name, {"defaults": [f"{name}_schema", "quiet", *chosen, "_self_"]})


def _chosen(folder: str, task: str) -> str:
    return ",".join(map(quoted, (DIRECT, *chosen_scales(folder, task))))


def files_of(name: str) -> str | None:
    """Folder of a command's files; None if it has none: then none of their groups hides a setting of that name."""
    return str(CONF) if _has_files(name) else None


def composing(folder: str | None) -> AbstractContextManager[None]:
    """Where Hydra composes settings, with the files of a folder or with none."""
    return initialize_config_dir(folder, version_base="1.3") if folder else initialize(None, version_base="1.3")


def _has_files(name: str) -> bool:
    return (CONF / f"{name}.yaml").exists()


def file_groups(name: str) -> list[str]:
    """The groups of files in `conf/` of which a command takes none by default."""
    if not _has_files(name):
        return []
    defaults = [entry for entry in OmegaConf.load(CONF / f"{name}.yaml").defaults if not isinstance(entry, str)]
    return [group for entry in defaults for group in entry if entry[group] is None]
