"""The leaderboard as a short document: how methods rank, what they gain on each condition, and where all else is."""

from collections.abc import Sequence
from itertools import chain

import pandas as pd

from benchmark.episodes.arm import ARM, changes, of_arm, setting_text
from benchmark.scoring.protocol_text import PROTOCOL_TEXTS, TASK
from benchmark.scoring.published import TABLE_3
from benchmark.scoring.ranking import PAPER, Protocol
from benchmark.scoring.scores import difference_text, with_interval
from benchmark.scoring.suite_table import Standing, gains_text
from benchmark.settings.recipe import USUAL
from benchmark.settings.task import typed_task
from envs.task import Task
from policies.methods import DIRECT

TEXT = """# Leaderboard

Made by `python -m benchmark.leaderboard{setting}` from the stored episodes alone. The same by arm, with curves, causes
and moving pictures: [`leaderboard.html`](leaderboard.html), one file for the browser."""

RANKED_TEXT = """## Which method gains most

The share of head-room is what a method gains over direct transfer, divided by what the frozen ceiling gains, over the
conditions of a suite that are not saturated; in percent, with a 95 % interval for other trainings and other scenes.
Where the first three stand in another order on even scenes than on odd ones, they are called tied. In a suite of two
tasks a method that does nothing in one of them counts there as direct transfer (`as direct`). What the other
columns are says the [protocol](../docs/protocol.md#one-number-for-each-method), what methods do,
[methods](../docs/methods.md)."""

GAINS_TEXT = (
    """Direct transfer and the ceiling in percent, then what each method gains over direct transfer, in points."""
)

PAPER_TEXT = """Score, mean over nine policies (* over fewer), and their least and most. Which λ the paper's guided
column is of, it does not say; ours is the curve up to λ = 1, where the paper's ends, from its lowest to its highest
point."""

SHOWN_TEXT = "every score with its p-value, causes, and policy by policy"

SUBMIT_TEXT = """A method of yours: [is it any good?](../docs/evaluate.md#is-my-idea-any-good) first, then
[submit](../docs/submit.md). What was found: [findings](../docs/findings.md)."""


def markdown(
    task: Task, tables: dict[Protocol, pd.DataFrame], recipe: str = USUAL, standings: Sequence[Standing] = ()
) -> str:
    """The leaderboard as a document: how methods rank on each suite and what they gain on its conditions, then what the
    protocols have besides, of the policies of a recipe."""
    given = [f"task={typed_task(task)}"] * (task.name != TASK) + [f"recipe={recipe}"] * (recipe != USUAL)
    parts = [TEXT.format(setting=" ".join(["", *given]))]
    for of in standings:
        parts += [RANKED_TEXT] if of.ranks and RANKED_TEXT not in parts else []
        parts += [f"### Suite `{of.suite}`", *of.text] if of.ranks else [f"## Suite `{of.suite}`"]
        parts += [GAINS_TEXT, gains_text(of)]
    for protocol, table in tables.items():
        if protocol == PAPER:
            parts += ["## Beside the paper's Table 3", PROTOCOL_TEXTS[PAPER.name], PAPER_TEXT]
            parts += [_text(beside_the_paper(table))]
        elif len(left := beside_suites(table, standings)):
            parts += [f"## Protocol `{protocol.name}`", PROTOCOL_TEXTS[protocol.name]]
            parts += [_score_text(task, protocol), _text(gains(left, protocol))]
    parts += ["## All else", "\n".join(_elsewhere(tables, standings, given)), SUBMIT_TEXT]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def beside_suites(table: pd.DataFrame, standings: Sequence[Standing]) -> pd.DataFrame:
    """The rows of arms that are in none of the suites shown."""
    shown = [of_arm(table, arm).index for of in standings for arm in of.arms.values()]
    return table.drop(index=[*{*chain(*shown)}])


