"""What guidance may imagine with in block push: an arm where its inverse kinematics says, or a tool that goes where it
is told, and blocks that slide as if pushed slowly.

No simulator: neither dynamics nor contact, but what an arm would touch on its way is known.
"""

from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from envs.arm.obstacles import Places
from envs.arm.placed_arm import PlacedArm
from envs.block_push.imagined import BLOCKS, SCENE, STATE, TARGETS, ImaginedPushes, Twin
from envs.block_push.oracle import NEXT_TO_BLOCK, PLANS, Oracle
from envs.block_push.scene import Scene
from envs.block_push.workspace import HEIGHT, MAX_EPISODE_STEPS
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE, PLACED, START
from richmap.task_spaces.way import Way

MOVED, TURNED = 0.004, 0.05
"""By which blocks are slightly moved along each axis, in [m], and turned, in [rad]: the standard deviations."""
LOOK = 10
"""Steps after which those whose arm is stopped are imagined no further."""
DOWN = (0.0, 0.0, -1.0)


class PushModel:
    """Imagined episodes on an arm (`policies.episode_model.EpisodeModel`); without one the tool goes where it is told.

    Args:
        arm: The arm, as it stands.
    """

    steps = MAX_EPISODE_STEPS

    def __init__(self, arm: PlacedArm | None) -> None:
        self._arm = arm
        self._obstacles: Places | None = None

    def ideal(self) -> "PushModel":
        """The same without an arm."""
        return PushModel(None)

    def among(self, obstacles: Places) -> "PushModel":
        """The same among obstacles that stand there."""
        model = PushModel(self._arm)
        vars(model).update({"_twin": self._twin}, _obstacles=obstacles)
        return model

    @cached_property
    def _twin(self) -> Twin | None:
        return None if self._arm is None else Twin(self._arm)

    def start(self) -> Float[np.ndarray, " dof"]:
        """Joint angles at the start of an episode, in [rad]; none without an arm."""
        return np.empty(0) if self._twin is None else self._twin.controller.start()

    def opening(self, scene: Scene) -> tuple[Float[np.ndarray, "4"], Float[np.ndarray, "12"]]:
        """What is seen of a scene when an episode begins: the effector where the scene has it."""
        state, environment = np.empty(STATE.width), np.empty(SCENE.width)
        for name in ("effector", "commanded"):
            state[STATE[name]] = scene.effector
        for name in (*BLOCKS, *TARGETS):
            x, y, yaw = getattr(scene, name)
            environment[SCENE[name]] = x, y, yaw % np.pi
        return state, environment

    def track(self, joints: Float[np.ndarray, " dof"], state: Float[np.ndarray, "4"]) -> Float[np.ndarray, " dof"]:
        """Where the joints are now, in [rad], by where the flange is seen and where they were a step ago."""
        return joints if self._twin is None else self._twin.controller.track(joints, state)

    def begin(
        self,
        joints: Float[np.ndarray, "n dof"],
        state: Float[np.ndarray, "n 4"],
        environment: Float[np.ndarray, "n 12"],
    ) -> ImaginedPushes:
        """Episodes that go on from what is seen, a row each."""
        return ImaginedPushes(self._twin, joints, state, environment, self._obstacles)

    def showings(self, count: int) -> Bool[np.ndarray, "count 12"]:
        """Nothing is hidden in the first half of plans, then the second push of each of the expert's plans in turn."""
        hidden = np.zeros((count, SCENE.width), dtype=bool)
        for i in range(count // 2, count):
            hidden[i] = _later(*PLANS[i % len(PLANS)][1])
        return hidden

    def show(self, seen: Float[np.ndarray, "n t 12"], hidden: Bool[np.ndarray, "n 12"]) -> Float[np.ndarray, "n t 12"]:
        """A hidden block is shown in the hidden target, until a block is placed."""
        shown = seen.copy()
        placed = [bool(_placed(each).any()) for each in seen[:, -1]]
        for row in np.flatnonzero(hidden.any(1) & ~np.array(placed)):
            block = next(SCENE[name] for name in BLOCKS if hidden[row, SCENE[name].start])
            target = next(SCENE[name] for name in TARGETS if hidden[row, SCENE[name].start])
            shown[row, :, block.start : block.start + 2] = seen[row, :, target.start : target.start + 2]
        return shown

    def ways(self, environment: Float[np.ndarray, "12"]) -> list[Way]:
        """The scripted expert's four plans, each with the second push hidden; once a block is placed the push that is
        left; none when both are."""
        placed = _placed(environment)
        if not placed.any():
            return [_way(environment, first, _later(*second)) for first, second in PLANS]
        left = [second for first, second in PLANS if placed[first] and not placed[second]]
        return [_way(environment, push, np.zeros(SCENE.width, dtype=bool)) for push in left[:1]]

    def shares(
        self, joints: Float[np.ndarray, " dof"], environment: Float[np.ndarray, "12"], ways: list[Way], tries: int
    ) -> Float[np.ndarray, " ways"]:
        """Of the expert's episodes along each way from where the arm is the share of blocks that end in a target before
        the arm is stopped; 1 without an arm."""
        if self._twin is None:
            return np.ones(len(ways))
        rng, count = np.random.default_rng(0), len(ways) * tries
        scenes = np.tile(environment, (len(ways), tries, 1))
        spread = np.concatenate([np.zeros((1, 2, 3)), rng.normal(0, [MOVED, MOVED, TURNED], (tries - 1, 2, 3))])
        for i, name in enumerate(BLOCKS):
            scenes[..., SCENE[name]] += spread[:, i]
        at = self._twin.controller.tool(joints[None])[0][0, :2]
        state = np.tile(np.concatenate([at, at]), (count, 1))
        imagined = self.begin(np.tile(joints, (count, 1)), state, scenes.reshape(count, -1))
        experts = [Oracle(_mode(way), np.array(START)) for way in ways for _ in range(tries)]
        actions = np.zeros((count, 2))
        for step in range(self.steps):
            if step % LOOK == 0:
                imagined.halt()
            going = np.flatnonzero(imagined.going).tolist()
            if not going:
                break
            seen = BLOCK_PUSH_SPACE.join(imagined.state, imagined.environment)
            for row in going:
                actions[row] = experts[row](seen[row])
            imagined.step(actions)
        done = [imagined.achieved(row)[0] / 2 for row in range(count)]
        return np.reshape(done, (len(ways), tries)).mean(1)


def _placed(environment: Float[np.ndarray, "12"]) -> Bool[np.ndarray, "2 2"]:
    """Which block (row) is as good as placed in which target (column)."""
    blocks, targets = (np.array([environment[SCENE[name]][:2] for name in names]) for names in (BLOCKS, TARGETS))
    return np.linalg.norm(blocks[:, None] - targets, axis=-1) < PLACED


def _mode(way: Way) -> int:
    """The expert's plan that a way is: its next push is the plan's first, or its second if that alone is left."""
    (goal,), which = way.goals, 0 if way.hidden.any() else 1
    return next(mode for mode, plan in enumerate(PLANS) if plan[which] == divmod(goal, 2))


def _later(block: int, target: int) -> Bool[np.ndarray, "12"]:
    """What is hidden of a push that is left for later: where the block is, and where it is to be."""
    hidden = np.zeros(SCENE.width, dtype=bool)
    for name in (BLOCKS[block], TARGETS[target]):
        hidden[SCENE[name].start : SCENE[name].start + 2] = True
    return hidden


def _way(environment: Float[np.ndarray, "12"], push: tuple[int, int], hidden: Bool[np.ndarray, "12"]) -> Way:
    """The way whose next push is that of a block into a target."""
    block, target = (environment[SCENE[names[i]]][:2] for names, i in zip((BLOCKS, TARGETS), push, strict=True))
    heading = (target - block) / max(float(np.linalg.norm(target - block)), 1e-9)
    end = np.array([[*(target - NEXT_TO_BLOCK * heading), HEIGHT]])
    return Way((2 * push[0] + push[1],), in_order=True, hidden=hidden, positions=end, directions=np.array([DOWN]))
