"""What runs in the processes of strangers' classes (`guest`): a host that is prepared and forks the others; for each
class one process that watches, and one in which the class is asked.

Where the system allows it, the class is off the network, sees and signals no process but those that it started, and
cannot change the folder of its rows.
"""

import codecs
import contextlib
import ctypes
import json
import os
import resource
import select
import signal
import socket
import sys
import time
import traceback
from pathlib import Path
from typing import Any, NoReturn

TICK, LOOK_AROUND = 0.05, 1.0
"""How often the memory of the class's process is looked at, and that of those that it started, in [s]."""
MOST_PROCESSES = 64
"""That a class may start."""
MOST_PRINTED = 100_000
"""Of what a class prints, in bytes: what comes after that is thrown away."""
PR_SET_PDEATHSIG, PR_SET_DUMPABLE, PR_SET_CHILD_SUBREAPER, PR_SET_NO_NEW_PRIVS = 1, 4, 36, 38  # Of linux/prctl.h.
MS_RDONLY, MS_REMOUNT, MS_BIND, MS_REC, MS_PRIVATE = 1, 32, 4096, 16384, 1 << 18  # Of linux/mount.h.
MS_OF_STATVFS = {2: 2, 4: 4, 8: 8, 1024: 1024, 2048: 2048, 4096: 1 << 21}
"""Flags of a mount as `statvfs` gives them, and as `mount` takes them, which may not drop any."""
CAPABILITIES_3 = 0x20080522  # Of linux/capability.h.


def main(channel: str) -> None:
    """Import once what takes seconds, then fork a process for each class that is asked for over this file descriptor,
    until it is closed at its other end. The process answers with a file descriptor of itself."""
    import policies.guidance  # noqa: F401

    ctypes.CDLL(None).prctl(PR_SET_DUMPABLE, 0)  # No class writes to this process.
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # Nobody here waits for what ended.
    asked = socket.socket(fileno=int(channel))
    with contextlib.suppress(ConnectionError):  # Nobody asks any more.
        while True:
            said, ends, *_ = socket.recv_fds(asked, 1, 5)
            if not said:
                return
            if os.fork() == 0:
                _begin(asked, ends)
            for each in ends:
                os.close(each)


def _begin(asked: socket.socket, ends: list[int]) -> NoReturn:
    """In a process that was forked for a class: become what a process started by the command itself would be, and
    watch. The first of the file descriptors is of a file that says what is asked for."""
    try:
        handle = os.pidfd_open(os.getpid())
        socket.send_fds(asked, [b"."], [handle])
        os.close(handle)
        asked.close()
        request, standard_input, error, channel, status = ends
        with open(request) as file:
            file.seek(0)
            said = json.load(file)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        ctypes.CDLL(None).prctl(PR_SET_DUMPABLE, 1)
        os.setsid()  # Ctrl-C is for the command.
        for number, end in enumerate((standard_input, error, error)):
            os.dup2(end, number)
        os.close(standard_input)
        os.close(error)
        os.environ.clear()
        os.environ.update(said["environment"])
        sys.path[:] = said["path"]
        os.chdir(said["folder"])
        watch(channel, status, said["gigabytes"], said["kept"])
    except BaseException:
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


