"""Every figure of a published protocol as text: all scores, p-values, causes and policies, arm by arm."""

from itertools import chain
from typing import Any

import pandas as pd

from benchmark.episodes.arm import ARM, base_text, branch_text, setting_text
from benchmark.scoring.ranking import PAPER, Protocol
from benchmark.scoring.scores import causes_text, difference_text, with_interval
from benchmark.settings.config import RunConfig
from benchmark.settings.recipe import RECIPES, USUAL
from envs.task import Task

TASK = RunConfig.task
"""What is meant where no task is named."""

HOW_TO_READ = """- **Episodes**: the scenes of a protocol (docs/protocol.md), the same for all arms, methods and scales.
- **Scores**, in percent: {scores}.
- **[ ]** are 95 % intervals for other trainings and other episodes: a bootstrap of training seeds crossed with episode
  seeds (Owen & Eckles 2012; all draws at once, in closed form), with Student's t since trainings are few. With one
  training they are for other episodes alone. With few episodes they are wide also where all agree, since other scenes
  may be harder. Those of single policies and of oracles are Wilson's.
- **Difference** is that to direct transfer, same policies, same episodes, in points; of an entry with a policy of its
  own, that to each of ours. Its interval is for other trainings as well. Its p is for these trainings alone: of all
  flips of the sign of whole episodes, which for one training and a rate is the exact McNemar test; *Holm* is adjusted,
  each score by itself, for all arms, methods and scales of the protocol's setting that are whole (no *); an entry's
  for these and its own.
- **Reference** and **planner** are the scripted oracle that knows nothing of the arm and the one that does, on the
  same scenes, by the same code. A policy may beat either; ceilings are those of suites (docs/protocol.md).
- **Failed by cause**: an episode failed if it never had {success}. What was undone later has no cause.
- **n** counts episodes, of all policies; * marks a row that lacks policies or episodes of the protocol, or some of
  direct transfer's that it is compared with, and so comes last. *(entry)*: evaluated by `benchmark.enter`. A dash: not
  measured.
- **What counts**: rows of a protocol's settings, episodes and batches, by policies that ship with the project and
  learned so, or by entries, which stand beside the usual policies. Other episode versions have sections, and
  Holm families, of their own: a version rises when the same seed comes to give another episode.
"""

PROTOCOL_TEXTS = {
    "paper": "Setting `original` (just the arm swapped). The paper's 50 scenes, three policies of each training seed.",
    "strict": "Settings `embodied` and `best`. The 100 scenes for tables, the best checkpoint of each training seed.",
}

ARM_CHANGED_TEXT = """Direct transfer with the base where the arm's own map puts it (`best`) or elsewhere, with the
wrist in the other branch, or with another weight of orientation in the inverse kinematics, so that the tool may lean,
minus direct transfer on the arm of the setting `embodied`: same policies, same episodes, in points; intervals and p as
above, but not adjusted."""


def how_to_read(task: Task) -> str:
    """What the columns are."""
    scores = {score.name: score.text for score in task.scores}
    said = "; ".join(f"`{name}` is {scores[name]}" for name in dict.fromkeys((*task.headline[::-1], *task.ranking)))
    return HOW_TO_READ.format(scores=said, success=task.success)


def policies_text(task: Task, recipe: str) -> str:
    """Whose episodes count."""
    if task.name != TASK:
        return "- **Policies**: those that ship for this task, or where none do, all that were rolled out."
    return f"- **Policies** learned from {RECIPES[recipe]}."


def mechanism_text(task: Task) -> str:
    """What the columns of the table of what guidance changed are."""
    return f"In percent, then the difference to direct transfer in points. {task.traits_text}"


def protocol_text(task: Task, protocol: Protocol, table: pd.DataFrame, recipe: str = USUAL) -> str:
    """A protocol's table as a document, of the policies of a recipe."""
    table = in_order(table, protocol)
    parts = [f"# Protocol `{protocol.name}`", PROTOCOL_TEXTS[protocol.name], "## How to read the tables"]
    parts += [policies_text(task, recipe) + "\n" + how_to_read(task), "## Arm by arm"]
    for _, rows in table.groupby([*ARM, "episode_version"], sort=False):
        first = rows.iloc[0]
        parts += [f"### {first.robot}, {setting_text(first)}", arm_text(rows, task), _text(scores(rows, protocol))]
    if len(moved := between_settings(table, protocol, task)):
        parts += ["## How the arm stands and holds its tool", ARM_CHANGED_TEXT, _text(moved)]
    if task.plan or task.traits:
        parts += ["## What guidance changed", mechanism_text(task), _text(mechanism(table, task))]
    if protocol.best_only:
        parts += ["## Policy by policy", _text(by_policy(table, protocol))]
    return "\n\n".join(part.strip() for part in parts)


def in_order(table: pd.DataFrame, protocol: Protocol) -> pd.DataFrame:
    """Arm by arm the best method first, or for the paper's protocol along its curve."""
    if protocol != PAPER:
        return table
    arms = table.groupby([*ARM, "episode_version"], sort=False)
    return pd.concat([rows.sort_values(["method", "lambda"]) for _, rows in arms])


