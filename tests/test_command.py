"""The door of every command: overrides, Hydra's flags, and one line for what is wrong."""

import os
import signal
import subprocess
import sys
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from benchmark import replay, run
from benchmark.merge_maps import MergeMapsConfig
from benchmark.settings import command
from benchmark.settings.config import RunConfig, unfit
from benchmark.settings.replay_config import ReplayConfig
from envs.block_push.task import BLOCK_PUSH

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[1]
BAD = {
    "robot=ur7": "robot=ur7 is not allowed. Allowed: ",
    "robot.path=a.urdf": "robot.path=a.urdf goes with robot=custom. Here robot=ur3.",
    "lamda=1": "There is no setting 'lamda'. Did you mean 'lambda'? See all settings: python -m benchmark.run --help",
    "map.cel_size=1": "Did you mean 'map.cell_size'?",
    "lambda=-1": "Allowed: any number >= 0",
    "lambda=abc": "any number >= 0",
    "lambda=nan": "any number >= 0",
    "lambda=0,1": "lambda=0,1 has several values. To sweep over them, add -m.",
    "policy=a,b": "'policy=\"a,b\"'",
    "method=papr": "method=papr is not allowed. Allowed: direct, paper, away",
    "method=null": "method=null is not allowed",
    "episodes=0": "Allowed: a whole number >= 1",
    "episodes=2.5": "a whole number >= 1",
    "setting=virtual": "Allowed: original, embodied, best",
    "device=tpu": "Allowed: cpu, cuda, auto",
    "checkpoint=0": "Allowed: a whole number >= 1",
    "experiment=mine": "experiment=mine is not allowed. Allowed: methods, tables, transfer.",
    "robot": "not setting=value",
    "robot=null": "robot=null is not allowed: it is one of",
    "robot=[ur3,ur5]": "To sweep over several: -m robot=",
    "~robot": "~robot would take a setting away. Give it a value: robot=value.",
    "robot=[ur3": "robot=[ur3 is not allowed. Allowed: ",
    "robot=ür3": "robot=ür3 is not allowed. Allowed: ",
    "robot=3": "robot=3 is not allowed. Allowed: ",
    "--lambda": "There is no flag --lambda. A setting is written without dashes: lambda=value.",
    "--cfg=nothing": "--cfg nothing is not allowed. Allowed: job, hydra, all.",
}
TEXTS = [
    "/x/epoch=1/act", "/data/größe/act", "/data/[new]/act", "/data/{a}/act", "/a (1)/b", "4787e758", "901787704900",
    "0017e500", "true", "it's", "a b", "C:\\models\\act", "#1/act", "outputs/train/act",
]  # fmt: skip


@dataclass
class Outcome:
    """How a command ended."""

    status: int
    output: str
    errors: list[str]


@pytest.fixture
def give(monkeypatch, capsys):
    """Run a command in this process, or its settings alone."""

    def run_with(main, schema, name, *arguments, **about):
        with monkeypatch.context() as patch:
            patch.setattr(sys, "argv", ["command", *arguments])
            patch.setattr(command.signal, "signal", lambda *_: None)
            try:
                command.run_command(main, schema, name, **about)
                status = 0
            except SystemExit as end:
                status = end.code
        captured = capsys.readouterr()
        return Outcome(status, captured.out, captured.err.splitlines())

    return run_with


@pytest.mark.parametrize("argument", BAD)
def test_a_bad_setting_ends_in_one_line(give, argument):
    ended = give(run.main, RunConfig, "run", argument)
    assert ended.status == 2 and ended.output == ""
    assert len(ended.errors) == 1 and BAD[argument] in ended.errors[0], ended.errors


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("task=press_buttons", "method=reorder"), "method=reorder: reorder is for block_push alone."),
        (("task=press_buttons", "method=projection"), "upright at one height, block push's, unlike press_buttons."),
        (("method=way_through_map", "lambda=4"), "way_through_map is for press_buttons alone."),
    ],
)
def test_a_method_that_cannot_act_in_the_task_is_refused(give, arguments, message):
    ended = give(run.main, RunConfig, "run", *arguments)
    assert ended.status == 2 and len(ended.errors) == 1 and message in ended.errors[0], ended.errors


def test_a_method_that_imagines_cannot_act_in_a_task_without_a_model():
    assert unfit("plan_on_arm", BLOCK_PUSH) == ""
    without = unfit("plan_on_arm", replace(BLOCK_PUSH, model=None))
    assert without == "it imagines episodes, and block_push has no model to do that with"


def test_what_a_suite_would_ignore_is_refused(give):
    for idle in ("robot=ur3", "seed=43", "arm.yaw=0.1"):
        ended = give(run.main, RunConfig, "run", "suite=push-v1", idle)
        assert ended.status == 2
        assert ended.errors[0].startswith(f"error: {idle.partition('=')[0]} does nothing with a suite"), ended.errors


