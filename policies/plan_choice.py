"""Choice of the plan: whole episodes of the unchanged policy are imagined, and the best one is carried out."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
import torch
from jaxtyping import Bool, Float
from lerobot.utils.constants import OBS_ENV_STATE, OBS_STATE
from torch import Tensor

from policies.directional_methods import PoseCost, cost_of
from policies.episode_model import EpisodeModel, Imagined
from policies.guidance import Guidance, Sample
from policies.noise import further_noise
from policies.setup import Setup

ASTRAY = 0.05
"""A plan is given up where the command is so far from the imagined one: the length of the difference of their numbers,
in [m] for places."""
LOOK = 10
"""Steps after which imagined episodes are looked at: where all are lost, no more is imagined."""
PAUSE = 10
"""Steps after which plans are drawn again where none did the task."""


@dataclass
class Plan:
    """What is carried out in a row of the batch."""

    noise: Float[Tensor, "t *chunk"]
    """Of every step from its beginning on."""
    commanded: Float[np.ndarray, "t command"]
    """What is commanded before every step, as imagined."""
    hidden: Bool[np.ndarray, " rest"]
    """Which numbers of what is seen of the scene are hidden."""
    done: int = 0
    """Steps that were made of it."""


@dataclass
class Row:
    """An episode in a row of the batch."""

    model: EpisodeModel
    joints: Float[np.ndarray, " dof"]
    """Where the arm is, in [rad]."""
    state: Float[np.ndarray, " state"]
    """What was seen last; nothing to begin with."""
    steps: int = 0
    """That were seen."""
    pause: int = 0
    """Steps until a plan is sought again."""
    plan: Plan | None = None


class PlanChoice(Guidance):
    """Carries out one of several imagined episodes that do the task; which one a subclass says.

    What is chosen is the noise: the policy acts on what it sees, as ever, with the noise that led it well. Another plan
    is sought where the command goes astray of the imagined one, and where a plan is over and the task is not. Where no
    plan will do, the policy is left alone, and a second later they are drawn again.

    Args:
        model: What is imagined with.
        plans: How many episodes are imagined at once.
        commanded: Where in the state the commanded pose is.
    """

    takes_shortest = False
    """Whether the first that will do is carried out: the others then are not imagined to their end."""

    def __init__(self, model: EpisodeModel, plans: int, commanded: slice) -> None:
        self.model, self.plans, self.commanded = model, plans, commanded
        self._rows: dict[int, Row] = {}

    @abstractmethod
    def best(self, imagined: Imagined) -> int | None:
        """Which episode is carried out, of those that are not going any more; None for none."""

    def reset(self, rows: Sequence[int] | None) -> None:
        for row in [*self._rows] if rows is None else rows:
            self._rows[row] = Row(self.model, self.model.start(), np.empty(0))

    def meet(self, rows: Sequence[int], places: Float[np.ndarray, "rows k 4"]) -> None:
        for row, there in zip(rows, places, strict=True):
            self._rows[row].model = self.model.among(there)

    def noise(self, batch: dict[str, Tensor], noise: Float[Tensor, "b *chunk"], sample: Sample) -> Tensor:
        noise = noise.clone()
        for i, row in self._rows.items():
            state = batch[OBS_STATE][i, -1].double().cpu().numpy()
            if np.array_equal(row.state, state):
                continue  # Its episode is over.
            if self._is_to_plan(row, state):
                row.plan, row.pause = (
                    self._plan_from(row, batch[OBS_STATE][i], batch[OBS_ENV_STATE][i], noise[i], sample),
                    PAUSE,
                )
            if row.plan is not None:
                noise[i] = row.plan.noise[row.plan.done]
                row.plan.done += 1
        return noise

    def imagine(self, environment: Float[Tensor, "b t rest"], state: Float[Tensor, "b state"]) -> Tensor:
        seen = environment.clone()
        for i, row in self._rows.items():
            if row.plan is not None and row.plan.hidden.any():
                seen[i] = torch.as_tensor(self.model.show(seen[i : i + 1].cpu().numpy(), row.plan.hidden[None])[0])
        return seen

    def _is_to_plan(self, row: Row, state: Float[np.ndarray, " state"]) -> bool:
        """Keep track of an arm, and tell whether a plan is to be sought for it."""
        if len(row.state):
            row.joints = self.model.track(row.joints, state)
        row.state, row.steps, row.pause = state, row.steps + 1, row.pause - 1
        plan = row.plan
        if plan is None:
            return row.pause <= 0
        if plan.done == len(plan.noise):
            return True
        return bool(np.linalg.norm(plan.commanded[plan.done] - state[self.commanded]) > ASTRAY)

    def _plan_from(
        self,
        row: Row,
        states: Float[Tensor, "t state"],
        scenes: Float[Tensor, "t rest"],
        noise: Float[Tensor, " *chunk"],
        sample: Sample,
    ) -> Plan | None:
        """What is carried out from here on, if anything, by what was seen lately. All is imagined in one batch, whose
        size does not depend on what else is played."""
        n, left = self.plans, self.model.steps - row.steps + 1
        hidden = self.model.showings(n)
        now = row.joints, row.state, scenes[-1].double().cpu().numpy()
        imagined = row.model.begin(*(np.tile(each, (n, 1)) for each in now))
        states, scenes = (each.repeat(n, 1, 1) for each in (states, scenes))
        draws = further_noise(noise, (n, left))
        commanded = np.empty((n, left, self.commanded.stop - self.commanded.start))
        chosen, going = None, n
        for k in range(left):
            commanded[:, k] = imagined.state[:, self.commanded]
            shown = torch.as_tensor(self.model.show(scenes.cpu().numpy(), hidden)).to(scenes)
            actions = sample({OBS_STATE: states, OBS_ENV_STATE: shown}, draws[:, k].to(noise))
            imagined.step(actions[:, 0].cpu().numpy())
            states, scenes = _followed(states, imagined.state), _followed(scenes, imagined.environment)
            before, going = going, int(imagined.going.sum())
            if going == 0 or k == left - 1 or (self.takes_shortest and going < before):
                chosen = self.best(imagined)
            if going == 0 or chosen is not None:
                break
            if self.takes_shortest and k % LOOK == 0:
                if all(imagined.is_lost(row) for row in np.flatnonzero(imagined.going).tolist()):
                    break
        if chosen is None:
            return None
        end = int(imagined.lengths()[chosen])
        return Plan(draws[chosen, :end], commanded[chosen, :end], hidden[chosen])


@final
class ShortestPlan(PlanChoice):
    """The shortest episode that does the task without touching anything that is not to be touched."""

    takes_shortest = True

    def best(self, imagined: Imagined) -> int | None:
        lengths = imagined.lengths()
        order = [int(i) for i in np.argsort(lengths, kind="stable") if np.isfinite(lengths[i])]
        return next((i for i in order if imagined.is_free(i)), None)


@final
class PlanByMap(PlanChoice):
    """The episode whose worst pose costs least by maps."""

    def __init__(self, model: EpisodeModel, plans: int, commanded: slice, cost: PoseCost) -> None:
        super().__init__(model, plans, commanded)
        self.cost = cost

    def best(self, imagined: Imagined) -> int | None:
        done = np.flatnonzero(~imagined.going).tolist()
        worst = [self.cost.value_and_gradients(*imagined.flange(i)).value.max() for i in done]
        return done[int(np.argmin(worst))] if done else None


def _followed(seen: Float[Tensor, "n t numbers"], values: Float[np.ndarray, "n numbers"]) -> Tensor:
    """What was seen lately once this is seen."""
    return torch.cat([seen[:, 1:], torch.as_tensor(values).to(seen)[:, None]], 1)


def plan_on_arm(given: Setup) -> ShortestPlan:
    """Of several episodes that are imagined on the arm's kinematic twin the shortest that it can carry out."""
    return ShortestPlan(_model(given), int(given.scale), given.space.state[given.space.commanded])


def plan_of_any(given: Setup) -> ShortestPlan:
    """Of several episodes of an ideal arm the shortest: a control, which knows nothing of the arm."""
    return ShortestPlan(_model(given).ideal(), int(given.scale), given.space.state[given.space.commanded])


def plan_by_map(given: Setup) -> PlanByMap:
    """Of several episodes of an ideal arm the one whose worst pose costs least by maps."""
    commanded = given.space.state[given.space.commanded]
    return PlanByMap(_model(given).ideal(), int(given.scale), commanded, cost_of(given))


def _model(given: Setup) -> EpisodeModel:
    assert given.model is not None  # `policies.method` has seen to it.
    return given.model
