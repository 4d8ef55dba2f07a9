"""What a method of guidance is: its name, what it looks at, what its scale is, and what makes it.

This module is quick to import; what a method is made of is imported when one is made.
"""

from dataclasses import dataclass
from pkgutil import resolve_name
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import policies.guidance
    import policies.setup
    from richmap.task_spaces.task_space import TaskSpace

FIELD_NEEDS = {
    "energy": ("source's map", "target's map"),
    "witness": ("source's map", "target's map"),
    "coverage": ("target's map",),
    "feasibility": ("arm's description",),
    "reach": ("target's map",),
    "branch_coverage": ("target's map in its branch",),
    "branch_reach": ("target's map in its branch",),
    "branch_map": ("target's map in its branch",),
    "value": ("arm's description",),
}
"""What each kind of field is made of."""
AT_ONE_HEIGHT = ("feasibility", "reach", "branch_reach")
"""Kinds of field of a tool that is held upright at one height over the table, that of block push."""
SIMULATOR = "simulator (privileged)"
"""What no robot has: the episode itself, to try things in."""
SHAPES = "shapes of the arm's links"
MOST_SAMPLES = 32
"""Of methods that choose among samples: they do not collapse, but cost more and more."""


def is_of(kind: str | None, space: "TaskSpace") -> bool:
    """Whether a kind of field can be one of a task's poses; None, for no field, always can."""
    from richmap.task_spaces.block_push import BLOCK_PUSH_SPACE

    return kind not in AT_ONE_HEIGHT or space.steps == BLOCK_PUSH_SPACE.steps


@dataclass(frozen=True)
class Method:
    """What has to be known of a method to set it, to sweep its scale and to make it."""

    name: str
    entry_point: str
    """A function or class that makes a `policies.guidance.Guidance` of a `policies.setup.Setup`, as `module:name`."""
    text: str
    """What it does, in a few words."""
    field: str | None
    """What it looks at: `energy` (similarity to the source), `feasibility` (what the arm can hold), `reach` (the same
    by its map alone), `coverage` (the approach directions that its map has at each place), `branch_reach` and
    `branch_coverage` (the same by the map of the arm's branch above the table), `branch_map` (that map itself),
    `witness` (those that the source has and it lacks), `value` (what was learnt of how episodes end on the arm), or
    None."""
    scale: str
    """What its scale, `lambda`, is, with its unit."""
    first: float
    """Smallest scale that is tried, at which it does next to nothing."""
    counts: bool = False
    """Whether the scale is a whole number."""
    imagines: bool = False
    """Whether it needs a model of the task's episodes on the arm (`envs.task.Task.model`)."""
    follows: bool = False
    """Whether it needs the arm's own controller (`envs.task.Task.controller`)."""
    task: str | None = None
    """Name of the only task that it is for; None for any that its field is of."""
    avoids: bool = False
    """Whether it is told where obstacles are, if there are any, and keeps the arm off them."""
    also_needs: tuple[str, ...] = ()
    """What it has to be given besides its field and that model, such as `SIMULATOR`."""

    @property
    def asks_the_arm(self) -> bool:
        """Whether it needs more of the arm than a field: what a checkpoint alone does not bring."""
        return self.imagines or self.follows or self.avoids

    @property
    def needs(self) -> tuple[str, ...]:
        """What it has to be given besides the policy."""
        model = ("a model of the task",) if self.imagines else ()
        controller = ("arm's description",) if self.follows else ()
        obstacles = ("places of obstacles, if any",) if self.avoids else ()
        return (*FIELD_NEEDS.get(self.field or "", ()), *controller, *self.also_needs, *model, *obstacles)

    def keeps_off(self, obstacles: int) -> bool:
        """Whether it is told where the arm can hold its tool among so many obstacles (`policies.setup.Setup.among`)."""
        return self.avoids and self.field in AT_ONE_HEIGHT and obstacles > 0

    def refusal(self, space: "TaskSpace") -> str:
        """Why it cannot act in a task, in words; empty if it can."""
        if self.task not in (None, space.name):
            return f"{self.name} is for {self.task} alone"
        if not is_of(self.field, space):
            held = "upright at one height, block push's"
            return f"{self.name} looks at where an arm holds its tool {held}, unlike {space.name}"
        return ""

    def scales(self, points: int) -> list[float]:
        """The scales that are tried, smallest first, each twice the one before."""
        doubled = [self.first * 2**k for k in range(points)]
        return [scale for scale in doubled if scale <= MOST_SAMPLES or not self.counts]

    def make(self, given: "policies.setup.Setup") -> "policies.guidance.Guidance":
        """The method, as it acts; direct transfer at scale 0.

        Raises:
            ValueError: If its field or scale is not what it needs.
        """
        from policies.guidance import Unguided

        if given.scale == 0:
            return Unguided()
        self._check(given)
        return resolve_name(self.entry_point)(given)

    def _check(self, given: "policies.setup.Setup") -> None:
        from richmap.similarity.load_field import FIELDS

        if why := self.refusal(given.space):
            raise ValueError(f"Guidance: {why}.")
        if self.field is not None and given.field is None:
            raise ValueError(f"Guidance {self.name!r} needs a field of {self.field}.")
        if self.field is not None and not isinstance(given.field, FIELDS[self.field]):
            raise ValueError(
                f"Guidance {self.name!r} needs a field of {self.field}, {FIELDS[self.field].__name__}. "
                f"Got {type(given.field).__name__}."
            )
        if self.imagines and given.model is None:
            raise ValueError(
                f"Guidance {self.name!r} imagines episodes, with a model of the task on the arm. benchmark.run brings "
                "one, and a checkpoint alone does not."
            )
        if self.follows and given.controller is None:
            raise ValueError(
                f"Guidance {self.name!r} asks the arm's own controller. benchmark.run brings one, and a checkpoint "
                "alone does not."
            )
        if self.counts and (given.scale < 1 or given.scale != int(given.scale)):
            raise ValueError(f"The scale of {self.name!r} is a number of samples, 1 or more. Got {given.scale}.")
