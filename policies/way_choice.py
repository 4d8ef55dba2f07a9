"""Choice of the way: of several ways to do a task the policy is shown one as if it were the only one."""

from abc import abstractmethod
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from policies.directional_methods import FlippedCost, PoseCost, ShuffledCost, cost_of
from policies.episode_model import EpisodeModel, MappableModel
from policies.guidance import Guidance
from policies.setup import Setup
from richmap.maps.reachability_map import ReachabilityMap
from richmap.task_spaces.way import Way

EVERY = 10
"""Steps after which ways are judged again; they are also judged whenever there are other ones."""
WORSE = 0.5
"""Of the best merit, below which a way is usually left."""
NEAR = 0.06
"""So near to a goal, in [m], twice in a row when ways are judged, the tool stays before it."""
TIRED = 0.3
"""By which the merit of ways to it is then multiplied, each time."""
LEAST = 0.1
"""Least merit of a way before that: from elsewhere the arm may be able to go it."""


@dataclass
class Row:
    """An episode in a row of the batch."""

    model: EpisodeModel
    joints: Float[np.ndarray, " dof"]
    """Where the arm is, in [rad]."""
    state: Float[np.ndarray, " state"]
    scene: Float[np.ndarray, " rest"]
    """What was seen last; nothing to begin with."""
    hidden: Bool[np.ndarray, " rest"]
    """Which numbers of what is seen of the scene are hidden."""
    goals: list[tuple[int, ...]] = field(default_factory=list)
    """Of the ways that there were when they were judged last."""
    steps: int = 0
    near: int | None = None
    """The goal that the tool was near to when ways were judged last."""
    stays: Counter[int] = field(default_factory=Counter)
    """How often it stayed before which."""


class WayChoice(Guidance):
    """Shows the policy the way of most merit; what merit is a subclass says.

    Where all ways are alike, the policy is shown what is there. Before a goal where it stays it gets tired of it.

    Args:
        model: What knows the ways.
        measured: Where in the state the tool is.

    Attributes:
        worse: A way is left where its merit falls below this part of the best one's.
    """

    worse = WORSE

    def __init__(self, model: EpisodeModel, measured: slice) -> None:
        self.model, self.measured = model, measured
        self._rows: dict[int, Row] = {}

    @abstractmethod
    def merits(self, row: Row, scene: Float[np.ndarray, " rest"], ways: Sequence[Way]) -> Float[np.ndarray, " k"]:
        """Of each way from where the arm is, from 0 on."""

    def reset(self, rows: Sequence[int] | None) -> None:
        for row in [*self._rows] if rows is None else rows:
            self._rows[row] = Row(self.model, self.model.start(), np.empty(0), np.empty(0), np.empty(0, dtype=bool))

    def meet(self, rows: Sequence[int], places: Float[np.ndarray, "rows k 4"]) -> None:
        for row, there in zip(rows, places, strict=True):
            self._rows[row].model = self.model.among(there)

    def imagine(self, environment: Float[Tensor, "b t rest"], state: Float[Tensor, "b state"]) -> Tensor:
        seen = environment.clone()
        for i, row in self._rows.items():
            self._look(row, state[i].double().cpu().numpy(), environment[i, -1].double().cpu().numpy())
            if row.hidden.any():
                seen[i] = torch.as_tensor(self.model.show(seen[i : i + 1].cpu().numpy(), row.hidden[None])[0])
        return seen

    def _look(self, row: Row, state: Float[np.ndarray, " state"], scene: Float[np.ndarray, " rest"]) -> None:
        """Keep track of an arm, and choose its way where it is time to."""
        if np.array_equal(row.state, state):
            return  # Its episode is over.
        if len(row.state):
            row.joints = self.model.track(row.joints, state)
        changed = not np.array_equal(row.scene, scene)
        if row.steps % EVERY == 0 or (changed and [way.goals for way in self.model.ways(scene)] != row.goals):
            row.hidden = self._chosen(row, state, scene)
        row.state, row.scene, row.steps = state, scene, row.steps + 1

    def _chosen(
        self, row: Row, state: Float[np.ndarray, " state"], scene: Float[np.ndarray, " rest"]
    ) -> Bool[np.ndarray, " rest"]:
        """What is hidden from here on."""
        ways = self.model.ways(scene)
        row.goals = [way.goals for way in ways]
        near = _nearest(ways, state[self.measured][:3])
        if near is not None and near == row.near:
            row.stays[near] += 1
        row.near = near
        if len(ways) < 2:
            return np.zeros(len(scene), dtype=bool)
        tired = [TIRED ** sum(row.stays[goal] for goal in way.goals) for way in ways]
        merits = np.maximum(self.merits(row, scene, ways), LEAST) * tired
        if merits.min() == merits.max():
            return np.zeros(len(scene), dtype=bool)
        good = np.flatnonzero(merits >= self.worse * merits.max())
        present = [i for i in good if np.array_equal(ways[i].hidden, row.hidden)]
        return ways[present[0] if present else int(merits.argmax())].hidden


