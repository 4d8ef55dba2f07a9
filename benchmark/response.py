"""What lambda does: how far guidance moves the first action, and what the denoising steps are worth.

    python -m benchmark.response policies=[results/checkpoints/seed42-1]

A push g is added to the predicted noise at every denoising step, as the paper's method adds lambda times the slope, and
the first action is compared with that without it, from the same noise. On paper guidance goes against the push.
"""

from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float
from torch import Tensor

from benchmark.checkpoint import GUIDED, Checkpoint
from benchmark.command import SettingError, check_setting, run_command
from benchmark.config import RobotConfig, RunConfig, check_folder, check_seeds
from benchmark.outputs import replacing
from policies.guidance import Guidance

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console

    from policies.modeling_guided_push import GuidedPushPolicy

SCALES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Pushes g, in normalised action units."""

SHOWN = (0.05, 0.2, 1.0, 4.0)
"""Those in the table by place."""

SAMPLERS = {"DDIM": 10, "DDPM": 100}
"""Samplers, and their steps."""

RINGS = (0.0, 0.25, 0.35, 0.45, 0.55, 1.0)
"""Borders of the places on the table: distances from the xArm6's base axis, in [m]."""

PER_EPISODE = 20
"""Observations that are taken from one episode."""

HISTORY = 8
"""Past observations that are kept of each; policies look at fewer."""


@dataclass
class ResponseConfig:
    """Measures how far a push on the predicted noise moves the first action, and success by denoising steps."""

    policies: list[str] = field(default_factory=list)
    """Checkpoints of type guided_push, as in policies=[results/checkpoints/seed42-1,outputs/x0/seed42-1]; empty for the
    one of seed."""
    seed: int = 42
    """Training seed of the policy (see benchmark.run)."""
    observations: int = 400
    """Observations from rollouts, 20 of an episode; a whole number >= 1."""
    steps: list[int] = field(default_factory=lambda: [1, 2, 3, 5, 10, 20, 50])
    """Numbers of denoising steps whose success is measured on the xArm6, each from 1 to 100."""
    episodes: int = 100
    """Episodes for each number of denoising steps; 0 to leave them out."""
    seed_start: int = 50_000
    """Seed of the first episode."""
    workers: int = 2
    """Processes that roll out; results do not depend on it. A whole number >= 1."""
    output_dir: str = "results"
    """Folder of response.parquet, response.md and the figure; episodes go to its folder response."""

    def __post_init__(self) -> None:
        for name, least in (("observations", 1), ("workers", 1), ("episodes", 0)):
            check_setting(getattr(self, name) >= least, name, getattr(self, name), f"a whole number >= {least}")
        possible = all(1 <= steps <= 100 for steps in self.steps)
        check_setting(possible, "steps", self.steps, "whole numbers from 1 to 100")
        check_seeds(self.seed_start, max(self.episodes, self.observations))
        check_folder(self.output_dir)


@dataclass(frozen=True)
class Observations:
    """What a policy sees at some steps of some rollouts, with the past."""

    state: Float[Tensor, "n history 4"]
    environment: Float[Tensor, "n history 12"]
    seed: list[int]
    """Of each one's episode."""
    step: list[int]
    """Of that episode; 0 is its start."""


class ConstantPush(Guidance):
    """The same push for each row whatever it sees, in normalised action units."""

    def __init__(self, vectors: Float[Tensor, "b 2"]) -> None:
        self.vectors = vectors

    def push(self, effector: Float[Tensor, "b 4"]) -> Float[Tensor, "b 2"]:
        return self.vectors


def main(config: ResponseConfig) -> None:
    """Measure the responses and the success by denoising steps that are not stored yet; write table and figure."""
    from rich.console import Console

    from benchmark.known_policies import checkpoint_folder

    console, output_dir = Console(), Path(config.output_dir)
    folders = [Path(path) for path in config.policies] or [checkpoint_folder(config.seed)]
    for folder in folders:
        kind = Checkpoint.from_path(str(folder)).type
        if kind != GUIDED:
            raise SettingError(f"policies={folder} is of type {kind}; only type {GUIDED} can be guided.")
    responses = measure(folders, config, console)
    success = success_by_steps(folders[0], config, console)
    with replacing(output_dir / "response.md") as file:
        file.write_text(markdown(folders, responses, success))
    figure = output_dir / "figures" / "response.png"
    with replacing(figure) as file:
        draw(responses, success).savefig(file, dpi=120)
    console.print(f"Table: {output_dir / 'response.md'}, figure: {figure}", soft_wrap=True)


