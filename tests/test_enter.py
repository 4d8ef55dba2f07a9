"""Somebody else's entry: evaluated by one command, and the tables that are sent with one."""

import importlib.util
import json
import py_compile
import re
import shutil
import sys
from contextlib import nullcontext
from dataclasses import fields
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from rich.console import Console

from benchmark import enter
from benchmark.artifacts import known_policies
from benchmark.artifacts.known_policies import RESULTS, checkpoint_folder
from benchmark.episodes.arm import chosen_arm
from benchmark.episodes.checked_rows import read_checked
from benchmark.episodes.episode import Episode, as_frame
from benchmark.episodes.parts import parts_in, write_part
from benchmark.episodes.table import read_episodes, read_tables
from benchmark.rollouts import players, rollout
from benchmark.rollouts.entry import Entry
from benchmark.rollouts.guidance_class import GuidanceClass
from benchmark.scoring.ranking import counted, protocols_of
from benchmark.settings.setting import SettingError
from benchmark.sweeps import enter_config
from benchmark.sweeps.enter_config import EnterConfig
from envs.block_push.outcome import EpisodeOutcome
from envs.block_push.scene import draw_scene
from envs.block_push.task import BLOCK_PUSH

pytestmark = pytest.mark.system

PAPER, STRICT = protocols_of(BLOCK_PUSH)
ROOT = Path(__file__).parents[1]
SEEDS = [150_000, 150_001, 150_002]


def write_entry(folder, **values):
    """An entry with the class of the documents."""
    method, submit = ((ROOT / "docs" / f"{page}.md").read_text() for page in ("add-method", "submit"))
    (code,) = [code for code in re.findall(r"```python\n(.*?)```", method, re.DOTALL) if "class Slower" in code]
    (about,) = [text for text in re.findall(r"```yaml\n(.*?)```", submit, re.DOTALL) if "half-speed" in text]
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "guidance.py").write_text(code)
    for name, value in values.items():
        line = re.compile(rf"^{name}:.*$", re.MULTILINE)
        about = line.sub(f"{name}: {value}", about) if line.search(about) else f"{about}{name}: {value}\n"
    (folder / "entry.yaml").write_text(about)
    return folder


def settings(entry, output, **values):
    few = {"robots": ["xarm6"], "seeds": [42], "episodes": len(SEEDS), "batch_size": 3, "workers": 1, "device": "cpu"}
    return EnterConfig(entry=str(entry), output_dir=str(output), **few | values)


@pytest.fixture(scope="module")
def entry(tmp_path_factory):
    """One that changes nothing."""
    return write_entry(tmp_path_factory.mktemp("entry") / "mine", name="mine", scale=1.0, field="feasibility")


def test_what_could_change_unseen_is_no_part_of_an_entry(tmp_path):
    for name in (".g.py", "__pycache__/g.py", ".hidden/g.py"):
        folder = write_entry(tmp_path / name.replace("/", "_").strip("."), guidance=f"{name}:Slower")
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(folder / "guidance.py", folder / name)
        with pytest.raises(SettingError, match=f"{name} is hidden, or Python's own, and could change unseen. Rename"):
            enter.main(settings(folder, tmp_path / "out"))


def test_scales_are_tried_on_validation_scenes_and_keep_each_others_rows(brief, tmp_path, capsys):
    folder, output = write_entry(tmp_path / "slow"), tmp_path / "out"
    with pytest.raises(SettingError, match="none on test episodes; try scales with seed_start=50000"):
        settings(folder, output, scale=[0.9])
    few = {"seed_start": 50_000, "episodes": 1, "batch_size": 1}
    enter.main(settings(folder, output, scale=[0.9, 1.0], **few))
    enter.main(settings(folder, output, scale=[1.0], **few))
    assert sorted(read_episodes(output / "half-speed")["lambda"]) == [0.9, 1.0]
    assert "minus direct" in capsys.readouterr().out
    assert (output / "half-speed" / "curves.png").is_file()


def test_an_entry_does_not_hold_its_own_episodes(tmp_path):
    folder = write_entry(tmp_path / "mine", name="mine", scale=1.0)
    for output in (tmp_path, folder, folder / "rows"):
        with pytest.raises(SettingError, match="where they would become part of the entry"):
            enter.main(settings(folder, output))