def gains(table: pd.DataFrame, protocol: Protocol) -> pd.DataFrame:
    """A row for each arm: what direct transfer comes to, in percent, and what each method gains over it, in points; a
    column for each method."""
    name, lines = protocol.scores[0], []
    columns = [DIRECT, *dict.fromkeys(_column(row) for _, row in table.iterrows() if row.method != DIRECT)]
    for (*_, version), rows in table.groupby([*ARM, "episode_version"], sort=False):
        first = rows.iloc[0]
        line = {"arm": f"{first.robot}, {setting_text(first)}, version {version}"} | dict.fromkeys(columns, "-")
        for _, row in rows.iterrows():
            gained = not pd.isna(row[f"{name}_difference"])
            text = difference_text(row, f"{name}_difference") if gained else with_interval(row, name)
            text += "" if row.complete else "*"
            before = line[_column(row)]
            line[_column(row)] = text if before == "-" else f"{before}; {text}"  # It was run in several ways.
        lines.append(line)
    return pd.DataFrame(lines)


def beside_the_paper(table: pd.DataFrame) -> pd.DataFrame:
    """The paper's success of each arm and ours, direct and guided as the paper guides."""
    rows = []
    for _, rows_of in table.groupby([*ARM, "episode_version"], sort=False):
        robot = rows_of.robot.iloc[0]
        direct = rows_of[rows_of.method == "direct"]
        guided = rows_of[(rows_of.method == "paper") & (rows_of["lambda"] <= 1)].sort_values("score")
        published = TABLE_3[robot]
        rows.append(
            {
                "arm": ", ".join([robot, *changes(rows_of.iloc[0], rows_of.setting.iloc[0])]),
                "direct: paper": _published(published.direct),
                "direct: ours": ", ".join(_mean_and_range(row) for _, row in direct.iterrows()) or "-",
                "guided: paper": _published(published.guided),
                "guided: ours": "; ".join(_ends(curve) for _, curve in guided.groupby("cell_size")) or "-",
            }
        )
    return pd.DataFrame(rows)


def _elsewhere(tables: dict[Protocol, pd.DataFrame], standings: Sequence[Standing], given: list[str]) -> list[str]:
    """Which command shows what this document leaves out, a line of a list each."""
    lines = [f"- `python -m benchmark.show suite={of.suite}`: oracles and every method with n." for of in standings]
    shown = [" ".join([f"python -m benchmark.show protocol={protocol.name}", *given]) for protocol in tables]
    return [*lines, *(f"- `{command}`: {SHOWN_TEXT}." for command in shown)]


def _score_text(task: Task, protocol: Protocol) -> str:
    """What is in the cells of `gains`."""
    (meaning,) = [score.text for score in task.scores if score.name == protocol.scores[0]]
    return (
        f"`{protocol.scores[0]}` of direct transfer in percent ({meaning}), then what each method gains over it, in "
        "points; * where episodes or policies are missing. Of a method that cannot be paired, its own score."
    )


def _column(row: pd.Series) -> str:
    """What a method's column is called."""
    return DIRECT if row.method == DIRECT else f"{row.method}{' (entry)' if row.entry else ''} {row['lambda']:g}"


def _ends(curve: pd.DataFrame) -> str:
    """The lowest and the highest point of a curve in λ that is sorted by score."""
    points = (f"{_mean_and_range(row)} at λ {row['lambda']:g}" for _, row in curve.iloc[[0, -1]].iterrows())
    return f"{' to '.join(points)} (cells {curve.cell_size.iloc[0]:g} m)"


def _mean_and_range(row: pd.Series) -> str:
    least_and_most = f"{100 * row.score_least:.1f} to {100 * row.score_most:.1f}"
    return f"{100 * row.score:.1f}{'' if row.complete else '*'} ({least_and_most})"


def _published(figures: tuple[float, float, float] | None) -> str:
    return "-" if figures is None else "{:.1f} ({:.1f} to {:.1f})".format(*(100 * x for x in figures))


def _text(table: pd.DataFrame) -> str:
    return table.to_markdown(index=False, disable_numparse=True)
