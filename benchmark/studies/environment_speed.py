"""Control steps beside bare physics, chunks of actions plain and guided, and whole rollouts, in one run.

    python -m benchmark.studies.environment_speed

Bare physics is MuJoCo stepping the same model through the same episodes: the same states, controls and contacts, with
nothing around it.
"""

import cProfile
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from pstats import Stats
from time import perf_counter, process_time
from typing import TYPE_CHECKING

from benchmark.artifacts.outputs import store_rows
from benchmark.settings.command import check_setting, run_command
from benchmark.settings.config import PAPER_ARMS, RobotConfig, RunConfig, check_folder, check_seeds
from richmap.outputs import replacing
from richmap.robots import ROBOTS

if TYPE_CHECKING:
    import gymnasium
    import pandas as pd
    from rich.console import Console

    from policies.modeling_guided_push import GuidedPushPolicy

KEY = ["name", "robot", "sampler", "environments", "threads", "method"]
"""A row replaces an older one that agrees in these columns."""

SAMPLERS = {"DDIM": 10, "DDPM": 100}
"""Samplers that are timed with method `paper`, and their steps; the other methods with the first, on one thread."""

SHOWN = 12
"""Functions of the profile in the table, those with the most time of their own."""


@dataclass
class EnvironmentSpeedConfig:
    """Measures control steps of each arm beside bare physics, chunks of actions plain and guided, and rollouts."""

    robots: list[str] = field(default_factory=lambda: list(PAPER_ARMS))
    """Arms, as in robots=[ur3,ur5]; their rows replace older ones in the table. [] for the sampling alone."""
    episodes: int = 10
    """Episodes of the scripted oracle per arm; a whole number >= 1."""
    environments: list[int] = field(default_factory=lambda: [1, 50])
    """Numbers of environments that a chunk of actions is sampled for; whole numbers >= 1."""
    threads: list[int] = field(default_factory=lambda: [1, 2])
    """Numbers of threads that sample a chunk; whole numbers from 1 to the number of processors."""
    repeats: int = 20
    """Measurements of a chunk of which the least counts; a whole number >= 1."""
    rollout_episodes: int = 500
    """Episodes of the learned policy per arm, rolled out as benchmark.run does; 0 to leave them out."""
    seed: int = 42
    """Training seed of the policy (see benchmark.run)."""
    seed_start: int = 50_000
    """Seed of the first episode."""
    workers: int = 2
    """Processes that roll out; a whole number >= 1."""
    output_dir: str = "results"
    """Folder of environment_speed.parquet and environment_speed.md."""

    def __post_init__(self) -> None:
        for name in self.robots:
            check_setting(name in ROBOTS, "robots", name, ", ".join(ROBOTS))
        for name in ("environments", "threads"):
            values = getattr(self, name)
            check_setting(bool(values) and min(values) >= 1, name, values, "whole numbers >= 1")
        most = os.cpu_count() or 1
        check_setting(max(self.threads) <= most, "threads", self.threads, f"whole numbers from 1 to {most}")
        for name in ("episodes", "repeats", "workers"):
            check_setting(getattr(self, name) >= 1, name, getattr(self, name), "a whole number >= 1")
        check_setting(self.rollout_episodes >= 0, "rollout_episodes", self.rollout_episodes, "a whole number >= 0")
        check_seeds(self.seed_start, max(self.episodes, self.rollout_episodes))
        check_folder(self.output_dir)


def main(config: EnvironmentSpeedConfig) -> None:
    """Measure arm after arm and then the sampling, and store and write the table after each."""
    from rich.console import Console

    console, output_dir = Console(), Path(config.output_dir)
    for name in config.robots:
        console.print(f"Control steps of {name}")  # A live display would take time of its own.
        rows = [{"robot": name, **row} for row in control_steps(name, config)]
        if config.rollout_episodes:
            rows += [{"robot": name, **row} for row in rollout_seconds(name, config, console)]
        write(output_dir, rows)
    for rows in sampling(config, console):
        write(output_dir, rows)
    console.print((output_dir / "environment_speed.md").read_text(), markup=False, soft_wrap=True)


def control_steps(robot: str, config: EnvironmentSpeedConfig) -> Iterator[dict[str, object]]:
    """Milliseconds of the processor per control step of one environment: all of it, bare physics, and by function."""
    import gymnasium

    from envs import ENVIRONMENTS

    env = gymnasium.make(ENVIRONMENTS[robot])
    seeds = range(config.seed_start, config.seed_start + config.episodes)
    timed_episode(env, config.seed_start)  # Warms up.
    steps, around, bare = (sum(values) for values in zip(*(timed_episode(env, seed) for seed in seeds), strict=True))
    yield {"name": "control_step", "value": 1e3 * around / steps, "unit": "ms", "count": steps}
    yield {"name": "mj_step", "value": 1e3 * bare / steps, "unit": "ms", "count": steps}
    yield {"name": "outside MuJoCo", "value": 1e3 * (around - bare) / steps, "unit": "ms", "count": steps}
    yield {"name": "control steps per second", "value": steps / around, "unit": "1/s", "count": steps}
    for function, seconds, calls in profiled_episode(env, config.seed_start):
        yield {"name": f"profile: {function}", "value": 1e3 * seconds, "unit": "ms", "count": calls}
    env.close()


