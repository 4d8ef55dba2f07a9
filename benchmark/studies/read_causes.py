"""Failed episodes as pictures and traces without the name of their cause, to be read by somebody, and what came of it.

python -m benchmark.run suite=candidates method=direct
python -m benchmark.studies.read_causes
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import batched
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.settings.command import run_command
from benchmark.settings.paths import check_folder
from benchmark.settings.setting import SettingError, check_setting
from benchmark.settings.suite import suite_conditions, tasks_of
from benchmark.settings.task import chosen_task
from policies.methods import DIRECT
from richmap.outputs import replacing

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from benchmark.rollouts.rollout import Rollout

PER_PAGE = 4
"""Episodes on a page."""
FRAMES = (-20, -10, -5, 0, 5, 20)
"""Pictures of an episode, in steps from where its fault began."""


@dataclass
class ReadCausesConfig:
    """Draws failed episodes as pictures and traces that do not name the cause, and compares what was read."""

    suite: str = "candidates"
    """The suite in whose conditions direct transfer failed (see benchmark.run)."""
    table: str = ""
    """Folder of the episodes; empty for outputs/suites/<suite>."""
    drawn: int = 60
    """Failed ones that are shown; a whole number >= 1."""
    seed: int = 0
    """Of the draw; a whole number >= 0."""
    output_dir: str = "results/causes_read"
    """Folder of the pages and of answers.json; what was read is in its readings.json, a cause for each number."""

    def __post_init__(self) -> None:
        suite_conditions(self.suite)
        self.table = self.table or f"outputs/suites/{self.suite}"
        for name, least in (("drawn", 1), ("seed", 0)):
            check_setting(getattr(self, name) >= least, name, getattr(self, name), f"a whole number >= {least}")
        check_folder(self.output_dir)


def main(config: ReadCausesConfig) -> None:
    """Make the pages, or compare where there are readings."""
    folder = Path(config.output_dir)
    if (folder / "readings.json").exists():
        print(compared(folder))
        return
    shown = draw(direct_transfer(config), config.drawn, config.seed)
    folder.mkdir(parents=True, exist_ok=True)
    answers: dict[str, Any] = {}
    figures = (figure for figure in traced(shown, config.table, answers))
    for page, pictures in enumerate(batched(figures, PER_PAGE)):
        print(stacked(pictures, folder / f"page{page:02d}.jpg"))
    with replacing(folder / "answers.json") as path:
        path.write_text(json.dumps(answers, indent=1) + "\n")


def direct_transfer(config: ReadCausesConfig) -> "pd.DataFrame":
    """Its stored episodes in all conditions of the suite, with the column `condition`.

    Raises:
        SettingError: If there are none.
    """
    import pandas as pd

    from benchmark.episodes.table import read_present
    from benchmark.scoring.suite_table import by_condition

    task = chosen_task(tasks_of(suite_conditions(config.suite))[0])
    rows = read_present(Path(config.table), task)
    rows = rows if rows.empty else rows[rows.method == DIRECT]
    if rows.empty:
        raise SettingError(
            f"table={config.table} holds no episodes of direct transfer. Roll them out: python -m benchmark.run "
            f"suite={config.suite} method=direct"
        )
    tables = by_condition(rows, suite_conditions(config.suite))
    return pd.concat([table.assign(condition=name) for name, table in tables.items()], ignore_index=True)


def draw(episodes: "pd.DataFrame", number: int, seed: int) -> "pd.DataFrame":
    """Failed episodes: of each condition and cause one, then of each another one, and so on, in random order.

    Raises:
        SettingError: If fewer failed.
    """
    failed = episodes[episodes.failure_cause.notna()].sample(frac=1, random_state=seed)
    if len(failed) < number:
        raise SettingError(f"{len(failed)} episodes failed, and {number} are to be drawn. Roll out more.")
    turn = failed.groupby(["condition", "failure_cause"]).cumcount()
    return failed.loc[turn.sort_values(kind="stable").index[:number]].sample(frac=1, random_state=seed + 1)


def traced(shown: "pd.DataFrame", table: str, answers: dict[str, Any]) -> "Iterator[Figure]":
    """A figure of each of these episodes, played again; what they failed by goes to `answers` under their numbers."""
    from benchmark.episodes.episode import row_id
    from benchmark.rollouts.row_rollout import row_rollout
    from benchmark.settings.replay_config import ReplayConfig
    from richmap.progress import plain_console

    for number, row in enumerate(shown.to_dict("records"), 1):
        rollout = row_rollout(row, ReplayConfig(table=table), plain_console(quiet=True))
        infos, pictures, (began, cause) = seen(rollout, row["episode_seed"])
        answers[f"{number}"] = {
            "condition": row["condition"], "policy": row["checkpoint"], "seed": row["episode_seed"],
            "cause": cause, "row": row_id(row),
        }  # fmt: skip
        yield drawn(f"{number}: {row['condition']}", infos, pictures, began)


def seen(rollout: "Rollout", seed: int) -> "tuple[list[dict], list[tuple[int, np.ndarray]], tuple[int, str]]":
    """Infos of an episode, its pictures with their steps, and the step in which its fault began, and its cause."""
    import dataclasses

    import gymnasium
    import mujoco

    from envs.block_push.failure import failure
    from envs.block_push.workspace import WORKSPACE

    kept: list[dict] = []
    states: list[np.ndarray] = []
    environments: list[gymnasium.Env] = []

    def summarize(infos: list[dict]) -> Any:
        kept.extend(infos)
        return rollout.task.summarize(infos)

    def watch(env: gymnasium.Env) -> None:
        environments[:] = [env]
        states.append(env.unwrapped.physics[1].qpos.copy())  # type: ignore[attr-defined]

    task = dataclasses.replace(rollout.task, summarize=summarize)
    dataclasses.replace(rollout, task=task).play([seed], watch)
    found = failure(kept, WORKSPACE)
    if found is None:
        raise SettingError(
            f"Scene {seed} with {rollout.checkpoint.name} failed as stored, and does not when played again."
        )
    pictures, (env,) = [], environments
    model, data = env.unwrapped.physics  # type: ignore[attr-defined]
    last = len(states) - 1
    for step in sorted({min(max(0, found[0] + frame), last) for frame in FRAMES} | {last}):
        data.qpos[:] = states[step]
        mujoco.mj_forward(model, data)
        pictures.append((step, env.render()))
    return kept, pictures, found


def drawn(title: str, infos: list[dict], pictures: "list[tuple[int, np.ndarray]]", began: int) -> "Figure":
    """Pictures of an episode over its traces."""
    from matplotlib.figure import Figure

    figure = Figure((12, 5.2), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(1, 1.5))
    for axes, (step, picture) in zip(above.subplots(1, len(FRAMES) + 1), pictures, strict=False):
        axes.imshow(picture)
        axes.set_title(f"step {step}", fontsize=7)
    for axes in above.axes:
        axes.axis("off")
    figure.suptitle(title, fontsize=9, x=0.01, ha="left")
    panels = traces(infos).items()
    for axes, (name, (curves, lines)) in zip(below.subplots(2, 4).ravel(), panels, strict=True):
        plot(axes, name, curves, lines, began)
    return figure


def traces(infos: list[dict]) -> "dict[str, tuple[dict[str, np.ndarray], Sequence[float]]]":
    """What is drawn of an episode: of each panel its curves by name, and the limits that are marked."""
    import numpy as np

    from envs.arm.lost_command import AT_LIMIT, LOST
    from envs.block_push.failure import BEHIND, STILL, TIPPED, TOOL_TILTED, recorded
    from envs.block_push.workspace import WORKSPACE

    record = recorded(infos)
    base = record["base"][:, :2]
    blocks = record["block_positions"][..., :2]
    outside = np.maximum(WORKSPACE[0] - BEHIND - blocks, blocks - WORKSPACE[1] - BEHIND).max(axis=2)
    from_base = record["commanded"] - base
    missing = record["commanded"] - record["flange"][:, :2]
    outward = np.sum(missing * from_base, axis=1) / np.linalg.norm(from_base, axis=1)
    moved = np.full((len(blocks), 2), np.nan)
    moved[10:] = np.linalg.norm(blocks[10:] - blocks[:-10], axis=2).clip(max=0.1)
    return {
        "from the base [m]": (
            {
                "command": np.linalg.norm(record["commanded"] - base, axis=1),
                "flange": np.linalg.norm(record["flange"][:, :2] - base, axis=1),
                "block": np.linalg.norm(blocks[:, 0] - base, axis=1).clip(max=1),
                "block 2": np.linalg.norm(blocks[:, 1] - base, axis=1).clip(max=1),
            },
            (),
        ),
        "missing [mm]": (
            {
                "flange": 1e3 * record["tracking_error"],
                "by kinematics": 1e3 * record["ik_residual"],
                "outward": 1e3 * outward,
            },
            (1e3 * LOST,),
        ),
        "joint to limit [rad]": ({"margin": record["joint_limit_margin"]}, (AT_LIMIT,)),
        "tilt [deg]": (
            {"tool": np.degrees(record["tool_tilt"]), "blocks": np.degrees(record["block_tilt"].max(axis=1))},
            (np.degrees(TOOL_TILTED), np.degrees(TIPPED)),
        ),
        "touches": (
            {"itself": record["self_contact"] * 1.0, "table": record["table_contact"] * 1.0 + 0.05},
            (),
        ),
        "in target": (
            {"block": record["block_in_target"][:, 0], "block 2": record["block_in_target"][:, 1] + 0.05},
            (),
        ),
        "moved in the last second [mm]": (
            {name: 1e3 * moved[:, i] for i, name in enumerate(("block", "block 2"))},
            (1e3 * STILL,),
        ),
        "outside [m]": (
            {name: outside[:, i].clip(-0.1, 0.1) for i, name in enumerate(("block", "block 2"))},
            (0.0,),
        ),
    }


def plot(axes: "Axes", name: str, curves: "dict[str, np.ndarray]", lines: Sequence[float], began: int) -> None:
    """Curves over the steps, dashed lines at the values that tell a fault, a dotted one where it began."""
    for label, values in curves.items():
        axes.plot(values, linewidth=0.8, label=label)
    for line in lines:
        axes.axhline(line, color="grey", linewidth=0.6, linestyle="--")
    axes.axvline(began, color="black", linewidth=0.6, linestyle=":")
    axes.set_title(name, fontsize=7, pad=2, loc="left")
    axes.tick_params(labelsize=6)
    look = {"fontsize": 5, "frameon": False, "borderpad": 0, "handlelength": 1, "columnspacing": 1}
    axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=4, **look)


def stacked(figures: "Sequence[Figure]", file: Path) -> Path:
    """Figures one under another in a file."""
    import numpy as np
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from PIL import Image

    pictures = []
    for figure in figures:
        canvas = FigureCanvasAgg(figure)
        figure.set_dpi(90)
        canvas.draw()
        pictures.append(np.asarray(canvas.buffer_rgba())[..., :3])
    with replacing(file) as path:
        Image.fromarray(np.vstack(pictures)).save(path, quality=45)
    return file


def compared(folder: Path) -> str:
    """What was read beside what is stored: how many agree, and those that do not."""
    answers, readings = (json.loads((folder / f"{name}.json").read_text()) for name in ("answers", "readings"))
    rows = [
        f"| {number} | {answer['condition']} | {answer['policy']}, {answer['seed']} | {readings[number]} "
        f"| {answer['cause']} |"
        for number, answer in answers.items()
        if readings[number] != answer["cause"]
    ]
    said = f"{len(answers) - len(rows)} of {len(answers)} episodes were read as they are stored."
    head = ["", "| number | condition | policy, seed | read | stored |", "|---|---|---|---|---|"]
    return "\n".join([said, *(head + rows if rows else [])])


if __name__ == "__main__":
    run_command(main, ReadCausesConfig, "read_causes")
