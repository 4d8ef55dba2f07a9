import dataclasses

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from benchmark import choose_scales, scales
from benchmark.rollouts import arm_oracle, missing_episodes
from benchmark.scoring.scale_table import scale_table
from benchmark.settings.chosen_scales import USUAL_FOLDER, chosen_scales, read_scales, scales_file
from benchmark.settings.config import RunConfig
from benchmark.settings.robot_config import RobotConfig
from benchmark.settings.setting import SettingError
from benchmark.settings.suite import suite_conditions
from benchmark.sweeps import scale_choice
from benchmark.sweeps.scale_sweep import ScalesConfig, read_methods
from envs.block_push.task import BLOCK_PUSH
from policies.method import MOST_SAMPLES
from policies.methods import GUIDED, METHODS
from tests.made_up_episodes import CONDITION, episode

pytestmark = pytest.mark.system


def rows(method, scale, placed, first=50_000, weights="abc"):
    """Episodes of which the first are placed as told."""
    condition = dataclasses.replace(CONDITION, method=method, guidance_scale=scale, checkpoint_hash=weights)
    return [episode(first + i, p2=bool(p2), condition=condition).row() for i, p2 in enumerate(placed)]


def test_scales_double_and_every_method_has_some():
    for method in GUIDED:
        values = METHODS[method].scales(9)
        np.testing.assert_array_equal(np.divide(values[1:], values[:-1]), 2)
        assert values[-1] == MOST_SAMPLES if METHODS[method].counts else len(values) == 9


def test_the_table_is_what_counting_by_hand_gives():
    episodes = pd.DataFrame(
        rows("direct", 0.0, [1, 0, 0, 1]) + rows("direct", 0.0, [0, 0, 0, 0], weights="other")
        + rows("paper", 0.5, [1, 1, 0, 0]) + rows("paper", 0.5, [1, 1, 0, 0], weights="other")
        + rows("paper", 1.0, [1, 1, 1, 1]) + rows("paper", 1.0, [0, 0, 0, 0], weights="other")
    )  # fmt: skip
    table = scale_table(episodes, BLOCK_PUSH).set_index(["method", "lambda"])
    paper = table.loc["paper", 0.5]
    assert (paper.n, paper.p2, paper.checkpoints) == (8, 0.5, 2)
    assert paper.p2_difference == pytest.approx(0.5 - 0.25)  # Not what pairing by the episode alone would give.
    assert paper.p2_difference_low < 0.25 < paper.p2_difference_high
    assert table.chosen.to_dict() == {("direct", 0.0): True, ("paper", 0.5): True, ("paper", 1.0): False}  # a tie
    text = scales.markdown(table.reset_index(), BLOCK_PUSH)
    assert "## ur3, embodied" in text and "| paper" in text and "+25.0" in text


def test_a_scale_that_was_not_rolled_out_whole_is_not_chosen():
    episodes = pd.DataFrame(
        rows("direct", 0.0, [1, 0, 0, 1]) + rows("paper", 0.5, [1, 1, 0, 0]) + rows("paper", 1.0, [1, 1])
        + rows("towards", 0.1, [1])
    )  # fmt: skip
    table = scale_table(episodes, BLOCK_PUSH)
    assert [*zip(table.method, table["lambda"], table.n, table.chosen, strict=True)] == [
        ("direct", 0.0, 4, True),
        ("paper", 0.5, 4, True),
        ("paper", 1.0, 2, False),
        ("towards", 0.1, 1, False),
    ]


def test_scales_of_two_fields_are_two():
    coarse = pd.DataFrame(rows("paper", 0.5, [1, 1]) + rows("paper", 1.0, [0, 1])).assign(cell_size=0.05)
    fine = pd.DataFrame(rows("paper", 0.5, [0, 0]) + rows("paper", 1.0, [0, 1])).assign(cell_size=0.02)
    of_both = [coarse.assign(field_fingerprint="a"), fine.assign(field_fingerprint="b")]
    table = scale_table(pd.concat([pd.DataFrame(rows("direct", 0.0, [1, 0])), *of_both], ignore_index=True), BLOCK_PUSH)
    chosen = table[table.chosen & (table.method == "paper")]
    assert [*zip(chosen.cell_size, chosen["lambda"], chosen.p2, strict=True)] == [(0.02, 1, 0.5), (0.05, 0.5, 1)]
    assert "paper, cells 0.02 m" in scales.markdown(table, BLOCK_PUSH)


@pytest.fixture
def simulated(monkeypatch):
    """Episodes without simulation: a push of 0.1 or more spoils them all. Notes which ones are run."""
    ran = []

    def play_all(jobs, workers):
        for job, seeds in jobs:
            push = job.condition.guidance_scale
            ran.extend((job.condition.method, push, seed) for seed in seeds)
            if seeds:
                yield [episode(seed, p2=push < 0.1, condition=job.condition) for seed in seeds]

    monkeypatch.setattr(missing_episodes, "play_all", play_all)
    monkeypatch.setattr(arm_oracle, "demonstrated_path", lambda *_: path)
    path = np.random.default_rng(0).uniform([0.2, -0.4, 0], [0.5, 0.2, 0], (300, 3))
    return ran


def settings(folder, **fields):
    methods = {"methods": ["away", "towards"], "seeds": [42], "episodes": 4, **fields}
    return ScalesConfig(robot=RobotConfig("ur3"), output_dir=str(folder), device="cpu", **methods)