def measure(folders: list[Path], config: ResponseConfig, console: "Console") -> pd.DataFrame:
    """Rows of all policies and samplers (`response_rows`), on observations of the first one's rollouts with the first
    sampler; those that this code has stored are not measured again."""
    from benchmark.code_version import code_version
    from benchmark.make_rollout import make_rollout
    from benchmark.rollout import load_policy

    file = Path(config.output_dir) / "response.parquet"
    table = pd.read_parquet(file) if file.exists() else pd.DataFrame()
    observed, driver, wanted = None, None, []
    for folder in folders:
        for sampler, steps in SAMPLERS.items():
            run = RunConfig(robot=RobotConfig("xarm6"), sampler=sampler, sampling_steps=steps, device="cpu")
            rollout = make_rollout(run, 0.0, folder, console)
            driver = driver or rollout
            about = {
                "checkpoint": rollout.condition.checkpoint,
                "checkpoint_hash": rollout.condition.checkpoint_hash,
                "sampler": f"{sampler}-{steps}",
                "observed_by": driver.condition.checkpoint_hash,
                "observations": config.observations,
                "code_version": code_version(),
            }
            wanted.append(about)
            if len(table) and (table[list(about)] == pd.Series(about)).all(axis=1).any():
                continue
            policy = load_policy(rollout)
            observed = observed or observe(load_policy(driver), config, console)
            console.print(f"Response of {rollout.condition.checkpoint} with {about['sampler']}")
            rows = response_rows(policy, observed).assign(prediction=policy.config.prediction_type, **about)
            table = pd.concat([table, rows], ignore_index=True)
            with replacing(file) as path:
                table.to_parquet(path, index=False)
    return table.merge(pd.DataFrame(wanted), on=list(about))