def test_nothing_heavy_is_imported_before():
    command = [sys.executable, "-X", "importtime", "-m", "benchmark.run", "seed=7"]
    own = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}  # With it MuJoCo is tried first.
    ended = subprocess.run(command, cwd=ROOT, env=own, capture_output=True, text=True)
    lines = ended.stderr.splitlines()
    errors = [line for line in lines if not line.startswith("import time:")]
    imported = {line.rsplit("|", 1)[1].strip() for line in lines if line.startswith("import time:")}
    assert ended.returncode == 2 and len(errors) == 1
    assert "recipe=robust seed=7 checkpoint=1 is not there. Here: seed42-1" in errors[0]
    assert not {"torch", "lerobot", "mujoco", "robosuite"} & imported


@pytest.mark.parametrize("goes_on", [True, False])
@pytest.mark.parametrize(
    "error, status",
    [
        (OSError(28, "No space left", "/x/a"), 1),
        (KeyboardInterrupt(), 130),
        (BrokenProcessPool(), 1),
    ],
)
def test_only_a_command_that_stores_says_that_what_was_finished_is_stored(give, error, status, goes_on):
    def fail(_):
        raise error

    ended = give(fail, ReplayConfig, "replay", goes_on=goes_on)
    assert ended.status == status and len(ended.errors) == 1
    assert ("What was finished is stored" in ended.errors[0]) == goes_on


SWALLOWS = """
import os, signal, sys, time
from benchmark.settings import command
from benchmark.settings.replay_config import ReplayConfig

def main(_):
    try:
        os.kill(os.getpid(), int(number))
    except BaseException:  # As trimesh does as it imports what it can do without.
        then()

def then():
    time.sleep(60)

number, command.AGAIN = sys.argv.pop(), 0.1
signal.signal(signal.SIGINT, signal.default_int_handler)  # Whatever runs the tests may have it ignored.
command.run_command(main, ReplayConfig, "replay")
"""


