"""Classes of guidance from strangers: whatever they do, it is said in a line, and stays in a process of their own."""

import dataclasses
import os
import socket
import subprocess
import sys
from multiprocessing.connection import wait

import psutil
import pytest
import torch

from benchmark import enter
from benchmark.episodes.table import read_episodes
from benchmark.rollouts import guest
from benchmark.rollouts.guest import host
from benchmark.rollouts.guidance_class import GuidanceClass
from benchmark.settings.setting import SettingError
from benchmark.sweeps.enter_config import EnterConfig

pytestmark = pytest.mark.system

HEAD = """
import ctypes, json, os, socket, sys, time
import numpy as np
from policies.guidance import Guidance

class Theirs(Guidance):
    def __init__(self, field, scale, base, seed):
        self.begun = 0

    def reset(self, rows):
        self.begun += 1

    def correct(self, chunk, state):
"""
LEAVE = "(os.setsid(), os.fork() or time.sleep(600))"
SOCKETS = "(int(fd) for fd in os.listdir('/proc/self/fd') if 'socket' in os.path.realpath(f'/proc/self/fd/{fd}'))"
"""The one on which answers go."""
CHUNK, STATE = torch.ones(3, 4, 2), torch.zeros(3, 4)


def stranger(folder, *lines, seconds=60.0):
    (folder / "theirs.py").write_text(HEAD + "".join(f"        {line}\n" for line in lines))
    return GuidanceClass(folder / "theirs.py", "Theirs", seconds=seconds, gigabytes=1.0)


@pytest.fixture
def houses():
    """Gives the processes that were started for strangers since the test began; others are kept for further use."""

    def started():
        children = psutil.Process().children(recursive=True)
        return [each for each in children if each not in before and "guest_house" in " ".join(each.cmdline())]

    before = []
    host()  # Which is kept as well.
    before = started()
    return started


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (["sys.exit(3)"], "raised SystemExit: 3"),
        (["raise KeyboardInterrupt"], "raised KeyboardInterrupt"),
        (["raise ValueError('a\\nb\\x1b[31m')"], r"raised ValueError: a b\[31m"),
        (["os._exit(0)"], r"gave no answer: its process ended with 0\."),
        (["ctypes.string_at(0)"], r"gave no answer: its process ended by SIGSEGV\."),
        (["x = [np.ones(10**8) for _ in range(40)]"], "gave no answer: it took more than 1 GB of memory"),
        (
            ["while True: pass"],
            "gave no answer: it has 3 s for a batch of episodes. Give it more by limits",
        ),
        (
            ["while True:", f"    for fd in {SOCKETS}: os.write(fd, bytes([0, 0, 9, 9]))", "    time.sleep(0.2)"],
            "gave no answer: it has 3 s for a batch of episodes",
        ),
        (["for _ in range(7): os.fork()", "time.sleep(60)"], "gave no answer: it (started more|took more)"),
        ([f"os.fork() or {LEAVE}", "os._exit(1)"], "gave no answer: its process ended with 1"),
        (["for fd in range(3, 1000):", "    try: os.write(fd, bytes(64))", "    except OSError: pass"], "gave"),
    ],
    ids=["exit", "interrupt", "signs", "leave", "fault", "memory", "hang", "trickle", "bomb", "orphan", "garbage"],
)
def test_what_ends_a_class_is_said_in_a_line_and_leaves_no_process(tmp_path, houses, lines, message):
    of = stranger(tmp_path, *lines, seconds=3.0 if "while True" in lines[0] else 60.0)
    with pytest.raises(SettingError, match=rf"theirs.py: Theirs\.\w+ {message}"):
        of.make(1.0, None, (0.0, 0.0), 0).correct(CHUNK, STATE)
    if "raised" not in message:
        assert not houses()


ALONE = "import os; os.unshare(os.CLONE_NEWUSER | os.CLONE_NEWNET | os.CLONE_NEWPID)"