def watch(channel: int, status: int, gigabytes: float, kept: str) -> None:
    """Start the class's process, and watch over it until it ends or standard input does, as it does with the parent.

    Args:
        channel: File descriptor over which the class is asked.
        status: File descriptor to which it is written how its process ended.
        gigabytes: Resident memory that it may have, with all that it starts.
        kept: Folder that it may not change; empty for none.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    has = _leave(kept)
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1)
    ctypes.CDLL(None).prctl(PR_SET_DUMPABLE, 0)  # The class cannot write to this process, which has its limits.
    heard, printed = os.pipe()
    guest = os.fork()
    if guest == 0:
        ctypes.CDLL(None).prctl(PR_SET_DUMPABLE, 1)
        for number in (1, 2):
            os.dup2(printed, number)
        for end in (status, heard, printed):
            os.close(end)
        _serve(channel, has)
    for end in (channel, printed):
        os.close(end)
    reason = _watch(guest, gigabytes, heard)
    _end_all()
    with contextlib.suppress(OSError):  # Nobody reads it any more.
        said = reason.encode()
        os.write(status, len(said).to_bytes(4, "big") + said)  # As `multiprocessing.connection` reads it.


def _leave(kept: str) -> list[str]:
    """Take from the process that comes next the network, other processes, and the folder; gives what the system does
    not let be taken."""
    user, group = os.getuid(), os.getgid()
    for kinds in (
        os.CLONE_NEWNET | os.CLONE_NEWPID | os.CLONE_NEWNS,
        os.CLONE_NEWNET | os.CLONE_NEWPID,
        os.CLONE_NEWNET,
    ):
        try:
            os.unshare(os.CLONE_NEWUSER | kinds)
        except OSError:
            continue
        for name, line in (("setgroups", "deny"), ("uid_map", f"{user} {user} 1"), ("gid_map", f"{group} {group} 1")):
            with contextlib.suppress(OSError), open(f"/proc/self/{name}", "w") as file:
                file.write(line)
        has = [] if kinds & os.CLONE_NEWPID else ["other processes"]
        if kept and not (kinds & os.CLONE_NEWNS and _keep(Path(kept).resolve())):
            has.append("the folder of its rows")
        return has
    return ["the network", "other processes", *(["the folder of its rows"] if kept else [])]


def _keep(folder: Path) -> bool:
    """Whether the system lets nobody in this name space of mounts change the folder, move it, or undo this."""
    flags = os.statvfs(folder).f_flag
    there = sum(taken for given, taken in MS_OF_STATVFS.items() if flags & given)
    way = [*reversed(folder.parents), folder][1:]  # What something is mounted on cannot be moved.
    mounted = (
        _mount(None, Path("/"), MS_REC | MS_PRIVATE)
        and all(_mount(each, each, MS_BIND | MS_REC) for each in way)
        and _mount(None, folder, MS_BIND | MS_REMOUNT | MS_RDONLY | there)
    )
    os.chdir(os.getcwd())  # Which is still below all that.
    libc, capabilities = ctypes.CDLL(None), (ctypes.c_uint32 * 6)()
    header = (ctypes.c_uint32 * 2)(CAPABILITIES_3, 0)
    return mounted and libc.prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) == 0 == libc.capset(header, capabilities)


def _mount(source: Path | None, target: Path, flags: int) -> bool:
    """Whether the system does it."""
    path = source and os.fsencode(source)
    return ctypes.CDLL(None).mount(path, os.fsencode(target), None, ctypes.c_ulong(flags), None) == 0


def _watch(guest: int, gigabytes: float, heard: int) -> str:
    """How the class's process ended, or why it has to; what it prints is passed on meanwhile, up to `MOST_PRINTED`,
    without what a terminal takes for commands."""
    import psutil

    looked, left, ends = 0.0, MOST_PRINTED, [0, heard]
    decoder = codecs.getincrementaldecoder("utf-8")("replace")  # A character can come in two parts.
    while True:
        ended, status = os.waitpid(guest, os.WNOHANG)
        ready = select.select(ends, [], [], TICK)[0]
        if 0 in ready:
            return "it is not asked any more"
        if heard in ready:
            text = os.read(heard, 65536)
            if not text:
                ends.remove(heard)
            with contextlib.suppress(OSError):  # Nobody reads it any more.
                said = decoder.decode(text[:left])
                os.write(2, "".join(each for each in said if each.isprintable() or each in "\n\t").encode())
            left = max(0, left - len(text))
        if ended:
            code = os.waitstatus_to_exitcode(status)
            return (
                f"its process ended by {signal.Signals(-code).name}" if code < 0 else f"its process ended with {code}"
            )
        with contextlib.suppress(psutil.Error):
            process = psutil.Process(guest)
            all_of_it = [process]
            if time.monotonic() > looked + LOOK_AROUND:
                all_of_it, looked = [process, *process.children(recursive=True)], time.monotonic()
            if len(all_of_it) > MOST_PROCESSES:
                return f"it started more than {MOST_PROCESSES} processes"
            if sum(map(_resident, all_of_it)) > gigabytes * 1e9:
                return f"it took more than {gigabytes:g} GB of memory (limits.memory)"


def _resident(process: Any) -> int:
    import psutil

    try:
        return process.memory_info().rss
    except psutil.Error:
        return 0


def _end_all() -> None:
    """Kill the class's process and what it started: orphans become children of this process."""
    import psutil

    while left := psutil.Process().children(recursive=True):
        for process in left:
            with contextlib.suppress(psutil.Error):
                process.kill()
        psutil.wait_procs(left, timeout=1)


def _serve(channel: int, has: list[str]) -> NoReturn:
    """Answer what is asked, until nothing is any more."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    os.setsid()
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    try:
        _answer_all(channel, has)
    except (EOFError, ConnectionError):
        pass
    finally:
        os._exit(0)


def _answer_all(channel: int, has: list[str]) -> NoReturn:
    import random
    from multiprocessing.connection import Connection

    import numpy as np
    import torch

    from benchmark.rollouts.guidance_class import GuidanceClass

    torch.set_num_threads(1)  # As in a rollout's worker process; two threads round otherwise.
    for seed in (random.seed, np.random.seed, torch.seed):
        seed()  # From the system: a class that leans on them is found out when it is run again.
    connection, made = Connection(channel), dict[int, Any]()
    while True:
        number, name, arguments, dropped = connection.recv()
        for each in dropped:
            made.pop(each, None)
        try:
            if name == "start":
                answer = b"s" + json.dumps(has).encode()
            elif name in ("make", "describe"):
                file, called, *rest = arguments
                stranger = GuidanceClass(file, called)
                if name == "make":
                    number = max(made, default=0) + 1
                    made[number], about = stranger.load(*rest)
                    about["number"] = number
                else:
                    theirs = stranger.load_class()
                    about = {name: getattr(theirs, name) for name in ("field_kind", "default_scale")}
                answer = b"s" + json.dumps(about).encode()
            else:
                answer = _answer(made[number], name, arguments)
        except BaseException as error:  # Whatever somebody's file may raise, also SystemExit.
            answer = b"e" + (str(error) or type(error).__name__).encode(errors="replace")
        connection.send_bytes(answer)


def _answer(guidance: Any, name: str, arguments: tuple) -> bytes:
    import torch

    if name in ("reset", "meet"):
        getattr(guidance, name)(*arguments)
        return b"n"
    with torch.inference_mode():
        given = [torch.from_numpy(array) for array in arguments]
        answer = getattr(guidance, name)(*given)
        return b"n" if answer is None else b"a" + answer.contiguous().numpy().tobytes()