@pytest.fixture(scope="module")
def entered(cut_short, entry, tmp_path_factory):
    output = tmp_path_factory.mktemp("entries")
    with cut_short(20):
        enter.main(settings(entry, output))
    return output


def test_an_entry_with_a_guidance_class_is_evaluated_and_its_rows_are_accepted(brief, entry, entered, capsys):
    table = read_checked(entered / "mine", BLOCK_PUSH)
    assert sorted(table.episode_seed) == SEEDS and (table.length == 20).all()
    assert {*table.method} == {"mine"} and {*table.checkpoint} == {"seed42-1"} and (table.cell_size == 0.02).all()
    assert {*table.entry_hash} == {Entry.load(entry).files_hash}
    assert (entered / "mine" / "entry.yaml").read_text() == (entry / "entry.yaml").read_text()
    for replays, some in ((1, 1), (None, 3)):
        enter.main(settings(entry, entered, table=str(entered / "mine"), replays=replays))
        shown = " ".join(capsys.readouterr().out.split())
        assert f"is accepted: 3 rows, of which {some} replay to the last bit." in shown


def test_the_papers_protocol_is_setting_original_with_three_policies_of_a_seed(brief, entry, tmp_path, monkeypatch):
    config = settings(entry, tmp_path, settings=["original"], episodes=1, batch_size=None)
    with pytest.raises(SettingError, match="of each seed only the best policy ships. .* benchmark.source_policies"):
        enter.main(config)
    for rank in (2, 3):  # As if they had been trained here.
        copy = shutil.copytree(checkpoint_folder(42), tmp_path / "trained" / f"seed42-{rank}")
        said = json.loads((copy / "config.json").read_text()) | {"n_action_steps": rank}
        (copy / "config.json").write_text(json.dumps(said))
    monkeypatch.setattr(known_policies, "CHECKPOINTS", [*known_policies.CHECKPOINTS, tmp_path / "trained"])
    enter.main(config)
    rows = read_checked(tmp_path / "mine", BLOCK_PUSH)
    assert {*rows.checkpoint} == {"seed42-1", "seed42-2", "seed42-3"} and {*rows.setting} == {"original"}
    assert len(counted(rows, PAPER, set())) == 3 and counted(rows, STRICT, set()).empty
    with pytest.raises(SettingError, match="Allowed: original or embodied, best"):
        settings(entry, tmp_path, settings=["original", "best"])  # Of two protocols.
    for name in ("episodes", "batch_size", "replays"):
        with pytest.raises(SettingError, match=f"{name}=0 is not allowed"):
            settings(entry, tmp_path, **{name: 0})  # Not what null is.


def sent(entered, folder, change):
    """A table as somebody might send it."""
    rows = change(read_episodes(entered / "mine").to_dict("records"))
    part = write_part(folder, as_frame(rows, EpisodeOutcome))
    return str(part.rename(folder / "sent.parquet"))


def edit(number, **values):
    return lambda rows: [row | values if i == number else row for i, row in enumerate(rows)]


@pytest.mark.parametrize(
    ("change", "reasons"),
    [
        (
            edit(1, episode_seed=50_001, slot=50_001 % 3, mode=draw_scene(50_001).mode),
            [
                r"row 0 \(xarm6, .*, mine 1.0, seed42-1, episode 50001\): its seed is none of the protocol's, 150000",
                r"xarm6, embodied, mine 1.0, seed42-1, episode 150001 is missing",
            ],
        ),
        (edit(2, episode_version=9), [r"episode 150002 is missing"]),
        (
            edit(0, setting="original", self_collision=False, joint_limits=False),
            [r"row 0 .*setting is original, not embodied"],
        ),
        (edit(0, entry_hash="0123"), [r"row 0 .*entry_hash is 0123, not "]),
        (lambda rows: rows[1:], [r"episode 150000 is missing"]),
    ],
)
def test_rows_that_are_not_the_protocols_are_refused_by_name(entry, entered, tmp_path, capsys, change, reasons):
    with pytest.raises(SystemExit, match="1"):
        enter.main(settings(entry, tmp_path, table=sent(entered, tmp_path, change)))
    shown = capsys.readouterr().out
    for reason in reasons:
        assert re.search(f"Refused: .*{reason}", shown), shown
    assert "is refused. Make its rows here: python -m benchmark.enter entry=" in shown


