"""Two policies compared: files of `lerobot-eval`, what is refused of them, and our rows as such a file."""

import json
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from benchmark import compare_policies, show
from benchmark.artifacts import known_policies
from benchmark.artifacts.checkpoint import Checkpoint
from benchmark.compare_policies import ComparePoliciesConfig, blocks
from benchmark.episodes.table import store_episodes
from benchmark.scoring.eval_info import episodes_for, eval_info, read_eval_info, write_eval_infos
from benchmark.scoring.statistics import paired_difference, paired_p_value
from benchmark.scoring.two_policies import comparison_text, paired_episodes
from benchmark.settings import command
from benchmark.settings.overrides import named
from benchmark.settings.setting import SettingError
from envs.block_push.task import BLOCK_PUSH
from tests.made_up_episodes import CONDITION, episode

ACT = "1101100111"
BETTER = "1111011111"


def lerobots(*tasks, **more):
    """What lerobot-eval writes, but for its means and videos: tasks with a digit for each episode."""
    per_task = [
        {
            "task_group": group,
            "task_id": number,
            "metrics": {
                "sum_rewards": [float(digit) for digit in digits],
                "max_rewards": [float(digit) for digit in digits],
                "successes": [digit == "1" for digit in digits],
                "video_paths": ["eval_episode_0.mp4"],
                "predicted_video_paths": [],
            },
        }
        | more
        for group, number, digits in tasks
    ]
    return {"per_task": per_task, "per_group": {}, "overall": {"avg_max_reward": float("nan")}}


@pytest.fixture
def write(tmp_path):
    def write(name, content):
        file = tmp_path / name / "eval_info.json"
        file.parent.mkdir()
        file.write_text(content if isinstance(content, str) else json.dumps(content))
        return file

    return write


def test_two_files_of_lerobot_are_compared(write, capsys):
    a, b = (write(name, lerobots(("pusht", 0, digits))) for name, digits in (("a", BETTER), ("b", ACT)))
    compare_policies.main(ComparePoliciesConfig(a=str(a), b=str(b.parent)))
    shown = capsys.readouterr().out
    ones, others = (np.array([*map(float, digits)]) for digits in (BETTER, ACT))
    difference, low, high = (100 * each for each in paired_difference(ones, others))
    assert "says no seeds" in shown and "10 pairs" in shown and "a: 90.0 [" in shown and "b: 70.0 [" in shown
    assert f"in points: {difference:+.1f} [{low:+.1f}, {high:+.1f}]." in shown
    assert f"4 pairs differ: a won 3, b 1. Exact sign test: p = {paired_p_value(ones, others):.2g}." in shown


def test_tasks_of_one_run_are_told_apart(write):
    a = read_eval_info(write("a", lerobots(("libero", 0, "11"), ("libero", 1, "10"))))
    b = read_eval_info(write("b", lerobots(("libero", 1, "00"), ("libero", 0, "01"))))
    pairs = paired_episodes(a, b)
    assert pairs.task_id.tolist() == [0, 0, 1, 1]
    assert pairs.a.tolist() == [True, True, True, False] and pairs.b.tolist() == [False, True, False, False]
    assert "libero 1: a 50.0, b 0.0, n 2" in comparison_text(pairs, ("one", "other"))


def test_the_order_of_pairs_and_who_comes_first_change_nothing_but_signs():
    pairs = pd.DataFrame({"group": "", "task_id": 0, "seed": range(10)})
    pairs = pairs.assign(a=[d == "1" for d in BETTER], b=[d == "1" for d in ACT])
    shuffled = pairs.sample(frac=1, random_state=0)
    assert comparison_text(shuffled, ("x", "y")) == comparison_text(pairs, ("x", "y"))
    turned = comparison_text(pairs.rename(columns={"a": "b", "b": "a"}), ("x", "y"))
    assert "-20.0 [" in turned and "a won 1, b 3" in turned


