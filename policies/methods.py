"""The methods of guidance, each declared once: its name, what it looks at, and what its scale is.

This module is quick to import; what a method is made of is imported when one is made.
"""

from dataclasses import dataclass
from pkgutil import resolve_name
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import policies.guidance
    import policies.setup
    from richmap.task_spaces.task_space import TaskSpace

DIRECT = "direct"
"""What a scale of 0 is, whatever the method."""
FIELD_NEEDS = {
    "energy": ("source's map", "target's map"),
    "witness": ("source's map", "target's map"),
    "coverage": ("target's map",),
    "feasibility": ("arm's description",),
    "value": ("arm's description",),
}
"""What each kind of field is made of."""
SIMULATOR = "simulator (privileged)"
"""What no robot has: the episode itself, to try things in."""
MOST_SAMPLES = 32
"""Of methods that choose among samples: they do not collapse, but cost more and more."""


@dataclass(frozen=True)
class Method:
    """What has to be known of a method to set it, to sweep its scale and to make it."""

    name: str
    entry_point: str
    """A function or class that makes a `policies.guidance.Guidance` of a `policies.setup.Setup`, as `module:name`."""
    text: str
    """What it does, in a few words."""
    field: str | None
    """What it looks at: `energy` (similarity to the source), `feasibility` (what the arm can hold), `coverage` (the
    approach directions that the arm's map has at each place), `witness` (those that the source has and it lacks),
    `value` (what was learnt of how episodes end on the arm), or None."""
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
    also_needs: tuple[str, ...] = ()
    """What it has to be given besides its field and that model, such as `SIMULATOR`."""

    @property
    def asks_the_arm(self) -> bool:
        """Whether it needs more of the arm than a field: what a checkpoint alone does not bring."""
        return self.imagines or self.follows

    @property
    def needs(self) -> tuple[str, ...]:
        """What it has to be given besides the policy."""
        model = ("a model of the task",) if self.imagines else ()
        controller = ("arm's description",) if self.follows else ()
        return (*FIELD_NEEDS.get(self.field or "", ()), *controller, *self.also_needs, *model)

    def refusal(self, space: "TaskSpace") -> str:
        """Why it cannot act in a task, in words; empty if it can."""
        if self.task not in (None, space.name):
            return f"{self.name} is for {self.task} alone"
        if self.field == "feasibility" and len(space.steps.moved) != 2:
            return f"{self.name} looks at where an arm holds its tool upright at one height, unlike {space.name}"
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


def method_named(name: str) -> Method:
    """The method of a name.

    Raises:
        ValueError: If there is none.
    """
    if name not in METHODS:
        raise ValueError(f"There is no guidance {name!r}. Methods: {', '.join(METHODS)}.")
    return METHODS[name]


_SLOPE = "how much of the energy's slope, in [1/m], is added to the noise, in normalised action units"
_BORDER = "push at the border of what the arm can hold, in normalised action units"
_RADIAL = "push, the same everywhere, in normalised action units"
_SAMPLES = "number of chunks sampled, of which the best is taken"
_PLANS = "number of episodes imagined at once"
_ENOUGH = "merit from which on ways count as alike: 1 less what the pose at the worst goal costs, without a unit"
_DESCENT = "descent of the normalised clean actions per unit of the cost's slope along the chunk"
_IN_NOISE = "how much of the slope along the chunk is added to the noise, in normalised action units"
_TRACKING = "descent of the actions, in m and rad, per unit of the tracking cost's slope, in m^2 and rad^2"
_INSIDE = "how far inside the border the chunk is kept, in [m]"