def test_two_rows_of_one_episode_that_say_different_things_are_refused(entry, entered, tmp_path):
    file = sent(entered, tmp_path, edit(1, episode_seed=150_000, slot=150_000 % 3, length=99))
    with pytest.raises(SettingError, match="of one episode .* and say different things"):
        enter.main(settings(entry, tmp_path, table=file))


def test_an_edited_number_is_refused(brief, entry, entered, tmp_path, capsys):
    with pytest.raises(SystemExit, match="1"):
        enter.main(settings(entry, tmp_path, table=sent(entered, tmp_path, edit(1, length=19))))
    assert re.search("Refused: .*episode 150001, replayed: length is 19, not 20", capsys.readouterr().out)


def test_a_damaged_table_is_refused(entry, entered, tmp_path):
    file = Path(sent(entered, tmp_path, lambda rows: rows))
    file.write_bytes(file.read_bytes()[:-5])
    with pytest.raises(SettingError, match="sent.parquet is no whole Parquet file"):
        enter.main(settings(entry, tmp_path, table=str(file)))


def test_which_rows_are_replayed_the_entry_does_not_decide(entry, entered, tmp_path, monkeypatch):
    """Its file is run before, and may seed NumPy as many do."""
    drawn = []

    def play_all(wanted, workers):
        drawn.extend(seed for _, seeds in wanted for seed in seeds)
        return []

    monkeypatch.setattr(players, "play_all", play_all)
    table = sent(entered, tmp_path, lambda rows: rows)
    for _ in range(16):
        np.random.seed(0)
        enter.main(settings(entry, tmp_path, table=table, replays=1))
    assert len(drawn) == 16 and len({*drawn}) > 1


def test_a_changed_entry_is_run_again_and_nothing_else(entry, entered, tmp_path, monkeypatch, capsys):
    table, ran = read_episodes(entered / "mine"), []
    names = [each.name for each in fields(EpisodeOutcome)]
    outcomes = {}
    for row in table.to_dict("records"):
        outcomes[row["episode_seed"]] = EpisodeOutcome(**{n: None if row[n] is pd.NA else row[n] for n in names})

    def play(rolled, seeds, watch=None):
        ran.extend(seeds)
        return [Episode(rolled.condition, seed, seed % 3, outcomes[seed]) for seed in seeds]

    monkeypatch.setattr(rollout.Rollout, "play", play)
    shutil.copytree(entered / "mine", tmp_path / "mine")
    enter.main(settings(entry, tmp_path))
    assert sorted(ran) == SEEDS  # Each alone, though stored: a call may have been killed before it looked.
    assert read_episodes(tmp_path / "mine").equals(table)
    ran.clear()
    other = shutil.copytree(entry, tmp_path / "other")
    (other / "guidance.py").write_text((other / "guidance.py").read_text() + "# Better.\n")
    enter.main(settings(other, tmp_path))
    assert ran[:3] == SEEDS == sorted(ran[3:])  # and once more, each alone
    dropped = "Rows of these episodes by other files of the method at this scale are dropped: 3."
    assert dropped in " ".join(capsys.readouterr().out.split())
    assert {*read_episodes(tmp_path / "mine").entry_hash} == {Entry.load(other).files_hash}
    about = (other / "entry.yaml").read_text()
    (other / "entry.yaml").write_text(about.replace("scale: 1.0", "scale: 2.0"))
    enter.main(settings(other, tmp_path, episodes=2))
    assert "dropped" not in capsys.readouterr().out
    kept = read_episodes(tmp_path / "mine")  # What has another scale stays.
    assert [*zip(kept["lambda"], kept.episode_seed, strict=True)] == [
        *((1.0, seed) for seed in SEEDS), *((2.0, seed) for seed in SEEDS[:2]),
    ]  # fmt: skip


def test_an_entry_that_is_random_by_itself_is_refused(brief, tmp_path):
    """An author may try as often as it takes; whoever replays a row may not."""
    entry = write_entry(tmp_path / "entry", name="dice", field="none")
    code = (entry / "guidance.py").read_text()
    (entry / "guidance.py").write_text("import torch\n" + code.replace("chunk\n", "chunk * torch.rand(1)\n"))
    with pytest.raises(SettingError, match="replayed: .*come out alike when it is run alone"):
        enter.main(settings(entry, tmp_path / "out", robots=["ur3"]))
    assert parts_in(tmp_path / "out" / "dice") == [] and len([*(tmp_path / "out" / "dice").glob("refused-*/*")]) == 1


