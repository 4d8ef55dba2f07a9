"""Block push: push two blocks into two targets, one each, the tool upright at one height."""

from collections.abc import Callable
from typing import Any

import gymnasium

from envs import BLOCK_PUSH as BLOCK_PUSH_ID
from envs import ENVIRONMENTS
from envs.arm.control import CONTROL_FREQUENCY
from envs.block_push.failure import CAUSES
from envs.block_push.outcome import EpisodeOutcome, summarize
from envs.block_push.scene import draw_scene
from envs.block_push.workspace import DESCRIPTION, HEIGHT, MAX_EPISODE_STEPS, POSES, SPACING, WORKSPACE
from envs.demonstrator import Demonstrator
from envs.task import Change, Controller, Later, Score, Task, Trait, acting_on_dict, make_environment
from richmap.robots import SOURCE
from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE


def make(arm: Any, render_mode: str | None = None, picture: tuple[int, int] | None = None) -> gymnasium.Env:
    """The environment on an arm (`envs.task.make_environment`)."""
    return make_environment(BLOCK_PUSH_ID, arm, render_mode, picture)


def plain_oracle(arm: Any) -> Callable[[dict[str, Any]], Controller]:
    """The original's scripted expert."""
    from envs.block_push.oracle import Oracle

    return lambda info: acting_on_dict(BLOCK_PUSH_SPACE, Oracle(info["mode"]))


def aware_oracle(arm: Any) -> Callable[[dict[str, Any]], Controller]:
    """The expert that goes only where the arm can hold its tool; it takes seconds to find where."""
    from envs.arm.feasibility import kept_feasibility
    from envs.block_push.aware_oracle import AwareOracle
    from envs.block_push.obstacles import Among

    table = kept_feasibility(arm, SPACING, WORKSPACE, HEIGHT)
    among = Among(arm, table) if arm.obstacles else None
    return lambda info: acting_on_dict(
        BLOCK_PUSH_SPACE, AwareOracle(among.table(info["obstacles"]) if among else table, info["mode"])
    )


def holding(arm: Any, in_branch: Any = None) -> Any:
    """`envs.block_push.holding.HoldingAmong`, or `MappedAmong` by a map."""
    from envs.block_push.holding import MappedAmong, holding_among

    return holding_among(arm) if in_branch is None else MappedAmong(arm, in_branch)


def far_target_first(episodes: Any) -> Any:
    """1 where the first block that entered a target entered the farther one, 0 for the nearer, NaN for none."""
    return episodes.first_target.map({"far": 1.0, "near": 0.0}).astype(float)


TRAITS_TEXT = """*Farther first*: of episodes in which
a block entered a target, those in which the first one entered the farther target; its difference is over the episodes
in which one did either way. *Order changed*: of these episodes, those in which another block or target was first. The
others are shares of an episode's steps (means over episodes), whose intervals have no width where no episode differs:
*near base* within 0.235 m of the base axis; *rectangle*
in the paper's dangerous one, in its two readings; *outer reach* beyond 0.54 m."""

BLOCK_PUSH = Task(
    space=BLOCK_PUSH_SPACE,
    description=DESCRIPTION,
    make=make,
    max_episode_steps=MAX_EPISODE_STEPS,
    control_frequency=CONTROL_FREQUENCY,
    poses=POSES,
    draw_scene=draw_scene,
    outcome=EpisodeOutcome,
    summarize=summarize,
    success="p2",
    scores=(
        Score("score", "0.49 for some block in a target and 1 for both"),
        Score("p1", "some block in a target"),
        Score("p2", "both in different targets at one moment"),
        Score("success_at_end", "both still there one second later"),
    ),
    ranking=("p2", "success_at_end", "p1", "score"),
    causes=CAUSES,
    history=(
        Change(
            (),
            "contact with itself or the table stops an arm and its command keeps within 8 cm of the flange, but in "
            "`original`; causes are read off a loss's first second, and what the arm touched and was at is told",
            before="4a68e95",
        ),
    ),
    plain_oracle=plain_oracle,
    aware_oracle=aware_oracle,
    demonstrator=Demonstrator(
        ENVIRONMENTS[SOURCE],
        kinds=(("noise", 0.2), ("bursts", 0.35), ("wide", 0.25), ("crowded", 0.1)),
        episodes=1000,
        play=Later("envs.block_push.demonstrator:play"),
    ),
    model=Later("envs.block_push.model:PushModel"),
    controller=Later("envs.block_push.controller:PushController"),
    holding=holding,
    shows_pictures=True,
    has_obstacles=True,
    plan=("first_block", "first_target"),
    traits=(
        Trait("far_target_first", "farther first", far_target_first),
        Trait("share_near_base", "near base"),
        Trait("share_rectangle_a", "rectangle, axes turned"),
        Trait("share_rectangle_b", "rectangle, centred on the table"),
        Trait("share_outer_reach", "outer reach"),
    ),
    traits_text=TRAITS_TEXT,
)