def timed_episode(env: "gymnasium.Env", seed: int) -> tuple[int, float, float]:
    """An episode of the oracle, then its physics alone.

    The last step of a success, which holds still for a second more, is left out of both.

    Returns:
        Control steps; processor time of the environment's steps, in [s]; and that of `mj_step` in them.

    Raises:
        RuntimeError: If the physics alone comes to another state, so that something else was timed.
    """
    import mujoco
    import numpy as np

    from envs.block_push.oracle import Oracle
    from envs.block_push.simulation import SUBSTEPS

    observation, info = env.reset(seed=seed)
    model, data = env.unwrapped.physics
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    first, last, again = np.empty((3, mujoco.mj_stateSize(model, kind)))
    mujoco.mj_getState(model, data, first, kind)
    oracle, controls, around, terminated, truncated = Oracle(info["mode"]), [], 0.0, False, False
    while not (terminated or truncated):
        action, start = oracle(observation), process_time()
        observation, _, terminated, truncated, info = env.step(action)
        seconds = process_time() - start
        if not terminated:
            around += seconds
            controls.append(data.ctrl.copy())
            mujoco.mj_getState(model, data, last, kind)

    alone = mujoco.MjData(model)
    mujoco.mj_setState(model, alone, first, kind)
    start = process_time()
    for control in controls:
        alone.ctrl[:] = control
        mujoco.mj_step(model, alone, SUBSTEPS)
    bare = process_time() - start
    mujoco.mj_getState(model, alone, again, kind)
    if not np.array_equal(again, last):
        raise RuntimeError(f"The physics of seed {seed} alone is not that of the episode.")
    return len(controls), around, bare


def profiled_episode(env: "gymnasium.Env", seed: int) -> Iterator[tuple[str, float, int]]:
    """Where an episode's control steps spend the processor's time, as `cProfile` sees it.

    Yields:
        Function, seconds of its own per control step, and calls in all.
    """
    from envs.block_push.oracle import Oracle

    observation, info = env.reset(seed=seed)
    oracle, actions, over = Oracle(info["mode"]), [], False
    while not over:
        actions.append(oracle(observation))
        observation, _, terminated, truncated, info = env.step(actions[-1])
        over = terminated or truncated
    env.reset(seed=seed)
    profiler = cProfile.Profile(process_time)
    profiler.runcall(lambda: [env.step(action) for action in actions])
    functions = sorted(Stats(profiler).stats.items(), key=lambda item: -item[1][2])
    for (file, _, function), (_, calls, own, _, _) in functions[:SHOWN]:
        yield function.strip("<>") if file == "~" else f"{Path(file).stem}.{function}", own / len(actions), calls


def rollout_seconds(robot: str, config: EnvironmentSpeedConfig, console: "Console") -> Iterator[dict[str, object]]:
    """Wall time of episodes of the learned policy, without guidance, processes' start included."""
    from benchmark.artifacts.known_policies import checkpoint_folder
    from benchmark.artifacts.progress import progress_bar
    from benchmark.rollouts.make_rollout import make_rollout
    from benchmark.rollouts.rollout import roll_out

    run = RunConfig(robot=RobotConfig(robot), device="cpu")
    rollout = make_rollout(run, 0.0, checkpoint_folder(config.seed), console)
    seeds = range(config.seed_start, config.seed_start + config.rollout_episodes)
    start, ends = perf_counter(), []
    with progress_bar(console) as progress:
        task = progress.add_task(f"Rollouts on {robot}", total=len(seeds))
        for episodes in roll_out(rollout, seeds, config.workers):
            ends += [perf_counter() - start] * len(episodes)
            progress.advance(task, len(episodes))
    yield {"name": "rollouts", "value": ends[-1], "unit": "s", "count": len(ends)}
    head = min(len(ends) - 1, config.workers * run.slots)  # Workers start, and import for seconds, only once.
    value = ends[head - 1] + (500 - head) * (ends[-1] - ends[head - 1]) / (len(ends) - head)
    yield {"name": "500 rollouts", "value": value, "unit": "s", "count": len(ends)}


def sampling(config: EnvironmentSpeedConfig, console: "Console") -> Iterator[list[dict[str, object]]]:
    """Milliseconds per chunk of actions, plain and guided on a UR3, for each sampler and each method."""
    import torch

    from benchmark.artifacts.known_policies import checkpoint_folder
    from benchmark.rollouts.make_rollout import make_rollout
    from benchmark.rollouts.rollout import load_policy
    from policies.methods import GUIDED, METHODS

    checkpoint, (first, *_) = checkpoint_folder(config.seed), SAMPLERS
    timed = [(sampler, "paper", config.threads) for sampler in SAMPLERS]
    timed += [(first, method, [1]) for method in GUIDED if method != "paper"]
    for sampler, method, some_threads in timed:
        steps = SAMPLERS[sampler]
        run = RunConfig(RobotConfig("ur3"), method=method, sampler=sampler, sampling_steps=steps, device="cpu")
        plain, guided = (
            load_policy(make_rollout(run, scale, checkpoint, console)) for scale in (0.0, METHODS[method].first)
        )
        rows = []
        for threads, n in product(some_threads, config.environments):
            torch.set_num_threads(threads)
            about = {"sampler": f"{sampler}-{steps}", "environments": n, "threads": threads}
            about |= {"method": method, "count": config.repeats}
            rows += [{**about, **row} for row in chunk_speeds(plain, guided, n, config.repeats)]
            console.print(f"Chunks: {sampler}, {method}, {n} environments, {threads} threads")
        yield rows