@pytest.mark.parametrize("number, status", [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
@pytest.mark.parametrize("then", ["time.sleep(60)", "raise RuntimeError('no compiled object yet')"])
def test_a_signal_that_a_library_swallows_ends_a_command_all_the_same(number, status, then):
    code = SWALLOWS.replace("time.sleep(60)", then)
    ended = subprocess.run([sys.executable, "-c", code, str(int(number))], cwd=ROOT, capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (status, "Interrupted.\n")


def test_a_signal_that_is_swallowed_for_good_leaves_nothing_that_comes_later():
    """The command ends as it would have, also where the interpreter takes a while to."""
    code = SWALLOWS.replace("time.sleep(60)", "import atexit; atexit.register(time.sleep, 0.5)")
    ended = subprocess.run([sys.executable, "-c", code, "15"], cwd=ROOT, capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_after_a_command_ends_the_interpreter_without_a_word(number):
    code = SWALLOWS.replace("os.kill(os.getpid(), int(number))", "pass") + "os.kill(os.getpid(), int(number))"
    ended = subprocess.run([sys.executable, "-c", code, str(int(number))], cwd=ROOT, capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (-number, "")


def test_what_a_shell_runs_in_the_background_is_not_interrupted():
    """A script's Ctrl-C reaches it, and is ignored as the shell says."""
    code = SWALLOWS.replace("then()\n\ndef", "raise\n\ndef").replace("default_int_handler", "SIG_IGN")
    ended = subprocess.run([sys.executable, "-c", code, "2"], cwd=ROOT, capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (0, "")


def test_a_cache_that_cannot_be_written_to_is_said_how_to_replace(give, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "/x")

    def fail(file):
        def main(_):
            raise PermissionError(13, "Permission denied", file)

        return give(main, ReplayConfig, "replay").errors

    assert "XDG_CACHE_HOME=/some/folder" in fail("/x/huggingface")[0]
    assert fail("/y") == ["error: Permission denied: /y."]


@pytest.mark.parametrize("text", TEXTS)
def test_a_text_is_taken_as_it_is(give, text):
    shown = []
    ended = give(shown.append, ReplayConfig, "replay", f"table={text}", f"policy={text}")
    assert ended.status == 0, ended.errors
    assert (shown[0].table, shown[0].policy) == (text, text)


def test_texts_in_lists_are_taken_as_they_are(give):
    shown = []
    for given in ("inputs=[a=1.safetensors,größe/2]", "inputs=['a=1.safetensors','größe/2']"):
        assert give(shown.append, MergeMapsConfig, "merge_maps", given).status == 0
        assert shown.pop().inputs == ["a=1.safetensors", "größe/2"]
    assert give(shown.append, MergeMapsConfig, "merge_maps", """inputs=["a,b/1", 'c=1,d', it's/2]""").status == 0
    assert shown.pop().inputs == ["a,b/1", "c=1,d", "it's/2"]


def test_a_number_is_a_number(give):
    shown = []
    assert give(shown.append, RunConfig, "run", "lambda=0.5", "map.theta=0.2", "wandb.group=7").status == 0
    assert (shown[0].guidance_scale, shown[0].map.theta, shown[0].wandb.group) == (0.5, 0.2, "7")


def test_help_lists_every_setting_with_unit_and_the_default_that_acts(give):
    ended = give(run.main, RunConfig, "run", "--help")
    assert ended.status == 0 and not ended.errors
    for shown in (
        "robot=ur3",
        "lambda=null",
        "seed=42",
        "setting=embodied",
        "device=auto",
        "in m",
        "1/m",
        "paper: The",
    ):
        assert shown in ended.output
    assert max(map(len, ended.output.splitlines())) < 80
    assert "episodes=7\n" in give(run.main, RunConfig, "run", "--help", "episodes=7").output


def test_help_is_of_the_files_that_are_given(give, tmp_path):
    (tmp_path / "mine.yaml").write_text("defaults: [run, _self_]\nepisodes: 7")
    (tmp_path / "suite").mkdir()
    (tmp_path / "suite" / "of_mine.yaml").write_text("# @package _global_\n# What is mine.\nepisodes: 8")
    asked = ["--help", "--config-dir", str(tmp_path)]
    text = give(run.main, RunConfig, "run", *asked).output
    assert "episodes=50\n" in text and "of_mine: What is mine." in text and "push-v1: " in text
    assert "episodes=7\n" in give(run.main, RunConfig, "run", *asked, "-cn", "mine").output
    assert "episodes=8\n" in give(run.main, RunConfig, "run", *asked, "suite=of_mine").output
    gone = give(run.main, RunConfig, "run", "--help", "--config-dir=gone")
    assert gone.status == 2 and gone.errors == ["error: --config-dir gone is no folder."]


def test_whoever_reads_the_first_lines_of_help_ends_it_quietly():
    line = f"{sys.executable} -m benchmark.replay --help | head -1; echo ${{PIPESTATUS[0]}}"
    ended = subprocess.run(["bash", "-c", line], cwd=ROOT, capture_output=True, text=True)
    assert ended.stdout.splitlines() == ["python -m benchmark.replay [setting=value ...]", "0"]
    assert ended.stderr == ""


def test_hydra_s_flags_work(give, tmp_path):
    assert "lambda: null" in give(run.main, RunConfig, "run", "--cfg", "job").output
    assert "output_dir: results/transfer/robust/ur3-original" in (
        give(run.main, RunConfig, "run", "--cfg", "job", "--resolve", "experiment=transfer").output
    )
    assert "robot/ur3" in give(run.main, RunConfig, "run", "--info", "defaults").output
    (tmp_path / "experiment").mkdir()
    (tmp_path / "experiment" / "mine.yaml").write_text("# @package _global_\nepisodes: 3\nrobot: ur5\n")
    (tmp_path / "other.yaml").write_text("defaults: [run, _self_]\nbatch_size: 4\n")
    shown = []
    assert give(shown.append, RunConfig, "run", "--config-dir", str(tmp_path), "experiment=mine").status == 0
    assert give(shown.append, RunConfig, "run", f"--config-dir={tmp_path}", "--config-name=other").status == 0
    assert (shown[0].episodes, shown[0].robot.name, shown[1].batch_size) == (3, "ur5", 4)


@pytest.mark.parametrize("said, name", [("guidance_scale: 0.25", "guidance_scale"), ("map: {cells: 1}", "map.cells")])
def test_a_file_gives_settings_by_the_names_that_are_typed(give, tmp_path, said, name):
    (tmp_path / "experiment").mkdir()
    (tmp_path / "experiment" / "mine.yaml").write_text(f"# @package _global_\n{said}\n")
    ended = give(run.main, RunConfig, "run", "--config-dir", str(tmp_path), "experiment=mine")
    assert ended.status == 2
    assert ended.errors == [f"error: There is no setting '{name}'. Take it out of the file or call that gives it."]


def test_a_shell_completes_settings_and_choices(give, monkeypatch):
    assert "complete -" in give(run.main, RunConfig, "run", "-sc", "install=bash").output
    typed = give(run.main, RunConfig, "run", "-sc", "query=bash")  # By hand, without a shell that asks.
    assert typed.status == 2 and "What you type is -sc install=bash" in typed.errors[0]
    for line, offered in (
        ("command lam", "lambda="),
        ("command robot=x", "robot=xarm6"),
        ("command map.th", "map.theta="),
    ):
        monkeypatch.setenv("COMP_LINE", line)
        assert offered in give(run.main, RunConfig, "run", "-sc", "query=bash").output.split()


def test_bash_completes_the_words_of_a_module():
    script = f"""
        PATH={Path(sys.executable).parent}:$PATH
        eval "$(python -m benchmark.replay -sc install=bash)"
        COMP_WORDS=(python -m benchmark.replay tab) COMP_CWORD=3 COMP_LINE="python -m benchmark.replay tab"
        $(complete -p python | sed 's/.*-F \\([^ ]*\\).*/\\1/')
        echo "${{COMPREPLY[@]}}"
    """
    ended = subprocess.run(["bash", "-c", script], cwd=ROOT, capture_output=True, text=True, env=os.environ)
    assert ended.stdout.split() == ["table="], ended.stderr


def test_every_command_says_its_own_name():
    for file in sorted(ROOT.glob("benchmark/**/*.py")):
        if "run_command(main" in (text := file.read_text()):
            module = ".".join(file.relative_to(ROOT).with_suffix("").parts)
            assert f"python -m {module}" in text, module
    assert replay.main.__module__ == "benchmark.replay"
