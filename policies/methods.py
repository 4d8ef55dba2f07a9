"""The methods of guidance, each declared once (`policies.method.Method`). This module is quick to import."""

from policies.method import SHAPES, Method

DIRECT = "direct"
"""What a scale of 0 is, whatever the method."""


def method_named(name: str) -> Method:
    """The method of a name.

    Raises:
        ValueError: If there is none.
    """
    if name not in METHODS:
        raise ValueError(f"There is no guidance {name!r}. Methods: {', '.join(METHODS)}.")
    return METHODS[name]


_SLOPE = "how much of the energy's slope, in [1/m], is added to the noise, in normalised action units"
_PUSHED = "how far inside the border a push must keep the tool, in [m], to be made first"
_BORDER = "push at the border of what the arm can hold, in normalised action units"
_RADIAL = "push, the same everywhere, in normalised action units"
_SAMPLES = "number of chunks sampled, of which the best is taken"
_PATHS = "number of the scripted expert's paths that are tried along each way, in each order"
_PLANS = "number of episodes imagined at once"
_ENOUGH = "merit from which on ways count as alike: 1 less what the pose at the worst goal costs, without a unit"
_DESCENT = "descent of the normalised clean actions per unit of the cost's slope along the chunk"
_IN_NOISE = "how much of the slope along the chunk is added to the noise, in normalised action units"
_TRACKING = "descent of the actions, in m and rad, per unit of the tracking cost's slope, in m^2 and rad^2"
_AWAY = "how far the arm's body is kept from obstacles, in [m]"
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
            scale=_PUSHED,
            first=0.0025,
            task="block_push",
        ),
        Method(
            name="reorder_among",
            entry_point="policies.block_push.reorder:reorder",
            text="the same, also for obstacles",
            field="feasibility",
            scale=_PUSHED,
            first=0.0025,
            task="block_push",
            avoids=True,
        ),
        Method(
            name="reorder_kept",
            entry_point="policies.block_push.reorder:reorder_kept",
            text="and commands kept inside of what the arm can hold",
            field="feasibility",
            scale=_PUSHED,
            first=0.0025,
            task="block_push",
            avoids=True,
        ),
        Method(
            name="reorder_by_map",
            entry_point="policies.block_push.reorder:reorder",
            text="what the arm cannot push by its map alone is left for later",
            field="reach",
            scale=_PUSHED,
            first=0.0025,
            task="block_push",
        ),
        Method(
            name="reorder_by_branch",
            entry_point="policies.block_push.reorder:reorder",
            text="what the arm cannot push by the map of its branch is left for later",
            field="branch_reach",
            scale=_PUSHED,
            first=0.0025,
            task="block_push",
        ),
        Method(
            name="reorder_through_map",
            entry_point="policies.block_push.reorder:reorder_kept",
            text="as reorder_kept, by the map of the arm's branch and the configurations that it keeps",
            field="branch_reach",
            scale=_PUSHED,
            first=0.0025,
            task="block_push",
            avoids=True,
            also_needs=(SHAPES,),
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
            task="press_buttons",
        ),
        Method(
            name="way_by_branch",
            entry_point="policies.way_choice:way_by_map",
            text="as way_by_map, by the map of the arm's branch above the table",
            field="branch_coverage",
            scale=_ENOUGH,
            first=0.125,
            imagines=True,
            task="press_buttons",
        ),
        Method(
            name="way_by_witness",
            entry_point="policies.way_choice:way_by_map",
            text="as way_by_map, with directions that only the source has in place of those that the arm lacks",
            field="witness",
            scale=_ENOUGH,
            first=0.125,
            imagines=True,
            task="press_buttons",
        ),
        Method(
            name="way_by_flipped_map",
            entry_point="policies.way_choice:way_by_flipped_map",
            text="as way_by_map, with the way whose worst goal is covered least",
            field="coverage",
            scale=_ENOUGH,
            first=0.125,
            imagines=True,
            task="press_buttons",
        ),
        Method(
            name="way_by_shuffled_map",
            entry_point="policies.way_choice:way_by_shuffled_map",
            text="as way_by_map, with the map's cells in other places",
            field="coverage",
            scale=_ENOUGH,
            first=0.125,
            imagines=True,
            task="press_buttons",
        ),
        Method(
            name="way_of_any",
            entry_point="policies.way_choice:way_of_any",
            text="as way_by_map, with the way that is named first, whatever the arm can do",
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
            scale=_PATHS,
            first=1.0,
            counts=True,
            imagines=True,
            avoids=True,
            also_needs=("arm's description",),
        ),
        Method(
            name="way_on_arm_anew",
            entry_point="policies.way_choice:way_on_arm_anew",
            text="the same without commitment: the best way at each look",
            field=None,
            scale=_PATHS,
            first=1.0,
            counts=True,
            imagines=True,
            task="press_buttons",
            avoids=True,
            also_needs=("arm's description",),
        ),
        Method(
            name="way_through_map",
            entry_point="policies.way_choice:way_through_map",
            text="the one along which the map of the arm's branch has most, free of what stands there",
            field="branch_map",
            scale="number of poses that are asked about each one on the scripted expert's paths",
            first=4.0,
            counts=True,
            imagines=True,
            avoids=True,
            also_needs=(SHAPES,),
            task="press_buttons",
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
            name="noise_by_tracking",
            entry_point="policies.tracking_methods:noise_by_tracking",
            text="noise sought instead of drawn: that of whose chunk the arm's controller leaves least",
            field=None,
            scale="number of noises tried, one after another",
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
            name="embodisteer",
            entry_point="policies.body_methods:embodisteer",
            text="EmbodiSteer's rule: the body kept off obstacles in the joints, as the chunk is sampled",
            field=None,
            scale=_AWAY,
            first=0.0025,
            follows=True,
            avoids=True,
        ),
        Method(
            name="embodisteer_command",
            entry_point="policies.body_methods:embodisteer_command",
            text="its correction of the executed command alone",
            field=None,
            scale=_AWAY,
            first=0.0025,
            follows=True,
            avoids=True,
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
            avoids=True,
        ),
    )
}
"""In the order in which they are told apart."""
GUIDED = tuple(name for name in METHODS if name != DIRECT)
"""Those that do something."""
SWEPT = tuple(name for name in GUIDED if not METHODS[name].asks_the_arm)
"""Of these, those that a field is enough for: what is swept unless others are named."""

