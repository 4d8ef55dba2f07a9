"""What several test modules need. Loaded before shapes are checked, so it imports richmap inside of functions."""

import contextlib
import functools
import json
import logging

import jaxtyping
import numpy as np
import pytest


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Shapes are checked where facts are tested. What is run as a user runs it is not checked, as it is not for a user:
    checks at each control step would take a quarter of the time."""
    jaxtyping.config.update("jaxtyping_disable", item.get_closest_marker("system") is not None)


@pytest.fixture(scope="session", autouse=True)
def every_torch_warning():
    """Torch warns once a process by default: whether a test met the warning would depend on what ran before it."""
    import torch

    torch.set_warn_always(True)


@pytest.fixture(autouse=True)
def no_log_outlives_its_test():
    """A library that is made to log, as by Hydra's --info, would go on doing so into a test's closed output."""
    root = logging.getLogger()
    handlers, level = root.handlers[:], root.level
    yield
    for handler in root.handlers[:]:
        if handler not in handlers and type(handler) in (logging.StreamHandler, logging.FileHandler):
            root.removeHandler(handler)
    root.setLevel(level)


@pytest.fixture(scope="session")
def cut_short():
    """Cuts episodes of our tasks that this process plays off after so many steps: what comes later, nobody asks."""
    import gymnasium

    from benchmark.rollouts.arm_oracle import _environment, _prepared
    from benchmark.rollouts.rollout import _arm_environment
    from envs import BLOCK_PUSH, PRESS_BUTTONS

    def forget():
        for kept in (_arm_environment, _environment, _prepared):
            kept.cache_clear()

    @contextlib.contextmanager
    def cut(steps):
        with pytest.MonkeyPatch.context() as patch:
            for task in (BLOCK_PUSH, PRESS_BUTTONS):
                patch.setattr(gymnasium.spec(task), "max_episode_steps", steps)
            forget()
            yield
        forget()

    return cut


@pytest.fixture
def brief(cut_short):
    """Episodes have 20 steps."""
    with cut_short(20):
        yield


@pytest.fixture
def quick_films(monkeypatch):
    """Films are larger files than they could be, and there in a tenth of the time."""
    import imageio.v3 as imageio

    write = imageio.imwrite
    larger = {"method": 0, "minimize_size": False}
    monkeypatch.setattr(imageio, "imwrite", lambda file, pictures, **how: write(file, pictures, **how | larger))


@pytest.fixture(scope="session")
def sampled_map():
    """Makes the map of plain random configurations: not theta-separated, and full of gaps, but there in a blink."""

    @functools.cache
    def make(name, grid, configurations):
        from richmap.maps.reachability_map import Construction, ReachabilityMap
        from richmap.motion.kinematics import flange_frames
        from richmap.robots.robots import load_robot

        robot = load_robot(name)
        joints = np.random.default_rng(0).uniform(robot.lower, robot.upper, (configurations, len(robot.joints)))
        position, rotation = flange_frames(robot, joints)
        cell = grid.cells_of(position)
        inside = cell >= 0
        rows = cell[inside], rotation[inside, :, 2].astype(np.float32), joints[inside].astype(np.float32)
        settings = Construction(name, robot.fingerprint, theta=0.3, seed=0, draw=1, turns=1, stop_rate=0.1, target=0)
        return ReachabilityMap.from_rows(grid, *rows, np.stack([robot.lower, robot.upper]), settings)

    return make


@pytest.fixture(scope="session")
def transfer_episodes():
    """A small table of episodes of both protocols, as the sweep and an entry from outside would store them."""
    import dataclasses

    from benchmark.episodes.arm import arm_columns
    from benchmark.episodes.episode import Condition, Episode, as_frame
    from envs.block_push.arm import block_push_arm
    from envs.block_push.outcome import EpisodeOutcome
    from envs.block_push.scene import draw_scene
    from envs.block_push.task import BLOCK_PUSH

    rng = np.random.default_rng(0)
    about = dict(
        task="block_push", sampler="DDIM", sampling_steps=10, device="cpu", commit="c1c1c1c",
        episode_version=BLOCK_PUSH.episode_version("embodied"),
    )  # fmt: skip
    nothing = {f.name: {float: 0.0, int: 0, str: "free"}.get(f.type) for f in dataclasses.fields(EpisodeOutcome)}
    causes = ["outer_reach", "pushed_through", "dithering"]

    def rows(robot, setting, method, scale, rate, checkpoints, seeds, entry_hash=""):
        field = method not in ("direct", "pull-back")
        binds = setting != "original"
        batch_size = 50 if binds else 10
        for checkpoint in checkpoints:
            condition = Condition(
                **arm_columns(block_push_arm(robot, setting)), method=method, guidance_scale=scale,
                checkpoint=checkpoint, field_fingerprint="f" * field, entry_hash=entry_hash,
                cell_size=0.05 if field else float("nan"), training_seed=int(checkpoint[4:6]),
                checkpoint_hash=f"hash of {checkpoint}", batch_size=batch_size, **about,
            )  # fmt: skip
            for seed in seeds:
                p1, p2 = sorted(rng.random(2) < rate, reverse=True)
                length = 3 if p2 else 350
                outcome = EpisodeOutcome(**nothing | dict(
                    score=0.49 * p1 + 0.51 * p2, p1=bool(p1), p2=bool(p2), length=length,
                    success_at_end=bool(p2 and rng.random() < 0.9),
                    mode=draw_scene(seed).mode,
                    first_block=int(rng.integers(2)) if p1 else None, first_entry_s=0.2 if p1 else None,
                    first_target=str(rng.choice(["near", "far"])) if p1 else None,
                    failure_cause=None if p2 else str(rng.choice(causes)), share_near_base=float(rng.random() / 10),
                ))  # fmt: skip
                yield Episode(condition, seed, seed % batch_size, outcome).row()

    models = ["seed42-1", "seed42-2", "seed43-1", "seed44-1"]
    best, first = ["seed42-1", "seed43-1", "seed44-1"], range(99_999, 100_010)
    table = [*rows("xarm6", "original", "direct", 0.0, 0.95, models, first)]
    for scale in (0.0, 0.5, 1.0):
        table += rows("ur3", "original", "paper" if scale else "direct", scale, 0.5 + 0.2 * scale, models, first)
    for robot, rate in (("ur3", 0.6), ("ur5", 0.9)):
        for method, scale in (("direct", 0.0), ("paper", 2.0), ("projection", 0.01)):
            table += rows(
                robot, "embodied", method, scale, rate + 10 * scale * (scale < 1), models, range(150_045, 150_055)
            )
    table += rows("ur3", "embodied", "pull-back", 1.0, 0.7, best, range(150_045, 150_055), "e" * 64)
    return as_frame(table, EpisodeOutcome)


@pytest.fixture
def offline_runs():
    """Reads what W&B kept on disk: of each run in a folder its settings, history, summary and artifacts, by their
    names."""
    from types import SimpleNamespace

    import wandb
    from wandb.proto.wandb_internal_pb2 import Record
    from wandb.sdk.internal.datastore import DataStore

    def plain(items):
        return {".".join(item.nested_key) or item.key: json.loads(item.value_json) for item in items}

    def read(folder):
        wandb.teardown()  # Ends the process that writes the files.
        runs = []
        for file in folder.glob("wandb/offline-run-*/run-*.wandb"):
            store, records = DataStore(), []
            store.open_for_scan(str(file))
            while (data := store.scan_data()) is not None:
                records.append(Record.FromString(data))
            store.close()
            (run,) = [record.run for record in records if record.HasField("run")]
            summaries = [plain(record.summary.update) for record in records if record.HasField("summary")]
            artifacts = [record.artifact for record in records if record.HasField("artifact")]
            runs.append(
                SimpleNamespace(
                    start=run.start_time.ToNanoseconds(),
                    name=run.display_name,
                    kind=run.job_type,
                    group=run.run_group,
                    config=plain(run.config.update),
                    history=[plain(record.history.item) for record in records if record.HasField("history")],
                    summary={name: value for each in summaries for name, value in each.items()},
                    made={each.name: each for each in artifacts if not each.use_after_commit},
                    used={each.name: each for each in artifacts if each.use_after_commit},
                )
            )
        return sorted(runs, key=lambda run: run.start)

    return read


@pytest.fixture(scope="session")
def synthetic_dataset(tmp_path_factory):
    """A dataset of two made-up demonstrations, laid out as ours are."""
    from benchmark.training.demonstration import Demonstration
    from benchmark.training.demonstration_dataset import write_dataset
    from envs.block_push.task import BLOCK_PUSH

    rng = np.random.default_rng(0)
    root = tmp_path_factory.mktemp("demonstrations") / "synthetic"
    end = np.arange(12) == 11
    episodes = [
        Demonstration(
            seed, "clean", 1, rng.uniform(0.2, 0.5, (12, 16)).astype(np.float32),
            rng.uniform(-0.03, 0.03, (12, 2)).astype(np.float32), end.astype(np.float32), end,
        )
        for seed in range(2)
    ]  # fmt: skip
    write_dataset(episodes, root, BLOCK_PUSH, 2)
    return root


@pytest.fixture(scope="session")
def untrained(synthetic_dataset, tmp_path_factory):
    """LeRobot's own diffusion policy, with random weights: it samples by DDPM, which draws noise at every step."""
    import torch
    from lerobot.datasets import LeRobotDatasetMetadata
    from lerobot.policies import make_policy, make_policy_config, make_pre_post_processors

    torch.manual_seed(0)
    meta = LeRobotDatasetMetadata("local/synthetic", root=synthetic_dataset)
    config = make_policy_config(
        "diffusion", device="cpu", down_dims=(8,), n_groups=4, num_inference_steps=3, diffusion_step_embed_dim=8
    )
    policy = make_policy(config, ds_meta=meta)
    folder = tmp_path_factory.mktemp("diffusion")
    policy.save_pretrained(folder)
    for processor in make_pre_post_processors(policy.config, dataset_stats=meta.stats):
        processor.save_pretrained(folder)
    return folder