@pytest.mark.parametrize(
    ("method", "message"),
    [
        ("def correct(self, chunk, effector): raise RuntimeError('no')", "correct raised RuntimeError: no"),
        ("def correct(self, chunk, effector): return None", "correct gave what is of type NoneType"),
        ("def correct(self, chunk, effector): return chunk.numpy()", "correct gave what is of type ndarray"),
        ("def correct(self, chunk, effector): return chunk[:1]", r"correct gave what is a tensor \(1, 4, 2\)"),
        ("def correct(self, chunk, effector): return chunk / 0", "correct gave .* finite numbers, also in rows"),
        ("def push(self, effector): return effector", r"push gave .* \(3, 4\). It gives .* \(3, 2\)"),
        ("samples = 2\n    def choose(self, chunks, effector): return chunks", "choose gave"),
        ("def choose(self, chunks, effector): return chunks[:, 0]", "choose would never be asked. .* samples = 4"),
        ("def noise(self, batch, noise, sample): return noise", "noise would never be asked: .* process of its own"),
        ("settles = True", "settles would never be asked"),
        ("repeats = 3", "repeats would never be asked"),
        ("def descent(self, actions, effector): return actions", "descent would never be asked. .* looks_ahead = True"),
        ("def imagine(self, environment, effector): return environment[0]", "imagine gave"),
        ("samples = 0", "samples is 0"),
    ],
)
def test_what_a_class_may_not_answer_is_said_by_name(tmp_path, method, message):
    file = tmp_path / "theirs.py"
    head = "from policies.guidance import Guidance\nclass Theirs(Guidance):\n    def __init__(self, *_): pass\n    "
    file.write_text(head + method + "\n")
    with pytest.raises(SettingError, match=f"theirs.py: Theirs.{message}"):
        guidance = GuidanceClass(file, "Theirs").make(1.0, None, (0.0, 0.0), 0)
        effector, chunk = torch.zeros(3, 4), torch.ones(3, 4, 2)
        guidance.imagine(torch.zeros(3, 2, 12), effector)
        guidance.push(effector)
        guidance.choose(chunk[:, None], effector)
        guidance.correct(chunk, effector)


def test_a_class_may_import_what_lies_beside_it_and_be_a_dataclass(tmp_path):
    (tmp_path / "how_far.py").write_text("HALF = 0.5\n")
    (tmp_path / "theirs.py").write_text(
        "from __future__ import annotations\n"
        "from dataclasses import dataclass\n"
        "from how_far import HALF\n"
        "from policies.guidance import Guidance\n"
        "@dataclass\n"
        "class Theirs(Guidance):\n"
        "    field: object\n"
        "    scale: float\n"
        "    base: tuple[float, float]\n"
        "    seed: int\n"
        "    def correct(self, chunk, effector): return chunk * HALF * self.scale\n"
    )
    guidance = GuidanceClass(tmp_path / "theirs.py", "Theirs").make(3.0, None, (0.0, 0.0), 0)
    assert (guidance.correct(torch.ones(3, 4, 2), torch.zeros(3, 4)) == 1.5).all()


@pytest.mark.parametrize("there", [False, True], ids=["new to Python", "on its path before"])
def test_what_runs_is_the_source_that_is_hashed_and_not_bytecode_beside_it(tmp_path, monkeypatch, there):
    """Python trusts unchecked bytecode whatever the source says."""
    (tmp_path / "parts").mkdir()
    lines = ["SHOWN = True", "import aside, parts", "from policies.guidance import Guidance", "class Ours(Guidance):"]
    sources = {
        "ours.py": "\n".join([*lines, "    def __init__(self, *_): pass"]),
        "aside.py": "SHOWN = True",
        "parts/__init__.py": "SHOWN = True",
    }
    for name, source in sources.items():
        (tmp_path / name).write_text(source.replace("True", "False"))
        py_compile.compile(tmp_path / name, invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH)
        (tmp_path / name).write_text(source)
    if there:
        monkeypatch.syspath_prepend(tmp_path)
        importlib.util.find_spec("aside")  # Now the folder's own finder is cached.
    for name in ("aside", "parts"):
        sys.modules.pop(name, None)
    GuidanceClass(tmp_path / "ours.py", "Ours").load(1.0, None, (0.0, 0.0), 0, 2)
    assert [sys.modules[name].SHOWN for name in ("guidance_ours", "aside", "parts")] == [True] * 3