def test_what_stopping_early_says_of_files(write, capsys):
    files = [write(name, lerobots(("pusht", 0, digit * 12))) for name, digit in (("a", "1"), ("b", "0"))]
    given = dict(zip("ab", map(str, files), strict=True))
    compare_policies.main(ComparePoliciesConfig(**given, stop_early=True))
    shown = capsys.readouterr().out
    assert "at its greatest: e = 315 (20 is clear): clear after 8 pairs." in shown and "sign test" not in shown
    compare_policies.main(ComparePoliciesConfig(**given, stop_early=True, alpha=0.0001))
    assert "(10000 is clear): not clear yet." in capsys.readouterr().out


def test_the_form_of_older_lerobot_is_read(write):
    old = {"per_episode": [{"episode_ix": i, "sum_reward": 1.5, "success": i == 1, "seed": 7 + i} for i in range(3)]}
    table = read_eval_info(write("old", old))
    assert table.success.tolist() == [False, True, False] and table.seed.tolist() == [7, 8, 9]
    assert table.attrs["seeded"]


@pytest.mark.parametrize(
    "content, said",
    [
        ("{", "cannot be read: Expecting"),
        ("[]", "it holds a list, not an object"),
        ("{}", "it has no list per_task"),
        ({"per_task": []}, "it holds no episodes"),
        ({"per_task": [3]}, "a task in per_task has no metrics"),
        ({"per_task": [{"metrics": {"successes": [True]}}]}, "no lists successes and sum_rewards of one length"),
        (lerobots(("pusht", 0, "11"), seeds=[1]), "pusht 0 has no list of as many seeds"),
        (lerobots(("pusht", 0, "11"), seeds=[1, "2"]), "a seed is '2', not a whole number"),
        (lerobots(("pusht", 0, "11"), task_id="0"), "task_id='0'"),
        ({"per_episode": [{"success": "yes", "sum_reward": 0}]}, "a success is 'yes', not true or false"),
        ({"per_episode": [{"success": True}]}, "a sum of rewards is None, not a finite number"),
        ('{"per_episode": [{"success": true, "sum_reward": NaN}]}', "a sum of rewards is nan, not a finite number"),
        ({"per_episode": [{"success": True, "sum_reward": 10**400}]}, "a sum of rewards is 1000"),
        (lerobots(("pusht", 0, "1"), seeds=[1 << 63]), "a seed is 9223372036854775808, not a whole number"),
        (lerobots(("pusht", 0, "110"), seeds=[7, 8, 7]), "it holds seed 7 twice, which cannot be paired"),
        ('{"per_task": ' + "[" * 100_000, "cannot be read"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line(write, content, said):
    file = write("a", content)
    with pytest.raises(SettingError, match="Give an eval_info.json as lerobot-eval writes it") as refused:
        read_eval_info(file)
    assert said in str(refused.value) and str(file) in str(refused.value)


@pytest.mark.parametrize(
    "one, other, said",
    [
        (lerobots(("pusht", 0, "11")), lerobots(("aloha", 0, "11")), "a is of pusht 0, and b of aloha 0. Run lerobot"),
        (lerobots(("pusht", 0, "11")), lerobots(("pusht", 0, "111")), "a has 2 episodes, and b 3. Run both with the"),
        (
            lerobots(("pusht", 0, "11"), seeds=[5, 6]), lerobots(("pusht", 0, "11"), seeds=[6, 7]),
            "a has seeds 5 to 6, and b 6 to 7: not the same scenes. Run both with the same --seed",
        ),
        (lerobots(("p", 0, "1"), env="ur3"), lerobots(("p", 0, "1"), env="ur5"), "a is of ur3, and b of ur5. Evaluate"),
    ],
)  # fmt: skip
def test_files_of_other_scenes_are_refused(write, one, other, said):
    with pytest.raises(SettingError) as refused:
        paired_episodes(read_eval_info(write("a", one)), read_eval_info(write("b", other)))
    assert said in str(refused.value)


def rows(method="direct", first=50_000, digits="1011"):
    condition = replace(CONDITION, method=method, guidance_scale=0.0 if method == "direct" else 0.5)
    return [episode(first + i, p2=digit == "1", condition=condition) for i, digit in enumerate(digits)]


def test_rows_written_as_lerobot_does_come_back(tmp_path):
    table = pd.DataFrame([each.row() for each in [*rows()[::-1], *rows("paper", digits="1111")]])
    files = write_eval_infos(table, BLOCK_PUSH, tmp_path)
    assert [file.parent.name for file in files] == ["seed42-1-direct", "seed42-1-paper-0.5"]
    back = read_eval_info(files[0])
    pd.testing.assert_frame_equal(back, episodes_for(table[table.method == "direct"], BLOCK_PUSH), check_dtype=False)
    info = json.loads(files[0].read_text())
    assert info["overall"]["pc_success"] == 75 and info["overall"]["n_episodes"] == 4
    assert info["per_group"]["guided_push"]["avg_sum_reward"] == pytest.approx((3 + 0.49) / 4)
    assert json.dumps(eval_info(back)) == json.dumps(info)
    both = paired_episodes(read_eval_info(files[1]), back)
    assert (both.a.sum(), both.b.sum(), both.seed.tolist()) == (4, 3, [50_000, 50_001, 50_002, 50_003])


def test_our_rows_pair_with_what_lerobot_wrote_of_the_same_scenes(write):
    theirs = read_eval_info(write("theirs", lerobots(("guided_push", 0, "1111"))))
    ours = episodes_for(pd.DataFrame([each.row() for each in rows()]), BLOCK_PUSH)
    for pairs in (paired_episodes(theirs, ours), paired_episodes(ours, theirs)):
        assert pairs.seed.tolist() == [50_000, 50_001, 50_002, 50_003]


def test_it_has_all_that_lerobots_own_file_has():
    """The keys of its task metrics and means."""
    import inspect

    from lerobot.scripts.lerobot_eval import TaskMetrics, eval_policy_all

    info = eval_info(episodes_for(pd.DataFrame([each.row() for each in rows()]), BLOCK_PUSH))
    assert {*info["per_task"][0]["metrics"]} == {*TaskMetrics.__annotations__}
    source = inspect.getsource(eval_policy_all)
    for key in (*info, *info["overall"], *info["per_group"]["guided_push"], "task_group", "task_id"):
        assert f'"{key}"' in source


def test_stored_rows_are_written_by_show_and_compared(tmp_path, capsys):
    store_episodes(tmp_path, [*rows(), *rows("paper", digits="1111")])
    show.main(show.ShowConfig(table=str(tmp_path), eval_info=str(tmp_path / "lerobot")))
    files = capsys.readouterr().out.split()
    compare_policies.main(ComparePoliciesConfig(a=files[1], b=files[0]))
    shown = capsys.readouterr().out
    assert "4 pairs" in shown and "a won 1, b 0" in shown and "no seeds" not in shown


def test_the_two_are_given_by_their_place_or_by_name(write, tmp_path, monkeypatch, capsys):
    known = {"a", "b", "episodes"}
    assert named(["x", "episodes=3", "y"], ("a", "b"), known) == ["a=x", "episodes=3", "b=y"]
    assert named(["x", "x", "z"], ("a", "b"), known) == ["a=x", "b=x", "z"]
    (act := tmp_path / "epoch=3" / "act").mkdir(parents=True)
    assert named([str(act), "b=y/z"], ("a", "b"), known) == [f"a={act}", "b=y/z"]
    assert named(["epoch=4/act"], ("a", "b"), known) == ["epoch=4/act"]
    assert named(["~x", "x"], (), known) == ["~x", "x"]
    a, b = (write(name, lerobots(("pusht", 0, digits))) for name, digits in (("a", BETTER), ("b", ACT)))
    monkeypatch.setattr(command.signal, "signal", lambda *_: None)
    for arguments, status, said in (
        ([str(a), str(b)], 0, "10 pairs"),
        ([str(a), str(b), "output_dir=/dev/null/x"], 0, "10 pairs"),
        ([str(a), f"b={b}", "stop_early=true"], 0, "Evidence"),
        ([str(a), str(b), "third"], 2, "'third' is not setting=value"),
        ([str(a), str(b), f"a={b}"], 2, "a is given twice"),
        ([str(a)], 2, "b= is not allowed. Allowed: an eval_info.json, or a LeRobot checkpoint"),
        ([str(a), "seed42-1"], 2, "are a file and a checkpoint. Give two"),
        ([str(a), str(b), "alpha=0.9"], 2, "alpha=0.9 is not allowed. Allowed: a number from 0.0001 to 0.5"),
    ):
        monkeypatch.setattr(sys, "argv", ["command", *arguments])
        try:
            command.run_command(compare_policies.main, ComparePoliciesConfig, "compare_policies", positional=("a", "b"))
            ended = 0
        except SystemExit as end:
            ended = end.code
        printed = capsys.readouterr()
        assert ended == status and said in printed.out + printed.err, printed


def test_scenes_come_in_whole_batches_until_it_is_clear():
    config = ComparePoliciesConfig(episodes=25, seed_start=50_003, stop_early=True, batch_size=10, workers=1)
    assert blocks(config) == [range(50_003, 50_010), range(50_010, 50_020), range(50_020, 50_028)]
    assert blocks(replace(config, stop_early=False)) == [range(50_003, 50_028)]
    assert blocks(replace(config, workers=4)) == [range(50_003, 50_020), range(50_020, 50_028)]


@pytest.mark.parametrize("stop_early, played", [(True, 20), (False, 50)])
def test_rolling_out_ends_when_it_is_clear(stop_early, played, tmp_path, monkeypatch, capsys):
    """One policy places everything from the fourth scene on, the other nothing."""
    from types import SimpleNamespace

    from benchmark.rollouts import make_rollout, missing_episodes

    asked = []

    def play(players, run, console, name):
        asked.extend(range(run.seed_start, run.seed_start + run.episodes))
        seeds = range(run.seed_start, run.seed_start + run.episodes)
        return [pd.DataFrame([episode(s, p2=player.better and s >= 50_003).row() for s in seeds]) for player in players]

    monkeypatch.setattr(known_policies, "policy_folder", lambda name, task: tmp_path / name)
    monkeypatch.setattr(
        make_rollout, "make_rollout",
        lambda run, scale, folder, console: SimpleNamespace(task=BLOCK_PUSH, better=folder.name == "good"),
    )  # fmt: skip
    monkeypatch.setattr(missing_episodes, "play_and_store", play)
    compare_policies.main(ComparePoliciesConfig(a="good", b="bad", stop_early=stop_early, workers=1, batch_size=10))
    assert len(asked) == played
    shown = capsys.readouterr().out
    assert ("clear after 11 pairs" in shown) == stop_early and f"{played} pairs" in shown


def test_a_policy_of_the_hub_is_fetched_by_its_name(tmp_path, monkeypatch):
    import huggingface_hub

    monkeypatch.chdir(tmp_path)

    def offline(name, allow_patterns):
        raise OSError(f"no network for {name}")

    monkeypatch.setattr(huggingface_hub, "snapshot_download", offline)
    with pytest.raises(SettingError, match="policy=you/act is no folder here, and was not had from the Hub: OSError"):
        known_policies.policy_folder("you/act")
    with pytest.raises(SettingError, match="policy=act is no folder of a checkpoint, "):
        known_policies.policy_folder("act")
    assert known_policies.policy_folder("seed42-1").name == "seed42-1"
    copy = tmp_path / "models--you--act" / "snapshots" / "0a1b"
    copy.mkdir(parents=True)
    assert Checkpoint(copy).name == "you/act"