METHODS = {
    method.name: method
    for method in (
        Method(
            name=DIRECT,
            entry_point="policies.guidance:Unguided",
            text="none",
            field=None,
            scale="none",
            first=0.0,
        ),
        Method(
            name="paper",
            entry_point="policies.guidance_methods:paper",
            text="against the slope of the energy of similarity",
            field="energy",
            scale=_SLOPE,
            first=0.03125,
        ),
        Method(
            name="away",
            entry_point="policies.guidance_methods:away",
            also_needs=("where the arm stands",),
            text="from the base, the same everywhere",
            field=None,
            scale=_RADIAL,
            first=0.0125,
        ),
        Method(
            name="towards",
            entry_point="policies.guidance_methods:towards",
            also_needs=("where the arm stands",),
            text="to the base, the same everywhere",
            field=None,
            scale=_RADIAL,
            first=0.0125,
        ),
        Method(
            name="shuffled",
            entry_point="policies.guidance_methods:shuffled",
            text="that slope turned at random in each cell",
            field="energy",
            scale=_SLOPE,
            first=0.03125,
        ),
        Method(
            name="flipped",
            entry_point="policies.guidance_methods:flipped",
            text="along that slope",
            field="energy",
            scale=_SLOPE,
            first=0.03125,
        ),
        Method(
            name="ring",
            entry_point="policies.guidance_methods:ring",
            text="back between two distances from the base",
            field="feasibility",
            scale=_BORDER,
            first=0.05,
        ),
        Method(
            name="feasibility",
            entry_point="policies.guidance_methods:feasibility",
            text="from the border of what the arm can hold",
            field="feasibility",
            scale=_BORDER,
            first=0.05,
        ),
        Method(
            name="projection",
            entry_point="policies.guidance_methods:projection",
            text="commands moved inside that border",
            field="feasibility",
            scale="how far inside the border commands are kept, in [m]",
            first=0.000625,
        ),
        Method(
            name="best_of_n_energy",
            entry_point="policies.guidance_methods:best_of_n_energy",
            text="the sample that ends lowest",
            field="energy",
            scale=_SAMPLES,
            first=2.0,
            counts=True,
        ),
        Method(
            name="best_of_n_feasibility",
            entry_point="policies.guidance_methods:best_of_n_feasibility",
            text="the sample that ends farthest inside",
            field="feasibility",
            scale=_SAMPLES,
            first=2.0,
            counts=True,
        ),
        Method(
            name="chunk",
            entry_point="policies.guidance_methods:chunk",
            text="down the slope along the whole chunk",
            field="energy",
            scale=_DESCENT,
            first=0.25,
        ),
        Method(
            name="chunk_feasibility",
            entry_point="policies.guidance_methods:chunk_feasibility",
            text="down the slope of infeasibility along it",
            field="feasibility",
            scale=_DESCENT,
            first=0.25,
        ),
        Method(
            name="reorder",
            entry_point="policies.block_push.reorder:reorder",
            text="what the arm cannot push is left for later",
            field="feasibility",
            scale="how far inside the border a push must keep the tool, in [m], to be made first",
            first=0.0025,
            task="block_push",
        ),
        Method(
            name="chunk_witness",
            entry_point="policies.directional_methods:pose_chunk",
            text="down the slope of directions that only the source has, along the chunk",
            field="witness",
            scale=_DESCENT,
            first=0.25,
        ),
        Method(
            name="best_of_n_witness",
            entry_point="policies.directional_methods:pose_best_of_n",
            text="the sample whose worst pose has least of directions that only the source has",
            field="witness",
            scale=_SAMPLES,
            first=2.0,
            counts=True,
        ),
        Method(
            name="chunk_coverage",
            entry_point="policies.directional_methods:pose_chunk",
            text="down the slope of directions that the arm lacks, along the chunk",
            field="coverage",
            scale=_DESCENT,
            first=0.25,
        ),
        Method(
            name="best_of_n_coverage",
            entry_point="policies.directional_methods:pose_best_of_n",
            text="the sample whose worst pose has least of directions that the arm lacks",
            field="coverage",
            scale=_SAMPLES,
            first=2.0,
            counts=True,
        ),
        Method(
            name="way_by_map",
            entry_point="policies.way_choice:way_by_map",
            text="of the ways to do the task the one is shown alone whose worst goal the arm's map covers best",
            field="coverage",
            scale=_ENOUGH,
            first=0.125,
            imagines=True,
        ),
        Method(
            name="way_by_witness",
            entry_point="policies.way_choice:way_by_map",
            text="the same with directions that only the source has in place of those that the arm lacks",
            field="witness",
            scale=_ENOUGH,
            first=0.125,
            imagines=True,
        ),
        Method(
            name="way_of_any",
            entry_point="policies.way_choice:way_of_any",
            text="the same with the way that is named first, whatever the arm can do",
            field=None,
            scale="1",
            first=1.0,
            counts=True,
            imagines=True,
        ),
        Method(
            name="way_on_arm",
            entry_point="policies.way_choice:way_on_arm",
            text="of the ways to do the task one is shown alone that the arm's kinematic twin can go",
            field=None,
            scale="number of the scripted expert's paths that are tried along each way, in each order",
            first=1.0,
            counts=True,
            imagines=True,
            also_needs=("arm's description",),
        ),
        Method(
            name="value_on_arm",
            entry_point="policies.press_buttons.value_choice:value_on_arm",
            text="the sample after which the task is done most likely, as was learnt from imagined episodes on the arm",
            field="value",
            scale=_SAMPLES,
            first=2.0,
            counts=True,
            imagines=True,
            task="press_buttons",
        ),
        Method(
            name="dynaguide_feasibility",
            entry_point="policies.published_rules:dynaguide_feasibility",
            text="DynaGuide's rule, by the slope of infeasibility",
            field="feasibility",
            scale=_IN_NOISE,
            first=0.25,
        ),
        Method(
            name="dynaguide_coverage",
            entry_point="policies.published_rules:dynaguide_coverage",
            text="DynaGuide's rule, by directions that the arm lacks",
            field="coverage",
            scale=_IN_NOISE,
            first=0.25,
        ),
        Method(
            name="itps_feasibility",
            entry_point="policies.published_rules:itps_feasibility",
            text="ITPS's rule, by the slope of infeasibility",
            field="feasibility",
            scale=_IN_NOISE,
            first=0.25,
        ),
        Method(
            name="itps_coverage",
            entry_point="policies.published_rules:itps_coverage",
            text="ITPS's rule, by directions that the arm lacks",
            field="coverage",
            scale=_IN_NOISE,
            first=0.25,
        ),
        Method(
            name="final_constraint",
            entry_point="policies.published_rules:final_constraint",
            text="DiRecT's rule: the clean chunk kept inside that border",
            field="feasibility",
            scale=_INSIDE,
            first=0.000625,
        ),
        Method(
            name="dpcc",
            entry_point="policies.published_rules:dpcc",
            text="DPCC's rule: noisy chunks kept inside that border",
            field="feasibility",
            scale=_INSIDE,
            first=0.000625,
        ),
        Method(
            name="codig",
            entry_point="policies.published_rules:codig",
            text="CoDiG's rule: a barrier before that border",
            field="feasibility",
            scale=_IN_NOISE,
            first=0.25,
        ),
        Method(
            name="gpc_rank",
            entry_point="policies.tracking_methods:gpc_rank",
            text="GPC-RANK's rule: the sample of which the arm's controller leaves least",
            field=None,
            scale=_SAMPLES,
            first=2.0,
            counts=True,
            follows=True,
        ),
        Method(
            name="gpc_opt",
            entry_point="policies.tracking_methods:gpc_opt",
            text="GPC-OPT's rule: a chunk down the slope of what the arm's controller leaves",
            field=None,
            scale=_TRACKING,
            first=0.0009765625,
            follows=True,
        ),
        Method(
            name="eadp",
            entry_point="policies.tracking_methods:eadp",
            text="EADP's rule: noisy chunks down that slope",
            field=None,
            scale=_TRACKING,
            first=0.0078125,
            follows=True,
        ),
        Method(
            name="plan_by_map",
            entry_point="policies.plan_choice:plan_by_map",
            text="of several imagined episodes the one that the arm's map covers best",
            field="coverage",
            scale=_PLANS,
            first=2.0,
            counts=True,
            imagines=True,
        ),
        Method(
            name="plan_by_witness",
            entry_point="policies.plan_choice:plan_by_map",
            text="of several imagined episodes the one that least takes directions that only the source has",
            field="witness",
            scale=_PLANS,
            first=2.0,
            counts=True,
            imagines=True,
        ),
        Method(
            name="plan_of_any",
            entry_point="policies.plan_choice:plan_of_any",
            text="of several imagined episodes the shortest, whatever the arm can do",
            field=None,
            scale=_PLANS,
            first=2.0,
            counts=True,
            imagines=True,
        ),
        Method(
            name="plan_on_arm",
            entry_point="policies.plan_choice:plan_on_arm",
            also_needs=("arm's description",),
            text="of several imagined episodes one that the arm's kinematic twin can carry out",
            field=None,
            scale=_PLANS,
            first=2.0,
            counts=True,
            imagines=True,
        ),
    )
}
"""In the order in which they are told apart."""
GUIDED = tuple(name for name in METHODS if name != DIRECT)
"""Those that do something."""
SWEPT = tuple(name for name in GUIDED if not METHODS[name].asks_the_arm)
"""Of these, those that a field is enough for: what is swept unless others are named."""


def said_of_each(what: str) -> str:
    """A field of all methods that do something, `text` or `scale`, as a help text has it; those alike in one go."""
    alike: dict[str, list[str]] = {}
    for name in GUIDED:
        alike.setdefault(getattr(METHODS[name], what), []).append(name)
    return "; ".join(f"{', '.join(names)}: {text}" for text, names in alike.items())