def test_nobody_overwrites_somebody_elses_entry(entry, entered):
    other = write_entry(entry.parent / "other", name="mine", author="Somebody Else")
    with pytest.raises(SettingError, match="holds the entry mine of Jane Doe. Give yours another name"):
        enter.main(settings(other, entered))
    with pytest.raises(SettingError, match="each of them once"):
        settings(other, entered, seeds=[42, 42])


def test_a_policy_of_lerobots_is_an_entry(brief, untrained, tmp_path):
    entry = write_entry(tmp_path / "theirs", name="theirs", policy="weights", guidance="", scale=0.0)
    shutil.copytree(untrained, entry / "weights")
    enter.main(settings(entry, tmp_path / "out", robots=["ur3"], episodes=1))
    (row,) = read_checked(tmp_path / "out" / "theirs", BLOCK_PUSH).to_dict("records")
    assert (row["method"], row["checkpoint"], row["sampler"], row["length"]) == ("theirs", "weights", "DDPM", 20)


def test_a_policy_of_our_type_is_an_entry_and_is_left_as_it_is(brief, entry, entered, tmp_path):
    own = write_entry(tmp_path / "own", name="own", policy="weights", guidance="")
    shutil.copytree(checkpoint_folder(42), own / "weights")
    enter.main(settings(own, tmp_path / "out", episodes=1))
    (row,) = read_checked(tmp_path / "out" / "own", BLOCK_PUSH).to_dict("records")
    same = read_episodes(entered / "mine").iloc[0]  # Which changes nothing either.
    assert row["checkpoint_hash"] == same.checkpoint_hash and row["tracking_error_mean"] == same.tracking_error_mean


def test_a_policy_of_our_type_samples_as_it_was_saved_and_is_not_guided_twice(tmp_path):
    own = write_entry(tmp_path / "own", name="own", policy="weights", guidance="")
    shutil.copytree(checkpoint_folder(42), own / "weights")
    file = own / "weights" / "config.json"
    saved = json.loads(file.read_text()) | {"noise_scheduler_type": "DDPM", "num_inference_steps": 7}
    file.write_text(json.dumps(saved))
    config, (checkpoint,) = settings(own, tmp_path), Entry.load(own).checkpoints([], "block_push")
    ((run,),) = config.runs("own")
    arm = chosen_arm(run, BLOCK_PUSH)
    condition = Entry.load(own).rollout(run, BLOCK_PUSH, arm, checkpoint, Console(quiet=True)).condition
    assert (condition.sampler, condition.sampling_steps) == ("DDPM", 7)
    file.write_text(json.dumps(saved | {"guidance_scale": 0.5}))
    with pytest.raises(SettingError, match="policy=weights is saved with guidance of its own .guidance_scale=0.5"):
        Entry.load(own).checkpoints([], "block_push")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"name": "paper"},
            "entry.yaml: name=paper is not allowed. Allowed: a-z, 0-9, - and _, up to 40, and none of dir",
        ),
        ({"name": "aware_oracle"}, "entry.yaml: name=aware_oracle is not allowed"),
        ({"name": "Ümläut"}, "entry.yaml: name=Ümläut is not allowed"),
        ({"author": '""'}, "author= is not allowed. Allowed: one line of text"),
        ({"guidance": ""}, "policy= is not allowed. Allowed: a folder, unless there is guidance"),
        ({"guidance": "guidance.py"}, "guidance=guidance.py is not allowed. Allowed: a file and its class, as in"),
        ({"field": "magic"}, "field=magic is not allowed. Allowed: energy, witness, coverage,"),
        ({"scale": "much"}, "scale=much is not allowed. scale: Scale that the class is made with"),
        ({"lambda": 1}, "there is no lambda. It may say: name, author, description, policy, guidance, field, scale"),
        ({"description": "${nope}"}, "entry.yaml has .* write the value"),
        ({"author": "[a"}, "entry.yaml cannot be read: while parsing a flow sequence"),
        ({"guidance": "../guidance.py:Slower"}, "../guidance.py lies outside of the entry. Copy it there"),
        ({"guidance": "guidance.py:Faster"}, "has no class Faster that is a policies.guidance.Guidance"),
        ({"guidance": "broken.py:Broken"}, r"Broken\(field, scale, base, seed\) raised TypeError"),
        ({"policy": "weights"}, "policy=.*weights is no LeRobot checkpoint: it lacks config.json"),
    ],
)
def test_what_an_entry_cannot_be_is_said_in_a_line(tmp_path, values, message):
    entry = write_entry(tmp_path / "entry", **values)
    (entry / "broken.py").write_text("import policies.guidance\nclass Broken(policies.guidance.Guidance): pass\n")
    with pytest.raises(SettingError, match=message):
        enter.main(settings(entry, tmp_path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n", "has .names of other values"),
        ("[" * 5000, "cannot be read"),
        ("name: a\0b\n", "cannot be read"),
        ('name: a\ndescription: "\\x24{oc.env:HOME}"\n', r"has \$\{...\}. What it says stands in the file itself"),
        ("name: " + "a" * 20_000, "has more than 10,000 bytes"),
        (f"name: a\nscale: 0x{'F' * 3000}\n", "scale is not allowed: it is beyond 1.79769e.308"),
    ],
    ids=["bomb", "nested", "nul", "escaped", "long", "number"],
)
def test_a_strange_entry_file_is_refused_in_a_line(tmp_path, text, message):
    (tmp_path / "entry.yaml").write_text(text)
    with pytest.raises(SettingError, match=message) as refused:
        Entry.load(tmp_path)
    assert "\n" not in str(refused.value)