def arm_text(rows: pd.DataFrame, task: Task) -> str:
    """How an arm stood, and what the scripted oracles reach on it."""
    first = rows.iloc[0]
    may_bind = {"self-collision": first.self_collision, "joint limits": first.joint_limits}
    binding = " and ".join(name for name, binds in may_bind.items() if binds) or "nothing"
    oracles = [f"{role}: {oracle_text(first[role], task.ranking[0])}" for role in ("reference", "planner")]
    return (
        f"Base {base_text(first)} m, {branch_text(first)}, {binding} binding; version {first.episode_version}, "
        f"commit {', '.join(sorted({*chain(*rows.commits)}))}. "
        f"{task.ranking[0]} of the {'; of the '.join(oracles)}."
    )


def oracle_text(measured: dict | None, score: str) -> str:
    """A score of a scripted oracle."""
    if measured is None:
        return "-"
    return f"{with_interval(measured, score)} (n {measured['n']}, seeds from {measured['first']})"


def scores(rows: pd.DataFrame, protocol: Protocol) -> pd.DataFrame:
    """Scores of all methods on one arm."""
    shown = {**_method(rows), "n": [f"{row.n}{'' if row.complete else '*'}" for row in rows.itertuples()]}
    for name in protocol.scores:
        shown |= {
            name: [with_interval(row, name) for _, row in rows.iterrows()],
            f"{name}: policies": [_range(row, name) for _, row in rows.iterrows()],
            f"{name}: difference": [difference_text(row, f"{name}_difference") for _, row in rows.iterrows()],
            f"{name}: p (Holm)": [_p_values(row[f"{name}_p"], row[f"{name}_holm"]) for _, row in rows.iterrows()],
        }
    return pd.DataFrame(shown | {"failed by cause": [causes_text(causes) for causes in rows.causes]})


def between_settings(rows: pd.DataFrame, protocol: Protocol, task: Task) -> pd.DataFrame:
    """What another base, wrist or a leaning tool brings to direct transfer, arm by arm."""
    shown, headline = [], [name for name in task.headline if name in protocol.scores]
    for row in rows.dropna(subset=f"{headline[0]}_arm_difference").to_dict("records"):
        shown.append({"arm": row["robot"], "setting": setting_text(row), "base": base_text(row), "n": row["n"]})
        for name in headline:
            shown[-1] |= {
                name: with_interval(row, name),
                f"{name}: difference": difference_text(row, f"{name}_arm_difference"),
                f"{name}: p": f"{row[f'{name}_arm_p']:.2g}",
            }
    return pd.DataFrame(shown)


def mechanism(rows: pd.DataFrame, task: Task) -> pd.DataFrame:
    """Which way through the task was taken, and the task's traits."""
    shown = {"setting": [setting_text(row) for _, row in rows.iterrows()], "arm": rows.robot, **_method(rows)}
    shown["order changed"] = [
        "-" if pd.isna(row.order_changed) else with_interval(row, "order_changed") for _, row in rows.iterrows()
    ]
    for name, title in ((trait.name, trait.title) for trait in task.traits):
        shown[title] = [
            f"{100 * row[name]:.1f}"
            + ("" if pd.isna(row[f"{name}_difference"]) else f", {difference_text(row, f'{name}_difference')}")
            for _, row in rows.iterrows()
        ]
    return pd.DataFrame(shown)


def by_policy(table: pd.DataFrame, protocol: Protocol) -> pd.DataFrame:
    """Scores of every policy by itself."""
    rows = []
    for row in table.to_dict("records"):
        about = pd.DataFrame([row])
        for policy in row["policies"]:
            shown = {"setting": setting_text(row), "arm": row["robot"], **{k: v[0] for k, v in _method(about).items()}}
            shown |= {"checkpoint": policy["checkpoint"], "n": policy["n"]}
            for name in protocol.scores:
                shown[name] = with_interval(policy, name)
                shown[f"{name}: difference"] = difference_text(policy, f"{name}_difference")
                shown[f"{name}: McNemar p"] = (
                    "-" if pd.isna(policy[f"{name}_mcnemar"]) else f"{policy[f'{name}_mcnemar']:.2g}"
                )
            rows.append(shown)
    return pd.DataFrame(rows)


def method_text(row: Any) -> str:
    """A method and what may differ between rows of one method."""
    sampler = "" if row.sampler == "none" else f", {row.sampler}-{row.sampling_steps}"
    cells = "" if pd.isna(row.cell_size) else f", cells {row.cell_size:g} m"
    device = "" if row.device == "cpu" else f", {row.device}"
    return f"{row.method}{' (entry)' if row.entry else ''}{sampler}, batches of {row.batch_size}{cells}{device}"


def _method(rows: pd.DataFrame) -> dict[str, list[str]]:
    return {
        "method": [method_text(row) for row in rows.itertuples()],
        "λ": rows["lambda"].map("{:g}".format).tolist(),
    }


def _p_values(p: float, holm: float) -> str:
    """A p-value and the adjusted one, which rows that are not whole lack."""
    return "-" if pd.isna(p) else f"{p:.2g} ({'-' if pd.isna(holm) else f'{holm:.2g}'})"


def _range(row: pd.Series, name: str) -> str:
    return f"{100 * row[f'{name}_least']:.1f} to {100 * row[f'{name}_most']:.1f}"


def _text(table: pd.DataFrame) -> str:
    return table.to_markdown(index=False, disable_numparse=True)