def test_a_sweep_ends_where_the_policy_collapses_and_all_points_share_their_episodes(simulated, tmp_path, capsys):
    scales.main(settings(tmp_path))
    assert "19 points (direct transfer and 2 methods) x 1 checkpoints x 4 episodes = 76 episodes" in " ".join(
        capsys.readouterr().out.split()
    )
    table = read_methods(tmp_path / "robust" / "ur3-embodied", BLOCK_PUSH, range(50_000, 60_000))
    for method in ("away", "towards"):
        assert sorted(table[table.method == method]["lambda"].unique()) == [0.0125, 0.025, 0.05, 0.1]
    points = table.groupby(["method", "lambda"]).episode_seed.agg(sorted)
    assert all(seeds == [50_000, 50_001, 50_002, 50_003] for seeds in points)
    assert "| towards" in (tmp_path / "robust" / "ur3-embodied" / "scales.md").read_text()
    for name in ("success_against_scale", "fields"):
        image = np.asarray(Image.open(tmp_path / "robust" / "ur3-embodied" / "figures" / f"{name}.png").convert("L"))
        assert min(image.shape) > 200 and image.std() > 5  # no blank page


def test_scales_that_are_asked_for_are_all_tried(simulated, tmp_path, capsys):
    scales.main(settings(tmp_path, methods=["towards"], scale=[0.8, 0.05, 0.2]))
    table = read_methods(tmp_path / "robust" / "ur3-embodied", BLOCK_PUSH, range(50_000, 60_000))
    assert sorted(table[table.method == "towards"]["lambda"].unique()) == [0.05, 0.2, 0.8]
    said = capsys.readouterr().out
    assert "direct transfer and 1 method)" in " ".join(said.split())
    shown = [line.split()[:2] for line in said.splitlines() if line.startswith("towards")]
    assert shown == [["towards", "0.05"], ["towards", "0.2"], ["towards", "0.8"]] and "Chosen: towards, 0." in said
    said = (tmp_path / "robust" / "ur3-embodied" / "scales.md").read_text()
    assert "`towards`: λ is" in said and "`away`" not in said


def test_what_is_stored_is_not_run_again(simulated, tmp_path):
    scales.main(settings(tmp_path, methods=["towards"], points=2))
    before = list(simulated)
    simulated.clear()
    scales.main(settings(tmp_path, methods=["towards"], points=2, episodes=5))
    assert simulated == [(method, scale, 50_004) for method, scale in dict.fromkeys(run[:2] for run in before)]


def test_damaged_episodes_are_not_gone_on_with(simulated, tmp_path):
    config = settings(tmp_path, methods=["towards"], points=2)
    scales.main(config)
    part = next((config.folder / "towards" / "episodes").iterdir())
    part.write_bytes(part.read_bytes()[:-9])
    with pytest.raises(SettingError, match="towards/episodes/.* is damaged"):
        scales.main(settings(tmp_path, methods=["towards"], episodes=5))


def test_a_scale_is_chosen_over_all_conditions_within_the_budget(simulated, tmp_path, monkeypatch):
    few = {name: suite_conditions("push-v1")[name] for name in ("ur3-near-8cm", "ur10-out")}
    monkeypatch.setattr(scale_choice, "suite_conditions", lambda name: few)
    monkeypatch.setattr(scale_choice, "BUDGET", 40)
    given = {"methods": ["towards"], "seeds": [42], "scales_dir": str(tmp_path), "output_dir": str(tmp_path / "rows")}
    config = scale_choice.ChooseScalesConfig(**given)
    choose_scales.main(config)
    (run,) = config.runs("towards")
    assert run.episodes == 2 and {seed for _, _, seed in simulated} == {51_000, 51_001}
    assert len(simulated) <= 40 and {run[:2] for run in simulated} >= {("direct", 0.0), ("towards", 0.1)}
    chosen = read_scales(scales_file(str(tmp_path), BLOCK_PUSH.name))["towards"]
    assert chosen["scale"] == 0 and chosen["tried"][0.05] == 1 and chosen["tried"][0.1] == 0  # Nothing gains: off.
    before = len(simulated)
    choose_scales.main(scale_choice.ChooseScalesConfig(**given | {"methods": ["away"]}))
    assert not [run for run in simulated[before:] if run[0] == "direct"]  # Those of off are shared.
    assert {*read_scales(scales_file(str(tmp_path), BLOCK_PUSH.name))} == {"away", "towards"}


def test_scales_that_ship_are_found_from_any_folder_but_by_one_that_has_its_own(tmp_path, monkeypatch):
    ours = chosen_scales(USUAL_FOLDER, "block_push")
    monkeypatch.chdir(tmp_path)
    assert ours and chosen_scales(USUAL_FOLDER, "block_push") == ours
    assert chosen_scales("elsewhere", "block_push") == {}
    scale_choice.written(RunConfig(RobotConfig("ur3"), method="paper"), {"scale": 3.0})
    assert chosen_scales(USUAL_FOLDER, "block_push") == ours | {"paper": {"scale": 3.0}}
    own = scales_file(USUAL_FOLDER, "block_push")
    own.write_text("towards: {scale: 0.5}")
    assert chosen_scales(USUAL_FOLDER, "block_push") == {"towards": {"scale": 0.5}}


def test_scales_are_chosen_on_validation_episodes_only():
    with pytest.raises(SettingError, match="seed_start=100000 is not allowed. Allowed: from 50000"):
        ScalesConfig(robot=RobotConfig("ur3"), seed_start=100_000)
    with pytest.raises(SettingError, match="methods=direct is not allowed. Allowed: paper, away"):
        ScalesConfig(robot=RobotConfig("ur3"), methods=["direct"])