@pytest.mark.skipif(
    subprocess.run([sys.executable, "-c", ALONE], capture_output=True).returncode != 0,
    reason="this system lets no process be taken off the network, or from sight of others",
)
def test_it_has_no_network_and_reaches_no_process_of_ours(tmp_path, houses):
    guidance = stranger(tmp_path, "socket.create_connection(('192.0.2.1', 9), 2)").make(1.0, None, (0.0, 0.0), 0)
    (watching, _) = houses()
    with pytest.raises(SettingError, match="raised OSError: .*unreachable"):
        guidance.correct(CHUNK, STATE)
    lines = ["for pid in (1, os.getppid()): pid and os.kill(pid, 9)", f"os.kill({os.getpid()}, 0)"]
    with pytest.raises(SettingError, match="raised ProcessLookupError"):
        stranger(tmp_path, *lines).make(1.0, None, (0.0, 0.0), 0).correct(CHUNK, STATE)
    assert watching.is_running()


MOUNTS = "import ctypes, os; os.unshare(os.CLONE_NEWUSER | os.CLONE_NEWNS); "
MOUNTS += "exit(ctypes.CDLL(None).mount(None, b'/', None, ctypes.c_ulong(0x44000), None) != 0)"
"""What has to be allowed for a folder to be kept: mounts of one's own."""


@pytest.mark.skipif(
    subprocess.run([sys.executable, "-c", MOUNTS], capture_output=True).returncode != 0,
    reason="this system lets no folder be kept from a process",
)
def test_it_cannot_change_the_folder_of_its_rows(tmp_path):
    rows = tmp_path / "outputs" / "mine"
    rows.mkdir(parents=True)
    (rows / "part").write_text("true")
    ways = [
        "open(ROWS + '/forged', 'w')",
        "open(os.path.relpath(ROWS) + '/forged', 'w')",
        "open('/proc/self/root' + ROWS + '/forged', 'w')",
        "open(f'/proc/{OURS}/root{ROWS}/forged', 'w')",
        "os.rename(ROWS, ROWS + '-moved')",
        "os.rename(os.path.dirname(ROWS), os.path.dirname(ROWS) + '-moved')",
        "LIBC.umount2(ROWS.encode(), 2), open(ROWS + '/forged', 'w')",
        "LIBC.mount(None, ROWS.encode(), None, 4096 | 32, None), open(ROWS + '/forged', 'w')",
        "subprocess.run(['sh', '-c', 'umount ' + ROWS]), open(ROWS + '/forged', 'w')",
        "os.unshare(os.CLONE_NEWUSER | os.CLONE_NEWNS), LIBC.umount2(ROWS.encode(), 2), "
        "LIBC.mount(None, ROWS.encode(), None, 4096 | 32, None), open(ROWS + '/forged', 'w')",
    ]
    lines = [
        f"import subprocess; ROWS, OURS, LIBC, failed = {str(rows)!r}, {os.getpid()}, ctypes.CDLL(None), 0",
        f"for way in {ways!r}:",
        "    try: eval(way)",
        "    except OSError: failed += 1",
        "return chunk * failed",
    ]
    answer = dataclasses.replace(stranger(tmp_path, *lines), kept=rows).make(1.0, None, (0.0, 0.0), 0)
    assert (answer.correct(CHUNK, STATE) == len(ways)).all()
    assert [(each.name, each.read_text()) for each in rows.iterdir()] == [("part", "true")]
    (rows / "ours").write_text("We still can.")


def test_what_it_prints_is_shown_up_to_a_limit(tmp_path, capfd):
    of = stranger(
        tmp_path,
        r"print('\x1b]0;title\x07\x9bonce')",
        "while True: os.write(1 + self.begun % 2, bytes(65536))",
        seconds=3.0,
    )
    with pytest.raises(SettingError, match="gave no answer: it has 3 s"):
        of.make(1.0, None, (0.0, 0.0), 0).correct(CHUNK, STATE)
    printed = capfd.readouterr()
    assert printed.out == "" and "0;titleonce\n" in printed.err and len(printed.err) < 200_000