def chunk_speeds(
    plain: "GuidedPushPolicy", guided: "GuidedPushPolicy", environments: int, repeats: int
) -> list[dict[str, object]]:
    """The least wall time of a chunk of both policies, and what guidance adds by either clock, wall and processor.

    They take turns, and the turns are short, so that what else the machine does meets both alike.
    """
    import numpy as np
    import torch

    from policies.noise import episode_noise

    generator = torch.Generator().manual_seed(0)
    batch = {
        name: 0.2 + 0.3 * torch.rand(environments, plain.config.n_obs_steps, width, generator=generator)
        for name, width in (
            ("observation.state", plain.config.space.state.width),
            ("observation.environment_state", plain.config.space.environment.width),
        )
    }
    noise = [episode_noise(range(environments), 0, policy.noise_shape) for policy in (plain, guided)]
    calls = 100 // plain.diffusion.num_inference_steps
    wall, processor = np.empty((2, repeats + 1, 2))  # The first turn warms up.
    with torch.inference_mode():
        for turn, (i, policy) in product(range(repeats + 1), enumerate((plain, guided))):
            start = perf_counter(), process_time()
            for _ in range(calls):
                policy.predict_action_chunk(batch, noise[i])
            wall[turn, i], processor[turn, i] = perf_counter() - start[0], process_time() - start[1]
    least = wall[1:].min(0) / calls
    added = {
        name: 100 * (np.median(seconds[1:, 1] / seconds[1:, 0]) - 1)
        for name, seconds in (("guidance adds, wall", wall), ("guidance adds, processor", processor))
    }
    return [
        {"name": "chunk", "value": 1e3 * least[0], "unit": "ms"},
        {"name": "guided chunk", "value": 1e3 * least[1], "unit": "ms"},
        *({"name": name, "value": value, "unit": "%"} for name, value in added.items()),
    ]


def write(output_dir: Path, rows: list[dict[str, object]]) -> None:
    """Add rows to the table, in place of older ones of the same measurement, and write it for people."""
    import pandas as pd

    new = pd.DataFrame(rows, columns=[*KEY, "value", "unit", "count"])
    new = new.fillna({"robot": "", "sampler": "", "environments": 0, "threads": 0, "method": ""})
    table = store_rows(output_dir / "environment_speed.parquet", new, KEY)
    with replacing(output_dir / "environment_speed.md") as path:
        path.write_text(markdown(table))


TEXT = """# Speed of environments, sampling and rollouts

One environment on one core, 10 control steps per second of 50 steps of physics each (2 ms), driven by the scripted
oracle. `control_step` is Gymnasium's `step`, `mj_step` MuJoCo alone through the same episodes, state by state; both in
milliseconds of processor time per control step. `rollouts` are episodes of the learned policy as `benchmark.run` plays
them, wall time with the start of its processes; `500 rollouts` goes on from them in proportion. Made by
`python -m benchmark.studies.environment_speed`.

{arms}

Where the time goes: milliseconds of processor time of a function's own per control step, under `cProfile`, which makes
Python look slower than it is; the functions with the most.

{profile}

Sampling a chunk of actions, wall time, the least of some repeats; guided on a UR3. What guidance adds is the median
over pairs measured in turn, by either clock; the best of two samples takes two samples.

{chunks}
"""


def markdown(table: "pd.DataFrame") -> str:
    """The tables for people."""
    arms = table[table.robot != ""]
    profiled = arms.name.str.startswith("profile: ")
    measured = arms[~profiled].assign(name=arms.name + " [" + arms.unit + "]")
    own = arms[profiled].assign(name=arms.name.str.removeprefix("profile: "))
    chunks = table[table.sampler != ""].assign(name=lambda t: t.name + " [" + t.unit + "]")

    def shown(rows: "pd.DataFrame", index: list[str], columns: str, digits: str) -> str:
        wide = rows.pivot_table("value", index, columns, sort=False)
        return wide.reset_index().to_markdown(index=False, floatfmt=digits, missingval="")

    order = own.groupby("name").value.max().sort_values(ascending=False)
    own = own.set_index("name").loc[order.index].reset_index()
    return TEXT.format(
        arms=shown(measured, ["name"], "robot", ".4g") if len(measured) else "",
        profile=shown(own, ["name"], "robot", ".3f") if len(own) else "",
        chunks=shown(chunks, ["sampler", "method", "environments", "threads"], "name", ".3g") if len(chunks) else "",
    )


if __name__ == "__main__":
    run_command(main, EnvironmentSpeedConfig, "environment_speed")