@final
class WayOnArm(WayChoice):
    """Merit is the share of a way that the arm can go, by its kinematic twin or by its map: of the scripted expert's
    paths, or of the poses about them."""

    def __init__(self, model: EpisodeModel, measured: slice, tries: int) -> None:
        super().__init__(model, measured)
        self.tries = tries

    def merits(self, row: Row, scene: Float[np.ndarray, " rest"], ways: Sequence[Way]) -> Float[np.ndarray, " k"]:
        return row.model.shares(row.joints, scene, [*ways], self.tries)


@final
class WayByMap(WayChoice):
    """Merit is what maps have of a way's worst goal: one less what its pose costs."""

    def __init__(self, model: EpisodeModel, measured: slice, cost: PoseCost, ahead: float, enough: float) -> None:
        super().__init__(model, measured)
        self.cost, self.ahead, self.enough = cost, ahead, enough

    def merits(self, row: Row, scene: Float[np.ndarray, " rest"], ways: Sequence[Way]) -> Float[np.ndarray, " k"]:
        flanges = [(way.positions - self.ahead * way.directions, way.directions) for way in ways]
        worst = [self.cost.value_and_gradients(*flange).value.max() for flange in flanges]
        return np.clip(1 - np.array(worst), 0, self.enough)


@final
class WayOfAny(WayChoice):
    """A control, which knows nothing of the arm: the way that is named first."""

    def merits(self, row: Row, scene: Float[np.ndarray, " rest"], ways: Sequence[Way]) -> Float[np.ndarray, " k"]:
        return np.eye(1, len(ways))[0]


def way_on_arm(given: Setup) -> WayOnArm:
    """The way of which the arm's kinematic twin can go most."""
    return WayOnArm(*_known(given), int(given.scale))


def way_on_arm_anew(given: Setup) -> WayOnArm:
    """A control: the same without commitment, as a way is left where another one has more merit."""
    chosen = way_on_arm(given)
    chosen.worse = 1.0
    return chosen


def way_through_map(given: Setup) -> WayOnArm:
    """The way of which the arm's map has most, all along."""
    assert isinstance(given.field, ReachabilityMap)  # `policies.method` has seen to it.
    model, measured = _known(given)
    assert isinstance(model, MappableModel)  # Pressing buttons' is, for which alone this method is.
    return WayOnArm(model.by_map(given.field), measured, int(given.scale))


def way_by_map(given: Setup) -> WayByMap:
    """The way whose worst goal maps have most of."""
    return _by_cost(given, cost_of(given))


def way_by_flipped_map(given: Setup) -> WayByMap:
    """A control: the way whose worst goal maps have least of."""
    return _by_cost(given, FlippedCost(cost_of(given).field))


def way_by_shuffled_map(given: Setup) -> WayByMap:
    """A control: the same with the map's cells in other places."""
    return _by_cost(given, ShuffledCost(cost_of(given).field, given.seed))


def way_of_any(given: Setup) -> WayOfAny:
    """The way that is named first."""
    return WayOfAny(*_known(given))


def _by_cost(given: Setup, cost: PoseCost) -> WayByMap:
    model, measured = _known(given)
    return WayByMap(model.ideal(), measured, cost, given.space.steps.ahead, given.scale)


def _known(given: Setup) -> tuple[EpisodeModel, slice]:
    assert given.model is not None  # `policies.method` has seen to it.
    return given.model, given.space.state[given.space.measured]


def _nearest(ways: Sequence[Way], tool: Float[np.ndarray, " axes"]) -> int | None:
    """The goal that the tool is near to, if it is near to one, along the axes that it moves along."""
    positions = (zip(way.goals, way.positions[:, : len(tool)], strict=True) for way in ways)
    far = {goal: np.linalg.norm(at - tool) for each in positions for goal, at in each}
    nearest = min(far, key=far.__getitem__, default=None)
    return nearest if nearest is not None and far[nearest] < NEAR else None
