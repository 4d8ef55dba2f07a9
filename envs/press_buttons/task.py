"""Pressing buttons: the tip of a rod presses any two of four buttons that face in all directions."""

from collections.abc import Callable
from typing import Any

import gymnasium

from envs import PRESS_BUTTONS as PRESS_BUTTONS_ID
from envs import PRESS_BUTTONS_ENVIRONMENTS
from envs.arm.control import CONTROL_FREQUENCY
from envs.demonstrator import Demonstrator
from envs.press_buttons.failure import CAUSES
from envs.press_buttons.outcome import PressOutcome, summarize
from envs.press_buttons.workspace import DESCRIPTION, MAX_EPISODE_STEPS, POSES
from envs.task import Change, Controller, Later, Score, Task, Trait, acting_on_dict, make_environment
from richmap.robots import SOURCE
from richmap.task_spaces.press_buttons import PRESS_BUTTONS_SPACE


def make(arm: Any, render_mode: str | None = None, picture: tuple[int, int] | None = None) -> gymnasium.Env:
    """The environment on an arm (`envs.task.make_environment`)."""
    return make_environment(PRESS_BUTTONS_ID, arm, render_mode, picture)


def plain_oracle(arm: Any) -> Callable[[dict[str, Any]], Controller]:
    """The expert that presses the scene's pair."""
    from envs.press_buttons.oracle import Oracle

    return lambda info: acting_on_dict(PRESS_BUTTONS_SPACE, Oracle(info["pair"]))


def aware_oracle(arm: Any) -> Callable[[dict[str, Any]], Controller]:
    """The expert that presses a pair that its arm can press."""
    from envs.press_buttons.oracle import Oracle, aware_pair

    choose = aware_pair(arm)
    return lambda info: acting_on_dict(PRESS_BUTTONS_SPACE, Oracle(choose(info)))


def pressed_wrongly(episodes: Any) -> Any:
    """1 where a cap was pushed in and its button not pressed in the end."""
    return (episodes.wrong_presses > 0).astype(float)


TRAITS_TEXT = """*Order changed*: of the episodes in which a button was pressed, those in which another was first, or
another second. *Wrong presses*: episodes in which a cap was pushed in at a wrong angle or beside its axis and the
button not pressed."""

PRESS_BUTTONS = Task(
    space=PRESS_BUTTONS_SPACE,
    description=DESCRIPTION,
    make=make,
    max_episode_steps=MAX_EPISODE_STEPS,
    control_frequency=CONTROL_FREQUENCY,
    poses=POSES,
    draw_scene=Later("envs.press_buttons.scene:draw_scene"),
    outcome=PressOutcome,
    summarize=summarize,
    success="p2",
    scores=(
        Score("score", "0.49 for some button pressed and 1 for two"),
        Score("p1", "some button pressed"),
        Score("p2", "two different buttons pressed"),
        Score("success_at_end", "and the arm not stopped in the second after"),
    ),
    ranking=("p2", "success_at_end", "p1", "score"),
    causes=CAUSES,
    history=(
        Change(
            (),
            "arms begin in the posture from which they press most buttons; the oracle goes in where it is 8 mm beside",
            before="b37ce6b",
        ),
    ),
    plain_oracle=plain_oracle,
    aware_oracle=aware_oracle,
    model=Later("envs.press_buttons.model:PressModel"),
    controller=Later("envs.press_buttons.controller:PressController"),
    demonstrator=Demonstrator(
        PRESS_BUTTONS_ENVIRONMENTS[SOURCE],
        kinds=(("noise", 0.2), ("bursts", 0.4), ("shown", 0.2)),
        episodes=2500,
        play=Later("envs.press_buttons.demonstrator:play"),
    ),
    shows_pictures=True,
    has_obstacles=True,
    plan=("first_button", "second_button"),
    traits=(Trait("pressed_wrongly", "wrong presses", pressed_wrongly),),
    traits_text=TRAITS_TEXT,
)
