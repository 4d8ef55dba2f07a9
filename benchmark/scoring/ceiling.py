"""What can be reached on a condition: scene by scene the best of all that was tried, without choosing by its luck.

Of the planner, the plain oracle and the stored methods, the one is taken in each scene that did best there with the
other policies, and what it did with this one counts. A policy's own luck, by which the best of many would always look
better than any of them is, is in no choice. An oracle has no policy: it did in a scene what it did.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from benchmark.scoring.statistics import Crossed, clustered_mean
from benchmark.settings.config import ORACLE_METHODS
from benchmark.settings.setting import SettingError
from richmap.given_files import given_json

if TYPE_CHECKING:
    import pandas as pd

PLANNER, PLAIN = ORACLE_METHODS["aware"], ORACLE_METHODS["plain"]
"""The first candidates, before direct transfer and other methods."""


def cross_validated(
    values: Float[np.ndarray, "candidates policies scenes"], oracles: int = 0
) -> Float[np.ndarray, "policies scenes"]:
    """What the candidate that did best in a scene with the other policies did there with this one.

    Of equals it is an oracle that succeeded, then the one that did better over all scenes with the other policies, then
    the first.

    Args:
        values: Of success, from 0 to 1; of an oracle the same for all policies.
        oracles: How many of the candidates are oracles, the first ones.
    """
    candidates, policies, scenes = values.shape
    chosen = np.empty((policies, scenes))
    for policy in range(policies):
        others = np.delete(values, policy, axis=1) if policies > 1 else values
        merit = others.mean(axis=1)
        merit[:oracles] *= 1 + 1e-3
        merit += 1e-6 * others.mean(axis=(1, 2))[:, None] - 1e-9 * np.arange(candidates)[:, None]
        chosen[policy] = values[merit.argmax(axis=0), policy, np.arange(scenes)]
    return chosen


@dataclass(frozen=True)
class Ceiling:
    """Of one condition, on some scenes."""

    scenes: tuple[int, ...]
    """Their seeds."""
    policies: tuple[str, ...]
    """Names of the policies, in the order of `values`."""
    values: tuple[str, ...]
    """A digit for each scene, 1 where it was reached, a text for each policy."""
    candidates: dict[str, float]
    """What it is the best of, with the mean of each."""

    @property
    def table(self) -> Float[np.ndarray, "policies scenes"]:
        """The values as numbers."""
        return np.array([[*map(int, row)] for row in self.values], dtype=float)

    def on(self, scenes: Sequence[int]) -> Crossed:
        """The values on some of its scenes, by training and episode; on those that it lacks there are none."""
        there = [i for i, scene in enumerate(self.scenes) if scene in {*scenes}]
        table = self.table[:, there]
        trainings = np.repeat(np.array(self.policies), table.shape[1])
        return Crossed(table.ravel(), trainings, np.tile(np.array(self.scenes)[there], len(self.policies)))

    def interval(self, scenes: Sequence[int]) -> tuple[float, float, float]:
        """Mean over some of its scenes, and its interval for other trainings and other scenes."""
        return clustered_mean(self.on(scenes))


def ceiling(rows: "pd.DataFrame", success: str) -> Ceiling:
    """The ceiling of a condition from its rows: of oracles, and of methods each with the same policies on the same
    scenes. A method that lacks episodes is left out; direct transfer says which there are to be.

    Raises:
        SettingError: If there are no rows of direct transfer, or an oracle lacks some of its scenes.
    """
    direct = rows[rows.method == "direct"]
    if direct.empty:
        raise SettingError("A ceiling is of the policies and scenes of direct transfer, and there are no rows of it.")
    policies, scenes = sorted({*direct.checkpoint}), sorted({*direct.episode_seed})
    tables: dict[str, np.ndarray] = {}
    for (method, scale), group in sorted(rows.groupby(["method", "lambda"]), key=lambda each: _order(each[0])):
        name = method if method in ("direct", PLANNER, PLAIN) else f"{method} {scale:g}"
        table = group.pivot_table(success, "checkpoint", "episode_seed", aggfunc="first").astype(float)
        if method in (PLANNER, PLAIN):
            of_scenes = table.reindex(columns=scenes).to_numpy()
            if np.isnan(of_scenes).any():
                raise SettingError(f"{method} lacks {int(np.isnan(of_scenes).sum())} of {len(scenes)} scenes.")
            tables[name] = np.repeat(of_scenes[:1], len(policies), axis=0)
            continue
        of_policies = table.reindex(index=policies, columns=scenes).to_numpy()
        if not np.isnan(of_policies).any():
            tables[name] = of_policies
    oracles = sum(name in (PLANNER, PLAIN) for name in tables)
    values = cross_validated(np.stack([*tables.values()]), oracles)
    digits = tuple("".join(str(int(value)) for value in row) for row in values)
    means = {name: round(float(table.mean()), 4) for name, table in tables.items()}
    return Ceiling(tuple(scenes), tuple(policies), digits, means)


def _order(key: tuple[str, float]) -> tuple[int, str, float]:
    """Of candidates."""
    method, scale = key
    first = (PLANNER, PLAIN, "direct")
    return first.index(method) if method in first else len(first), method, scale


def ceilings_file(suite: str) -> Path:
    """Where the frozen ceilings of a suite are."""
    from benchmark.artifacts.known_policies import RESULTS

    return RESULTS / "suites" / suite / "ceilings.json"


def save_ceilings(file: Path, ceilings: Mapping[str, Ceiling], about: Mapping[str, object]) -> None:
    """Write the ceilings of a suite's conditions, and what they were made from."""
    from richmap.outputs import replacing

    content = {"about": dict(about), "conditions": {name: asdict(each) for name, each in ceilings.items()}}
    with replacing(file) as path:
        path.write_text(json.dumps(content, indent=1) + "\n")


def read_ceilings(file: Path) -> dict[str, Ceiling]:
    """The ceilings of a suite's conditions by name; none if they are not frozen yet.

    Raises:
        SettingError: If the file is damaged.
    """
    if not file.exists():
        return {}
    try:
        ceilings = {
            name: Ceiling(tuple(each["scenes"]), tuple(each["policies"]), tuple(each["values"]), each["candidates"])
            for name, each in given_json(file)["conditions"].items()
        }
        for name, each in ceilings.items():
            scenes, policies, values = each.scenes, each.policies, each.values
            if not all(type(scene) is int for scene in scenes) or len({*scenes}) != len(scenes) or not scenes:
                raise ValueError(f"{name}: scenes are no list of different seeds")
            if not all(type(each) is str for each in policies) or len({*policies}) != len(policies) or not policies:
                raise ValueError(f"{name}: policies are no list of different names")
            if len(values) != len(policies) or not all(re.fullmatch(f"[01]{{{len(scenes)}}}", each) for each in values):
                raise ValueError(f"{name}: values are no 0 or 1 for each scene, of each policy")
        return ceilings
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise SettingError(f"{file} holds no ceilings ({error!r:.200}). See benchmark.studies.ceilings.") from error
