"""The README of a data set: what is in it, how it was made, how to load and push it; the Hub reads the lines at its
head."""

from pathlib import Path

from huggingface_hub import DatasetCard
from lerobot.datasets import LeRobotDatasetMetadata, create_lerobot_dataset_card

from benchmark.settings.robot_config import SOURCE_IN_WORDS
from benchmark.settings.task import chosen_task
from benchmark.training.demonstration_recipe import CollectConfig

TEMPLATE = """
# Demonstrations `{name}`

*{task}* A LeRobotDataset of {episodes} episodes of a scripted oracle on the {robot}: {frames} frames, {fps} per second.

{columns}

`action` is the oracle's, in {units}; in every `kind` but clean another one was executed now and then. `seed` is that
of the episode's scene. meta/info.json names all numbers, and meta/collect.json says how the data were made:

    python -m benchmark.collect {settings}

Load it:

```python
from lerobot.datasets import LeRobotDataset

dataset = LeRobotDataset("local/{name}", root="path/to/this/folder")
```

Push it. LeRobot writes a card of its own, so this one is pushed after it:

```python
from huggingface_hub import DatasetCard

LeRobotDataset("you/{name}", root="path/to/this/folder").push_to_hub(license="mit")
DatasetCard.load("path/to/this/folder/README.md").push_to_hub("you/{name}")
```
"""


def dataset_card(folder: Path, name: str, config: CollectConfig) -> str:
    """The card of a data set, with LeRobot's own lines at its head.

    Args:
        folder: Where the data set lies.
        name: What it is called.
        config: How it was made.
    """
    meta = LeRobotDatasetMetadata(f"local/{name}", root=folder)
    head = create_lerobot_dataset_card(["robotics", config.task.replace("_", "-")], license="mit").data
    shown = ("observation.", "action", "next.")
    columns = [
        f"- `{key}`: {feature['dtype']} {tuple(feature['shape'])}"
        for key, feature in sorted(meta.features.items())
        if key.startswith(shown)
    ]
    default = {**CollectConfig(config.task).recipe, "task": CollectConfig().task}
    changed = {key: value for key, value in config.recipe.items() if default.get(key) != value}
    if "shares" in changed:
        changed["shares"] = "[" + ",".join(f"{kind}:{share:g}" for kind, share in config.of_kinds.items()) + "]"
    text = TEMPLATE.format(
        name=name,
        task=chosen_task(config.task).description,
        episodes=meta.total_episodes,
        frames=meta.total_frames,
        fps=meta.fps,
        robot=SOURCE_IN_WORDS,
        columns="\n".join(columns),
        units=" and ".join(dict.fromkeys(chosen_task(config.task).space.action.units)),
        settings=" ".join(f"{key}={value}".lower() for key, value in changed.items()),
    )
    return str(DatasetCard(f"---\n{head.to_yaml()}\n---\n{text}"))