def test_what_it_changes_stays_with_it(tmp_path):
    """And its answers are taken as they are: of the right form, finite, our own copy."""
    lines = [
        "import benchmark.rollouts.rollout as r",
        "r.Rollout.play = r.load_policy = None",
        "return chunk.double() * 2",
    ]
    guidance = stranger(tmp_path, *lines).make(1.0, None, (0.0, 0.0), 0)
    answer = guidance.correct(CHUNK, STATE)
    assert answer.dtype == CHUNK.dtype and (answer == 2).all() and (CHUNK == 1).all()
    from benchmark.rollouts import rollout

    assert callable(rollout.Rollout.play)


def test_a_process_that_says_of_itself_what_cannot_be_is_not_believed(tmp_path):
    of = stranger(tmp_path, "return chunk")
    code = of.file.read_text().replace("    def reset", "    field_kind = 'magic'\n    def reset")
    for said, message in (("'magic'", "field_kind=magic"), ("'none'\n    default_scale = 'much'", "cannot be read")):
        of.file.write_text(code.replace("'magic'", said))
        with pytest.raises(SettingError, match=message):
            of.attributes()


def test_what_was_finished_before_is_kept(brief, tmp_path):
    stranger(tmp_path, "return chunk if self.begun < 2 else os._exit(5)")
    (tmp_path / "entry.yaml").write_text("name: late\nauthor: A\ndescription: B\nguidance: theirs.py:Theirs\nscale: 1")
    few = {"robots": ["xarm6"], "seeds": [42], "episodes": 2, "batch_size": 1, "workers": 1, "device": "cpu"}
    output = tmp_path.parent / "out"
    config = EnterConfig(entry=str(tmp_path), output_dir=str(output), **few)
    with pytest.raises(SettingError, match="its process ended with 5") as refused:
        enter.main(config)
    assert "\n" not in str(refused.value)
    assert read_episodes(output / "late").episode_seed.tolist() == [150_000]


def test_a_host_that_was_killed_is_replaced(tmp_path):
    guidance = stranger(tmp_path, "return chunk").make(0.1, None, (0.0, 0.0), 0)
    host().process.kill()
    host().process.wait()
    assert torch.equal(guidance.correct(CHUNK, STATE), CHUNK)  # What it forked goes on.
    other = stranger(tmp_path, "return 2 * chunk").make(0.1, None, (0.0, 0.0), 0)
    assert torch.equal(other.correct(CHUNK, STATE), 2 * CHUNK)


def test_a_process_whose_start_was_interrupted_is_not_taken_for_the_next_one(monkeypatch):
    host()

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(socket, "recv_fds", interrupted)
        guest.GuestProcess(60.0, 1.0, None)
    process = guest.GuestProcess(60.0, 1.0, None)
    process._process.kill()
    assert wait([process._channel], 10)  # It was that one, which is gone.


def test_of_a_class_that_fails_at_once_no_folder_is_left(brief, tmp_path):
    stranger(tmp_path, "raise ValueError('no')")
    (tmp_path / "entry.yaml").write_text("name: bad\nauthor: A\ndescription: B\nguidance: theirs.py:Theirs\nscale: 1")
    few = {"robots": ["xarm6"], "seeds": [42], "episodes": 1, "batch_size": 1, "workers": 1, "device": "cpu"}
    output = tmp_path.parent / "nothing"
    with pytest.raises(SettingError, match="raised ValueError: no"):
        enter.main(EnterConfig(entry=str(tmp_path), output_dir=str(output), **few))
    assert not output.exists()


def test_a_class_cannot_write_to_the_process_that_has_its_limits(tmp_path):
    lines = [
        "about = lambda p, file: open(f'/proc/{p}/{file}').read()",
        "houses = [p for p in os.listdir('/proc') if p.isdigit() and 'guest_house' in about(p, 'cmdline')]",
        "watchers = [p for p in houses if about(p, 'status').split('PPid:')[1].split()[0] not in houses]",
        "[open(f'/proc/{p}/mem', 'r+b', 0).close() for p in watchers]",
    ]
    with pytest.raises(SettingError, match="PermissionError"):
        stranger(tmp_path, *lines).make(0.1, None, (0.0, 0.0), 0).correct(CHUNK, STATE)