def observe(policy: "GuidedPushPolicy", config: ResponseConfig, console: "Console") -> Observations:
    """Observations of the policy's own rollouts on the xArm6: the start of each, and others drawn from its steps."""
    import gymnasium

    from benchmark.progress import progress_bar
    from envs import ENVIRONMENTS
    from policies.noise import episode_noise

    env = gymnasium.make(ENVIRONMENTS["xarm6"], obs_type="environment_state_agent_pos")
    rng, rows = np.random.default_rng(0), []
    episodes = -(-config.observations // PER_EPISODE)
    with progress_bar(console) as progress:
        for seed in progress.track(range(config.seed_start, config.seed_start + episodes), description="Rollouts"):
            policy.reset()
            (now, _), over, seen, past = env.reset(seed=seed), False, [], deque(maxlen=HISTORY)
            while not over:
                batch = {
                    "observation.state": torch.from_numpy(now["agent_pos"]).float()[None],
                    "observation.environment_state": torch.from_numpy(now["environment_state"]).float()[None],
                }
                past.extend(
                    [list(batch.values())] * (1 if past else HISTORY)
                )  # What was before the start is the start.
                seen.append((*(torch.cat(values) for values in zip(*past, strict=True)), seed, len(seen)))
                noise = episode_noise([seed], len(seen) - 1, policy.noise_shape)
                with torch.inference_mode():
                    action = policy.select_action(batch, noise=noise)[0].numpy()
                now, _, terminated, truncated, _ = env.step(action)
                over = terminated or truncated
            drawn = 1 + rng.choice(len(seen) - 1, min(PER_EPISODE, len(seen) - 1), replace=False)
            rows += [seen[0], *(seen[i] for i in sorted(drawn))]
    env.close()
    policy.reset()
    state, environment, seeds, steps = zip(*rows, strict=True)
    return Observations(torch.stack(state), torch.stack(environment), list(seeds), list(steps))


def response_rows(policy: "GuidedPushPolicy", observed: Observations) -> pd.DataFrame:
    """Shift of the first action along the push per unit of it, paired by the noise.

    Returns:
        For each push (`direction` x, y or outward from the base; `scale` g) and observation: `radius` of the flange
        from the base axis, in [m], whether it is the `start` of an episode, and `shift` in [mm] per unit.
    """
    from policies.noise import episode_noise

    n_obs = policy.config.n_obs_steps
    batch = {
        "observation.state": observed.state[:, -n_obs:],
        "observation.environment_state": observed.environment[:, -n_obs:],
    }
    flange = observed.state[:, -1, :2]
    outward = flange / flange.norm(dim=1, keepdim=True)
    directions = {"x": torch.tensor([1.0, 0.0]), "y": torch.tensor([0.0, 1.0]), "outward": outward}
    about = {"radius": flange.norm(dim=1).numpy(), "start": np.array(observed.step) == 0}
    noise = episode_noise(observed.seed, observed.step, policy.noise_shape)
    unguided, tables = policy.guidance, []

    def first_action(push: Float[Tensor, "b 2"]) -> Float[Tensor, "b 2"]:
        policy.guidance = ConstantPush(push)
        return policy.predict_action_chunk(batch, noise)[:, 0]

    with torch.inference_mode():
        plain = first_action(torch.zeros_like(flange))
        for name, direction in directions.items():
            for scale in SCALES:
                moved = first_action(scale * direction.expand_as(flange)) - plain
                shift = 1000 * (moved * direction).sum(1) / scale
                tables.append(pd.DataFrame({"direction": name, "scale": scale, **about, "shift": shift.numpy()}))
    policy.guidance = unguided
    return pd.concat(tables, ignore_index=True)


def success_by_steps(folder: Path, config: ResponseConfig, console: "Console") -> pd.DataFrame:
    """Episodes of the xArm6 for each number of denoising steps; those that are stored are not run again."""
    from benchmark.make_rollout import make_rollout
    from benchmark.missing_episodes import run_and_store

    tables = []
    for sampler, steps in [*(("DDIM", steps) for steps in config.steps), ("DDPM", 100)] if config.episodes else []:
        run = RunConfig(
            robot=RobotConfig("xarm6"), sampler=sampler, sampling_steps=steps, episodes=config.episodes,
            seed_start=config.seed_start, workers=config.workers, device="cpu",
            output_dir=str(Path(config.output_dir) / "response"),
        )  # fmt: skip
        tables.append(run_and_store(make_rollout(run, 0.0, folder, console), run, console))
    return pd.concat(tables, ignore_index=True) if tables else pd.DataFrame()


TEXT = """# What lambda does

A push g, in normalised action units (30 mm), is added to the predicted noise at every denoising step, as the paper's
method adds λ∇E. Shift of the first action along the push in mm per unit of g, from paired samples with the same noise,
over {n} observations of rollouts on the xArm6: mean (median) and, of several checkpoints, the least and the greatest
mean of one. `epsilon` predicts the noise, `sample` the actions (x0). Below 0: against the push, as guidance is meant.
The paper's λ is the push divided by the slope, at most 0.2 per metre at Δ = 0.05 m. Made by

    python -m benchmark.response policies=[{policies}]

{scales}

By place on the table, for a push away from the base: R is the flange's distance from the xArm6's base axis, `start` the
first observation of an episode, where modes compete.

{places}

## Success by denoising steps

xArm6, embodied, without guidance, percent with 95 % intervals.

{success}
"""


def markdown(policies: list[Path], responses: pd.DataFrame, success: pd.DataFrame) -> str:
    """The tables for people."""
    from benchmark.scores import by_condition, with_interval

    by = ["prediction", "sampler", "scale"]
    elsewhere = responses[~responses.start]
    outward = responses[(responses.direction == "outward") & responses.scale.isin(SHOWN)]
    text = "-"
    if len(success):
        rows = by_condition(success).sort_values(["sampler", "sampling_steps"])
        shown = {name: [with_interval(row, name) for _, row in rows.iterrows()] for name in ("p2", "score")}
        about = {"sampler": rows["sampler"], "steps": rows["sampling_steps"], "checkpoint": rows["checkpoint"]}
        text = pd.DataFrame({**about, "n": rows["n"], **shown}).to_markdown(index=False)
    return TEXT.format(
        n=len(elsewhere) // elsewhere.groupby([*by, "checkpoint_hash", "direction"]).ngroups,
        policies=",".join(map(str, policies)),
        scales=_wide(elsewhere[elsewhere.direction != "outward"], by, "direction"),
        places=_wide(outward.assign(place=place), by, "place"),
        success=text,
    )


def place(responses: pd.DataFrame) -> pd.Series:
    """Name of the place of each row: a ring about the base, or the start of an episode."""
    names = [f"R {low:.2f}-{high:.2f}" for low, high in zip(RINGS, RINGS[1:], strict=False)]
    rings = pd.cut(responses.radius, RINGS, labels=names, right=False).astype(str)
    return rings.where(~responses.start, "start")


def _wide(responses: pd.DataFrame, rows: list[str], column: str) -> str:
    """Mean (median) of the shift and the range of the checkpoints' means, one column for each value of a column."""
    cells = responses.groupby([*rows, column])["shift"].agg(["mean", "median"])
    single = responses.groupby([*rows, column, "checkpoint_hash"])["shift"].mean().groupby([*rows, column])
    cells = cells.assign(low=single.min(), high=single.max())

    def text(cell: pd.Series) -> str:
        between = "" if cell["low"] == cell["high"] else f" {cell['low']:+.1f} to {cell['high']:+.1f}"
        return f"{cell['mean']:+.1f} ({cell['median']:+.1f}){between}"

    return (
        cells.apply(text, axis=1)
        .unstack(column, fill_value="")
        .reset_index()
        .rename(columns={"scale": "g"})
        .to_markdown(index=False)
    )


def draw(responses: pd.DataFrame, success: pd.DataFrame) -> "Figure":
    """The shift against g by sampler, and by place; p2 against the number of denoising steps."""
    from matplotlib.figure import Figure

    from benchmark.statistics import rate_interval

    figure = Figure(figsize=(13, 3.8), layout="constrained")
    by_sampler, by_place, by_steps = figure.subplots(1, 3)
    elsewhere = responses[~responses.start & (responses.direction != "outward")]
    for (prediction, sampler), rows in elsewhere.groupby(["prediction", "sampler"]):
        shift = rows.groupby("scale")["shift"].agg(["mean", "median"])
        (line,) = by_sampler.plot(shift.index, shift["mean"], ".-", label=f"{prediction}, {sampler}")
        by_sampler.plot(shift.index, shift["median"], ":", color=line.get_color())
        for _, of_one in rows.groupby("checkpoint_hash"):
            by_sampler.plot(of_one.groupby("scale")["shift"].mean(), color=line.get_color(), linewidth=0.5)
    by_sampler.set(title="pushes along x and y: mean (dotted: median)\nof all policies; thin: of each")
    by_sampler.set(ylabel="shift of the first action [mm per unit]")
    first = responses[responses.checkpoint == responses.checkpoint.iloc[0]]
    first = first[(first.direction == "outward") & (first.sampler == first.sampler.iloc[0])].assign(place=place)
    for name, rows in first.groupby("place"):
        shift = rows.groupby("scale")["shift"].mean()
        by_place.plot(shift.index, shift, ".-", label=f"{name} (n = {rows.groupby('scale').size().iloc[0]})")
    by_place.set(title=f"push away from the base, {first.checkpoint.iloc[0]}, {first.sampler.iloc[0]}")
    for ax in (by_sampler, by_place):
        ax.axhline(0, color="0.7", linewidth=0.8)
        ax.set_xscale("log")
        ax.set_xlabel("push g [normalised action units]")
        ax.legend(fontsize="x-small")
    for sampler, rows in success.groupby("sampler") if len(success) else ():
        rates = rows.groupby("sampling_steps").p2.agg(["mean", rate_interval])
        low, high = np.array(rates["rate_interval"].tolist()).T
        error = 100 * np.array([rates["mean"] - low, high - rates["mean"]]).clip(0)  # At 1 it rounds to below 0.
        by_steps.errorbar(rates.index, 100 * rates["mean"], error, fmt=".-", capsize=3, label=sampler)
        by_steps.legend(fontsize="x-small")
    by_steps.set(title="both blocks placed, xArm6, λ = 0", xlabel="denoising steps", ylabel="p2 [%]", xscale="log")
    return figure


if __name__ == "__main__":
    run_command(main, ResponseConfig, "response")