def test_guidance_needs_a_policy_that_can_be_guided_and_files_no_links(untrained, tmp_path):
    entry = write_entry(tmp_path / "entry", policy="weights")
    shutil.copytree(untrained, entry / "weights")
    with pytest.raises(SettingError, match="guidance needs a policy of type guided_push.*is of type diffusion"):
        enter.main(settings(entry, tmp_path))
    (entry / "link.py").symlink_to(ROOT / "README.md")
    with pytest.raises(SettingError, match="link.py is a link. An entry holds its files itself"):
        _ = Entry.load(entry).files_hash
    with pytest.raises(SettingError, match="is no entry: it lacks entry.yaml. See docs/submit.md"):
        enter.main(settings(tmp_path, tmp_path))


def test_the_hash_is_of_names_and_contents_and_of_nothing_that_python_leaves(tmp_path):
    entry = write_entry(tmp_path / "entry")
    first = Entry.load(entry).files_hash
    (entry / "__pycache__").mkdir()
    (entry / "__pycache__" / "guidance.pyc").write_bytes(b"0")
    assert Entry.load(entry).files_hash == first
    said = entry / "entry.yaml"
    said.write_text(f"# A line that says nothing.\n{said.read_text()}")
    assert Entry.load(entry).files_hash == Entry.load(entry).at(0.123).files_hash == first
    (entry / "guidance.py").rename(entry / "renamed.py")
    assert Entry.load(entry).files_hash != first


@pytest.fixture
def small_suite(monkeypatch):
    """The full suite with one scene."""
    monkeypatch.setattr(enter_config, "suite_scenes", lambda name: range(160_000, 160_001))
    monkeypatch.setattr(enter_config, "SUITE_EPISODES", 1)


def on_suite(entry, output, **values):
    few = {"suite": "full", "only": ["push-ur5", "buttons-gen3"], "seeds": [42], "batch_size": 1, "workers": 1}
    return EnterConfig(entry=str(entry), output_dir=str(output), **few | values)


def test_an_entry_is_tried_and_entered_on_a_suite_and_a_second_final_run_is_a_further_row(
    brief, small_suite, tmp_path, capsys
):
    folder, output = write_entry(tmp_path / "half-speed"), tmp_path / "out"
    enter.main(on_suite(folder, output))
    shown = capsys.readouterr().out
    assert "| push-ur5 " in shown and "| buttons-gen3 " in shown and "half-speed" in shown
    tried = read_tables(output / "half-speed")
    assert sorted({*tried.episode_seed}) == [50_000] and {*tried.task} == {"block_push", "press_buttons"}
    assert {*read_tables(output / "direct").method} == {"direct"}  # On the same scenes.

    enter.main(on_suite(folder, output, final=True))
    (folder / "guidance.py").write_text((folder / "guidance.py").read_text() + "# Another.\n")
    enter.main(on_suite(folder, output, final=True))
    finals = read_tables(output / "half-speed").query("episode_seed >= 160000")
    assert finals.groupby("method").size().to_dict() == {"half-speed": 2, "half-speed~2": 2}
    assert finals.groupby("method").entry_hash.nunique().tolist() == [1, 1] and finals.entry_hash.nunique() == 2
    for sent, accepted in (("half-speed~2", True), ("half-speed", False)):  # The files are those of the second run.
        for task in ("block_push", "press_buttons"):
            rows = read_tables(output / "half-speed", task)
            write_part(tmp_path / sent / task, rows[(rows.method == sent) & (rows.episode_seed >= 160_000)])
        config = on_suite(folder, output, final=True, table=str(tmp_path / sent))
        with nullcontext() if accepted else pytest.raises(SystemExit):
            enter.main(config)
    assert capsys.readouterr().out.count("is accepted: 1 rows") == 2