BY_TASK = {
    "plan_for_arm": {"block_push": "reorder_kept", "press_buttons": "way_on_arm"},
    "plan_from_maps": {"block_push": "reorder_by_map", "press_buttons": "way_by_map"},
    "plan_from_branch": {"block_push": "reorder_by_branch", "press_buttons": "way_by_branch"},
    "plan_through_map": {"block_push": "reorder_through_map", "press_buttons": "way_through_map"},
    "dynaguide": {"block_push": "dynaguide_feasibility", "press_buttons": "dynaguide_coverage"},
    "itps": {"block_push": "itps_feasibility", "press_buttons": "itps_coverage"},
}
"""Rules that are another method in each task, by the task's name: `plan_for_arm` shows the policy only what its arm can
do, `plan_from_maps` what the arm's map says that it can, `plan_from_branch` what the map of its branch says,
`plan_through_map` what the configurations say that this keeps; `dynaguide` and `itps` look at what the arm cannot hold,
or at the directions that it lacks. Rows and chosen scales bear the method's own name."""


def in_task(method: str, task: str) -> str:
    """The method that a rule is in a task; any other name as it is."""
    return BY_TASK.get(method, {}).get(task, method)


def said_of_each(what: str) -> str:
    """A field of all methods that do something, `text` or `scale`, as a help text has it; those alike in one go."""
    alike: dict[str, list[str]] = {}
    for name in GUIDED:
        alike.setdefault(getattr(METHODS[name], what), []).append(name)
    said = [f"{', '.join(names)}: {text}" for text, names in alike.items()]
    for rule, methods in BY_TASK.items():
        said.append(f"{rule}: as " + " or ".join(f"{method} in {task}" for task, method in methods.items()))
    return "; ".join(said)
