"""The leaderboard as one page that needs no network: `leaderboard_page.html` filled with data and pictures."""

import base64
import json
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from markdown_it import MarkdownIt

from benchmark.episodes.arm import setting_text
from benchmark.scoring.protocol_text import PROTOCOL_TEXTS, how_to_read, mechanism_text, policies_text
from benchmark.scoring.published import TABLE_3
from benchmark.scoring.suite_ranking import needs_text
from benchmark.settings.recipe import USUAL
from benchmark.settings.robot_config import PAPER_ARMS
from benchmark.settings.task import chosen_task
from policies.methods import DIRECT

if TYPE_CHECKING:
    import pandas as pd

    from benchmark.scoring.ranking import Protocol
    from benchmark.scoring.suite_table import Standing
    from envs.task import Task

TEMPLATE = Path(__file__).with_suffix(".html")

NAME = re.compile("(.+)-([^-]+)-([0-9]+)(?:-[0-9a-f]{8})?")
"""Of a moving picture: the arm and how it stands, method and scale, scene; a row's id may follow."""
SCENES = 4
"""Most scenes of an arm of which there are moving pictures."""


def page(
    task: "Task",
    tables: "dict[Protocol, pd.DataFrame]",
    figures: Path,
    recipe: str = USUAL,
    standings: "Sequence[Standing]" = (),
) -> str:
    """The page.

    Args:
        task: What the episodes are of.
        tables: The leaderboard of each protocol.
        figures: Folder of moving pictures, `<arm>-<how it stands>-<method and scale>-<seed>.webp`, as
            `benchmark.record` calls them; those of an arm that differ in the method alone are shown side by side.
        recipe: Of the policies.
        standings: How methods rank on each suite.
    """
    rows = [
        row | {"protocol": protocol.name, "setting_text": setting_text(row)}
        for protocol, table in tables.items()
        for row in json.loads(table.to_json(orient="records", double_precision=6))
    ]
    versions = sorted({row["episode_version"] for row in rows})
    commits = sorted({commit for row in rows for commit in row["commits"]})
    data = {
        "rows": rows,
        "suites": [suite(standing) for standing in standings],
        "protocols": {
            protocol.name: {"scores": protocol.scores, "text": PROTOCOL_TEXTS[protocol.name].replace("`", "")}
            for protocol in tables
        },
        "ranks": task.ranking[0],
        "scores": {score.name: score.text for score in task.scores},
        "mechanism": {"order_changed": "order changed"} | {trait.name: trait.title for trait in task.traits},
        "published": {robot: asdict(published) for robot, published in TABLE_3.items()},
        "scenes": scenes(figures),
        "about": f"{sum(row['n'] for row in rows):,} episodes on test scenes; episode version "
        f"{', '.join(map(str, versions))}; commit {', '.join(commits)}. "
        + policies_text(task, recipe).replace("- **Policies**", "Policies"),
    }
    of_suites = {condition.task: None for standing in standings for condition in standing.conditions.values()}
    described = dict.fromkeys([task.description, *(chosen_task(name).description for name in of_suites)])
    texts = {
        "how_to_read": how_to_read(task),
        "mechanism": mechanism_text(task),
        "tasks": "\n".join(f"- {text}" for text in described),
        "task": task.description,
    }
    prose = {name: MarkdownIt().render(text) for name, text in texts.items()}
    (meaning,) = [score.text for score in task.scores if score.name == task.ranking[0]]
    prose |= {"ranked": task.ranking[0].replace("_", " "), "meaning": meaning}
    filled = prose | {"data": json.dumps(data).replace("<", "\\u003c")}
    return re.sub(r"{{(\w+)}}", lambda place: filled[place[1]], TEMPLATE.read_text())


def suite(of: "Standing") -> dict[str, Any]:
    """How methods rank on a suite and what they gain on each of its conditions, as the page holds it.

    `conditions` has what there is to know of each, with the score that ranks of direct transfer and the ceiling, by the
    names of its columns; `methods` those of the ranking, with their gains by condition.
    """
    direct = {cell["condition"]: cell for cell in _records(of.table) if cell["method"] == DIRECT}
    conditions = [
        {"name": key, "robot": condition.robot, "cause": condition.cause, "saturated": condition.saturated}
        | direct[key]
        for key, condition in of.conditions.items()
        if key in direct
    ]
    methods = [
        record | {"needs": needs_text(row.method), "gains": _gains(of, row)}
        for record, (_, row) in zip(_records(of.methods), of.methods.iterrows(), strict=True)
    ]
    return {"name": of.suite, "ranks": of.ranks, "conditions": conditions, "methods": methods, "said": of.remarks}


def _gains(of: "Standing", method: "pd.Series") -> dict[str, dict[str, Any]]:
    """What a method gains on each condition that it has rows of, by the condition's name."""
    import pandas as pd

    cells = [cell for name in of.conditions if (cell := of.cell(method, name)) is not None]
    return {row["condition"]: row for row in _records(pd.DataFrame(cells))}


def _records(table: "pd.DataFrame") -> list[dict[str, Any]]:
    return json.loads(table.to_json(orient="records", double_precision=6))


def scenes(folder: Path) -> list[dict[str, Any]]:
    """Moving pictures of the first scenes of each arm, those of a scene together, as the page holds them."""
    found = []
    for robot in PAPER_ARMS:
        of_scene: dict[tuple[str, str], list[dict[str, str]]] = {}
        named = ((file, NAME.fullmatch(file.stem)) for file in sorted(folder.glob(f"{robot}-*.webp")))
        for file, (arm, method, seed) in ((file, name.groups()) for file, name in named if name):
            source = f"data:image/webp;base64,{base64.b64encode(file.read_bytes()).decode()}"
            shown = re.sub(r"(?<=[a-z])(?=[\d.]+$)", " ", method.replace("lambda", "λ "))
            film = {"method": shown, "source": source}
            of_scene.setdefault((arm.replace("-", ", "), seed), []).append(film)
        found += [{"arm": arm, "seed": seed, "films": films} for (arm, seed), films in of_scene.items()][:SCENES]
    return found
