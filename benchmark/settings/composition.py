"""How a command's settings are composed: its schema, what its groups can be, and the files in `conf/`."""

from pathlib import Path

from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

from benchmark.settings.setting import as_typed, choices_of
from policies.methods import METHODS

CONF = Path(__file__).parents[1] / "conf"


def register(schema: type, name: str) -> None:
    """Tell Hydra of a command's schema, of what its groups can be, and, if no file does, how it is composed.

    In the files `${methods:}` is the names of all methods of guidance, to sweep over.
    """
    OmegaConf.register_new_resolver("methods", lambda: ",".join(METHODS), replace=True)
    store, plain, choices = ConfigStore.instance(), as_typed(schema), choices_of(schema)
    for group, values in choices.items():
        for value in values:
            store.store(group=group, name=value, node={"name": value})
    store.store(f"{name}_schema", plain)
    if not (CONF / f"{name}.yaml").exists():
        chosen = [{group: plain[group]["name"]} for group in choices]
        store.store(name, {"defaults": [f"{name}_schema", "quiet", *chosen, "_self_"]})


def file_groups(name: str) -> list[str]:
    """The groups of files in `conf/` of which a command takes none by default."""
    file = CONF / f"{name}.yaml"
    if not file.exists():
        return []
    defaults = [entry for entry in OmegaConf.load(file).defaults if not isinstance(entry, str)]
    return [group for entry in defaults for group in entry if entry[group] is None]
