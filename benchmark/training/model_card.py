"""The README of a checkpoint: what it is, how it was made, how to load it; the Hub reads the lines at its head."""

import json
from collections.abc import Mapping
from pathlib import Path

from policies.modeling_guided_push import LOADING

TEMPLATE = """---
license: mit
library_name: lerobot
pipeline_tag: robotics
model_name: guided_push
tags: [lerobot, robotics, guided_push]
datasets: [{dataset}]
---

# Source policy `{name}`

*{task}* A guided diffusion policy (LeRobot policy type `guided_push`) of the {robot}, from states. The weights are the
exponential moving average over training.

- Demonstrations: {episodes} episodes of the scripted oracle, {frames} frames: {kinds}.
  Labels are always the oracle's actions. In all kinds but `clean` another action is executed now and then
  (`python -m benchmark.collect --help` says how): those are not the task's published demonstrations.
- Augmentation: {augmentation}.
- Training: {step} of {steps} steps of {batch_size} observations, seed {seed}, {precision} products on {device}.
- Action units: 1 in the network is {units}. Its numbers are clipped to ±1; an action comes out in these units.
- Commit: {commit}.
- Sampler: {sampler} with {sampling_steps} of {training_levels} noise levels, {prediction} prediction.

Made by `python -m benchmark.train` with

```json
{config}
```

{loading}

Or evaluate it with LeRobot, which finds the type itself where the project is installed:

    lerobot-eval --policy.path=<this folder> --env.type=guided_push --env.task={environment} \\
        --eval.n_episodes=50 --seed=50000

Licence: MIT, like the code that made it.
"""


def write_model_card(folder: Path, name: str, facts: Mapping[str, object], config: Mapping[str, object]) -> None:
    """Writes README.md beside the weights.

    Args:
        folder: Checkpoint folder.
        name: Name of the checkpoint, such as seed42-1.
        facts: What the template asks for and the configuration does not say.
        config: The training configuration, as plain values.
    """
    text = TEMPLATE.format(name=name, config=json.dumps(config, indent=2), loading=LOADING.strip(), **facts)
    (folder / "README.md").write_text(text)
