"""What a check of a path comes to, in words."""

import math
from collections.abc import Iterator

import numpy as np

from benchmark.scoring.expected_success import expected_success
from benchmark.settings.check_config import CheckConfig
from richmap.paths.base_search import BaseSearch
from richmap.paths.path_check import PathCheck, Reason
from richmap.progress import number_of


def in_words(done: PathCheck, source: str) -> str:
    """Shares that are followed and reached, why steps are lost and where first, and what maps say beside."""
    n, spans = len(done.reason), done.path.spans
    lines = [
        f"{done.robot.name} follows {_percent(done.steps_followed)} of {number_of('step', n)}, and "
        f"{_percent(done.episodes_followed)} of {number_of('episode', len(spans))} from the first step to the last.",
        f"Pose by pose, without a way between them, it reaches {_percent(done.reachable.mean())} of the steps, and all "
        f"poses of {_percent(done.episodes_reachable)} of the episodes.",
    ]
    return "\n".join([*lines, *_losses(done), *_assumed_speeds(done), *_of_maps(done, source)])


def _losses(done: PathCheck) -> Iterator[str]:
    """Each reason for which steps are lost, how many, and where first."""
    for reason in Reason:
        stretches = [lost for lost in done.lost if lost.reason == reason]
        if not stretches:
            continue
        first = stretches[0]
        place = ", ".join(f"{x:.3f}" for x in first.position)
        about = f": {first.about}" if first.about else ""
        steps, of = sum(lost.steps for lost in stretches), len({lost.episode for lost in stretches})
        yield (
            f"  {reason.words}: {number_of('step', steps)} ({100 * steps / len(done.reason):.1f} %) in "
            f"{number_of('episode', of)}; first in episode {first.episode}, step {first.step}, at ({place}) m{about}"
        )


def _assumed_speeds(done: PathCheck) -> Iterator[str]:
    """The joints whose speed the description leaves open, and what is taken."""
    assumed = [name for name, stated in zip(done.robot.joints, done.robot.speeds, strict=True) if np.isinf(stated)]
    if assumed:
        speed = done.speeds[np.isinf(done.robot.speeds)][0]
        yield f"The description states no speed of {', '.join(assumed)}: {speed:.2f} rad/s is taken (speed=)."


def _of_maps(done: PathCheck, source: str) -> Iterator[str]:
    """What maps say of the steps, where there are maps."""
    if done.mapped is not None:
        too_much, too_little = done.map_errors()
        yield (
            f"The map calls {_percent(done.mapped.mean())} of the steps reachable. Against inverse kinematics on "
            f"these poses: of what is unreachable it calls {_percent(too_much)} reachable, of what is reachable "
            f"{_percent(too_little)} unreachable."
        )
    if done.mmd is not None:
        known = done.mmd[~np.isnan(done.mmd)]
        said = f"mean {known.mean():.3f}, most {known.max():.3f}" if len(known) else "nowhere do both have directions"
        yield (
            f"MMD against {source} along the path (0 for equal sets, at most 1.41), {number_of('step', len(known))}: "
            f"{said}."
        )


def base_in_words(found: BaseSearch, done: PathCheck) -> str:
    """The best base, and what it gains."""
    x, y, z, yaw = found.best
    best = found.check
    return (
        f"Best base of {len(found.placement.bases)}: x {x:.3f} m, y {y:.3f} m, z {z:.3f} m, yaw {yaw:.3f} rad. From "
        f"there {_percent(best.steps_followed)} of the steps are followed (as it stands "
        f"{_percent(done.steps_followed)}), and {_percent(best.episodes_followed)} of the episodes (as it stands "
        f"{_percent(done.episodes_followed)}). The map named {len(found.tried)} that were tracked."
    )


def expected_in_words(config: CheckConfig, done: PathCheck) -> str:
    """What success can be expected, in words: where a study says so of the poses' task. The task's simulation turns
    every joint as fast as the xArm6's, so steps that are too fast are not lost there."""
    if config.poses or config.task != "block_push":
        return "Expected success of a policy: not calibrated. No study relates these shares to success here."
    too_fast = float((done.reason == Reason.TOO_FAST).mean())
    expected, low, high = (100 * share for share in expected_success(1 - done.steps_followed - too_fast))
    said = " Steps that are too fast do not count in it: the simulation knows no slow joints." if too_fast else ""
    return (
        f"Expected success of direct transfer: {expected:.0f} % of the episodes; {low:.0f} to {high:.0f} % on "
        f"nine arms of ten like those of the study that says so (docs/dose_response.md).{said}"
    )


def _percent(share: float) -> str:
    return "none, as there are none," if math.isnan(share) else f"{100 * share:.1f} %"