def test_a_final_run_that_is_refused_takes_no_earlier_one_with_it(brief, small_suite, tmp_path):
    folder, output = write_entry(tmp_path / "half-speed"), tmp_path / "out"
    enter.main(on_suite(folder, output, final=True, only=["push-ur5"]))
    first = read_episodes(output / "half-speed")
    code = (folder / "guidance.py").read_text()
    (folder / "guidance.py").write_text("import torch\n" + code.replace("chunk\n", "chunk * torch.rand(1)\n"))
    with pytest.raises(SettingError, match="come out alike when it is run alone"):
        enter.main(on_suite(folder, output, final=True, only=["push-ur5"]))
    pd.testing.assert_frame_equal(read_episodes(output / "half-speed"), first)
    (refused,) = (output / "half-speed").glob("refused-*")
    assert refused.is_dir()


@pytest.mark.parametrize("change", [{"method": None}, {"method": "half-speed~x"}, {"entry_hash": None}])
def test_a_sent_table_that_is_none_of_a_final_run_is_refused_in_words(brief, small_suite, tmp_path, capsys, change):
    folder, ((column, value),) = write_entry(tmp_path / "half-speed"), change.items()
    rows = read_episodes(RESULTS / "suites" / "full" / "block_push").head(3)
    rows = rows.drop(columns=column) if value is None else rows.assign(**change)
    (tmp_path / "sent").mkdir()
    rows.to_parquet(tmp_path / "sent" / "rows.parquet")
    with pytest.raises(SystemExit, match="1"):
        enter.main(on_suite(folder, tmp_path / "out", final=True, table=str(tmp_path / "sent")))
    assert "Refused: ur5, embodied, half-speed" in capsys.readouterr().out


@pytest.mark.parametrize(
    "values, said",
    [
        ({"only": [], "final": True, "suite": ""}, "final=True is not allowed. Allowed: false without suite="),
        ({"suite": ""}, "only=['push-ur5', 'buttons-gen3'] is not allowed. Allowed: empty without suite="),
        ({"only": ["push-ur9"]}, "only=['push-ur9'] is not allowed. Allowed: some of push-ur3-near-10cm, "),
        ({"only": ["push-ur5"] * 2}, "Allowed: each of them once"),
        (
            {"only": [], "suite": "quick", "final": True},
            "Allowed: with final=true, one that has test scenes, such as full",
        ),
        ({"final": True, "episodes": 3}, "Allowed: false with scenes of your own"),
        ({"seed_start": 150_000}, "Allowed: validation scenes, 50000 to 59999, without final=true"),
        ({"seed_start": 0}, "seed_start=0 is not allowed. Allowed: validation scenes"),
        ({"seed_start": 59_990}, "seed_start=59990 is not allowed. Allowed: validation scenes"),
        ({"episodes": 0}, "episodes=0 is not allowed"),
        ({"only": [], "suite": "nonsense"}, "suite=nonsense is not allowed"),
    ],
)
def test_a_suite_says_which_scenes_are_taken(values, said, tmp_path):
    with pytest.raises(SettingError, match=re.escape(said)):
        on_suite(tmp_path, tmp_path, **values)


def test_a_policy_of_its_own_is_for_one_task(tmp_path):
    folder = write_entry(tmp_path / "mine", policy="checkpoint")
    with pytest.raises(SettingError, match="which is for one task, and suite=full has block_push and press_buttons"):
        enter.main(on_suite(folder, tmp_path / "out"))
