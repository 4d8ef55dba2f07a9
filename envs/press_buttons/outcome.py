"""What an episode came to: the columns that it has in the table of results."""

from dataclasses import dataclass

import numpy as np

from envs.arm.control import CONTROL_FREQUENCY
from envs.arm.lost_command import arm_state, at_limit, in_contact
from envs.press_buttons.failure import failure_cause

AT_END = 50
"""The last five seconds, in steps."""


@dataclass(frozen=True)
class PressOutcome:
    """Figures of one episode."""

    score: float
    """0.49 for p1 and 0.51 for p2: 0, 0.49 or 1."""
    p1: bool
    """Some button was pressed."""
    p2: bool
    """Two different ones were."""
    success_at_end: bool
    """And the arm was not stopped in the second after that, the command held still."""
    length: int
    """Control steps."""
    first_button: int | None
    """Which button was pressed first, 0 to 3."""
    second_button: int | None
    """Which one then."""
    first_press_s: float | None
    """When the first one was pressed, in [s]."""
    oracle_first: int
    """Which button the scene has the plain oracle press first; likewise the next."""
    oracle_second: int
    wrong_presses: int
    """Buttons whose cap was pushed in as far as it needs without closing the switch."""
    failure_cause: str | None
    """One of `envs.press_buttons.failure.CAUSES`; None if two were pressed."""
    arm_at_end: str
    """What the arm was at in the last five seconds, one of `envs.arm.lost_command.ARM_STATES`."""
    tracking_error_mean: float
    """Distance from the commanded to the measured flange, in [m]; likewise the next."""
    tracking_error_max: float
    first_contact_step: int | None
    """First control step in which a link touched another, the rod, the table or a button, counted from 1; None if none
    did."""
    contact_steps: int
    """Control steps in which one did."""
    limit_steps: int
    """Control steps with a joint at a limit that binds."""


def summarize(infos: list[dict]) -> PressOutcome:
    """Outcome of an episode from its infos: that of the reset, then that of every step.

    Raises:
        ValueError: If there is no step.
    """
    if len(infos) < 2:
        raise ValueError(f"An episode is the info of its reset and of at least one step. Got {len(infos)} infos.")
    whole = {key: np.array([info[key] for info in infos]) for key in infos[0]}
    record, last = {name: values[1:] for name, values in whole.items()}, infos[-1]
    contact, order = in_contact(record), _order(whole["pressed"])
    first, second = (*(button for button, _ in order), None, None)[:2]
    return PressOutcome(
        score=float(last["score"]),
        p1=bool(last["p1"]),
        p2=bool(last["p2"]),
        success_at_end=bool(last["success_at_end"]),
        length=len(infos) - 1,
        first_button=first,
        second_button=second,
        first_press_s=order[0][1] / CONTROL_FREQUENCY if order else None,
        oracle_first=int(last["pair"][0]),
        oracle_second=int(last["pair"][1]),
        wrong_presses=int((last["missed"] & ~last["pressed"]).sum()),
        failure_cause=failure_cause(whole),
        arm_at_end=arm_state({name: values[-AT_END:] for name, values in record.items()}),
        tracking_error_mean=float(record["tracking_error"].mean()),
        tracking_error_max=float(record["tracking_error"].max()),
        first_contact_step=int(contact.argmax()) + 1 if contact.any() else None,
        contact_steps=int(contact.sum()),
        limit_steps=int(at_limit(record).sum()),
    )


def _order(pressed: np.ndarray) -> list[tuple[int, int]]:
    """Buttons that were pressed, with the step, in order; (t, 4) flags from the reset on."""
    steps = [(int(pressed[:, i].argmax()), i) for i in range(pressed.shape[1]) if pressed[-1, i]]
    return [(button, step) for step, button in sorted(steps)]
