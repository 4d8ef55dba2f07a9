"""A stranger's class of guidance in a process of its own: what it does there reaches nothing but its answers.

The process is asked over a pipe, a place to act at a time. Numbers of a known type and count come back and nothing
else: what it sends is never unpickled.
"""

import contextlib
import json
import math
import multiprocessing
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Iterator
from functools import lru_cache
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from benchmark.rollouts.stranger import MOST_CHUNKS, ClassAttributes, Stranger
from benchmark.settings.entry_config import FIELD_KINDS
from benchmark.settings.setting import SettingError, check_setting
from policies.guidance import Guidance
from richmap.outputs import missing_folders, remove_empty

if TYPE_CHECKING:
    from collections.abc import Sequence

    from torch import Tensor

START = 300.0
"""How long a process may take to start on a busy machine, in [s]."""
LONGEST = 1 << 28
"""Of an answer, in bytes."""
ENDING = 5.0
"""How long a process that has ended may take to say how, in [s]."""
LONGEST_TEXT = 100_000
"""Of what it says of itself, and of errors, in bytes."""


class GuestGuidance(Guidance):
    """Guidance by an instance that lives in another process.

    Args:
        process: Which.
        where: What the class is called in errors.
        about: What the process said of the instance.
        width: Numbers of the task's actions.
    """

    def __init__(self, process: "GuestProcess", where: str, about: "dict[str, Any]", width: int) -> None:
        self._process, self._where, self._width = process, where, width
        self._number, self._takes = int(about["number"]), {*map(str, about["takes"])}
        self.samples, self.looks_ahead = int(about["samples"]), bool(about["looks_ahead"])
        if not 1 <= self.samples <= MOST_CHUNKS:
            raise ValueError
        weakref.finalize(self, process.dropped.append, self._number)

    def reset(self, rows: "Sequence[int] | None") -> None:
        """A batch begins: its time is counted anew."""
        self._process.left = self._process.seconds
        if "reset" in self._takes:
            self._process.ask(self._where, self._number, "reset", None if rows is None else [*map(int, rows)])

    def meet(self, rows: "Sequence[int]", places: "np.ndarray") -> None:
        """See `Guidance`."""
        if "meet" in self._takes:
            self._process.ask(self._where, self._number, "meet", [*map(int, rows)], np.array(places))

    def imagine(self, environment: "Tensor", state: "Tensor") -> "Tensor":
        """See `Guidance`."""
        return self._ask("imagine", tuple(environment.shape), environment, state)

    def push(self, state: "Tensor") -> "Tensor | None":
        """See `Guidance`."""
        return self._ask("push", (len(state), self._width), state) if "push" in self._takes else None

    def descent(self, actions: "Tensor", state: "Tensor") -> "Tensor":
        """See `Guidance`."""
        return self._ask("descent", tuple(actions.shape), actions, state)

    def choose(self, chunks: "Tensor", state: "Tensor") -> "Tensor":
        """See `Guidance`."""
        if "choose" not in self._takes:
            return super().choose(chunks, state)
        return self._ask("choose", (len(chunks), *chunks.shape[2:]), chunks, state)

    def correct(self, chunk: "Tensor", state: "Tensor") -> "Tensor":
        """See `Guidance`."""
        return self._ask("correct", tuple(chunk.shape), chunk, state)

    def _ask(self, name: str, shape: tuple[int, ...], *given: "Tensor") -> "Any":
        if name not in self._takes:
            return given[0]
        arrays = [tensor.cpu().numpy() for tensor in given]
        kind, answer = self._process.ask(self._where, self._number, name, *arrays)
        if kind == b"n" and name == "push":
            return None
        dtype = arrays[0].dtype
        if kind != b"a" or len(answer) != dtype.itemsize * int(np.prod(shape)):
            raise SettingError(f"{self._where}.{name} gave what is no array {shape}.")
        array = np.frombuffer(answer, dtype).reshape(shape).copy()
        if not np.isfinite(array).all():
            raise SettingError(f"{self._where}.{name} gave what is not finite.")
        return torch.from_numpy(array).to(given[0].device)


class Forked:
    """A process that is no child of this one.

    Args:
        handle: A file descriptor of it.
        standard_input: Write end of its standard input; the process ends when this is closed.
    """

    def __init__(self, handle: int, standard_input: int) -> None:
        self._handle, self._standard_input = handle, standard_input

    def kill(self) -> None:
        """End it at once."""
        with contextlib.suppress(OSError):  # It is gone.
            signal.pidfd_send_signal(self._handle, signal.SIGKILL)

    def end(self) -> None:
        """Close its standard input, and see it gone."""
        os.close(self._standard_input)
        if not wait([self._handle], ENDING):
            self.kill()
            wait([self._handle])
        os.close(self._handle)


class GuestHost:
    """A process that has imported what classes need, and forks one for each of them; it ends with this object."""

    def __init__(self) -> None:
        self._asked, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._asked.settimeout(START)
        command = "import sys; from benchmark.rollouts.guest_house import main; main(*sys.argv[1:])"
        self.process = subprocess.Popen(
            [sys.executable, "-u", "-c", command, str(theirs.fileno())],
            stdin=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            start_new_session=True,  # Ctrl-C is for us.
            env=self._environment(),
        )
        theirs.close()
        weakref.finalize(self, _end_host, self._asked, self.process)

    def fork(self, channel: int, status: int, gigabytes: float, kept: Path | None) -> Forked:
        """A process that serves a class, with these arguments of `guest_house.watch`.

        Raises:
            SettingError: If the host is gone.
        """
        limits = {"gigabytes": gigabytes, "kept": str(kept or "")}
        request = limits | {"environment": self._environment(), "path": sys.path, "folder": os.getcwd()}
        standard_input, ours = os.pipe()
        try:
            with open(os.memfd_create("request"), "w") as file:
                json.dump(request, file)
                file.flush()
                socket.send_fds(self._asked, [b"."], [file.fileno(), standard_input, 2, channel, status])
            _, (handle,), *_ = socket.recv_fds(self._asked, 1, 1)
        except BaseException as error:
            os.close(ours)
            _end_host(self._asked, self.process)  # Its answer would be taken for the next one's.
            if isinstance(error, OSError | ValueError):  # Nothing comes of a process that is gone.
                raise SettingError("No process for a class could be started, perhaps for want of memory.") from error
            raise
        finally:
            os.close(standard_input)
        os.set_inheritable(handle, False)
        return Forked(handle, ours)

    def _environment(self) -> dict[str, str]:
        one_thread = dict.fromkeys(["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"], "1")
        return os.environ | one_thread | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def _end_host(asked: socket.socket, process: subprocess.Popen) -> None:
    """End a host, which holds nothing; what it forked goes on."""
    asked.close()
    process.kill()
    process.wait()


def host() -> GuestHost:
    """The one of this process; another if it is gone."""
    if not _hosts or _hosts[0].process.poll() is not None:
        _hosts[:] = [GuestHost()]
    return _hosts[0]


_hosts: list[GuestHost] = []


class GuestProcess:
    """A process in which classes are asked; it ends with this object and with this process, however that ends.

    Args:
        seconds: For the answers to a batch of episodes, in [s] of the clock.
        gigabytes: Of resident memory, with what it starts.
        kept: Folder that it may not change. It is made, and goes again at the end if nothing came into it.
    """

    def __init__(self, seconds: float, gigabytes: float, kept: Path | None) -> None:
        self.seconds, self.left = seconds, START
        self.dropped: list[int] = []
        """Instances that nobody asks any more."""
        ours, theirs = socket.socketpair()
        told, tells = multiprocessing.Pipe(duplex=False)
        for option in (socket.SO_SNDTIMEO, socket.SO_RCVTIMEO):  # Nor does half of a message keep us waiting.
            ours.setsockopt(socket.SOL_SOCKET, option, struct.pack("ll", int(seconds) + 1, 0))
        made = missing_folders(kept) if kept else []
        if kept:
            kept.mkdir(parents=True, exist_ok=True)
        try:
            self._process = host().fork(theirs.fileno(), tells.fileno(), gigabytes, kept)
        except BaseException:
            ours.close()
            told.close()
            remove_empty(made)
            raise
        finally:
            theirs.close()
            tells.close()
        self._channel, self._told = Connection(ours.detach()), told
        self._end = weakref.finalize(self, _end, self._process, self._channel, self._told, made)
        _, said = self.ask("A process for a class", 0, "start")
        has = [printable(each.encode()) for each in json.loads(said[:LONGEST_TEXT])]
        if has and multiprocessing.parent_process() is None:
            print(f"This system leaves a class in a file what it should not have: {', '.join(has)}.", file=sys.stderr)

    def ask(self, where: str, number: int, name: str, *arguments: object) -> tuple[bytes, bytes]:
        """What an instance answers: the kind of answer, and its bytes.

        Args:
            where: What its class is called in errors.
            number: Which.
            name: The place to act.
            arguments: What is handed over.

        Raises:
            SettingError: If it raises, answers nothing in time, or its process ends.
        """
        began, dropped = time.monotonic(), [self.dropped.pop() for _ in [*self.dropped]]
        try:
            self._channel.send((number, name, arguments, dropped))
            if not wait([self._channel, self._told], max(0.0, self.left)):
                raise BlockingIOError
            late = threading.Timer(max(0.0, began + self.left - time.monotonic()), self._process.kill)
            late.start()  # An answer may also come byte by byte.
            try:
                answer = self._channel.recv_bytes(LONGEST) if self._channel.poll() else b""
            finally:
                late.cancel()
        except BlockingIOError:
            answer = b"t"
        except (EOFError, OSError):
            answer = b"t" if time.monotonic() > began + self.left else b""
        self.left -= time.monotonic() - began
        kind, content = answer[:1], answer[1:]
        if kind in (b"a", b"n", b"s"):
            return kind, content
        if kind == b"e":
            raise SettingError(printable(content))
        if kind == b"t":
            why = f"it has {self.seconds:g} s for a batch of episodes. Give it more by limits.seconds"
        else:
            why = printable(self._last_word())
        _process.cache_clear()
        self._end()
        raise SettingError(f"{where}.{name} gave no answer: {why}.")

    def _last_word(self) -> bytes:
        """How the process ended, by the one that watched over it."""
        with contextlib.suppress(EOFError, OSError):
            if self._told.poll(ENDING):
                return self._told.recv_bytes(1000)
        return b"its process is gone, or answered what is none"


def make_guest(of: Stranger, *arguments: "Any") -> GuestGuidance:
    """An instance of a class, in the process of that class; the arguments are those of `GuidanceClass.load`."""
    process, about = _told_by(of, "make", *arguments)
    with _believed(of):
        return GuestGuidance(process, f"{of.file}: {of.name}", about, arguments[-1])


def class_attributes(of: Stranger) -> ClassAttributes:
    """What a class says of itself in its process."""
    _, about = _told_by(of, "describe")
    with _believed(of):
        kind, scale = str(about["field_kind"]), about["default_scale"]
        check_setting(kind in FIELD_KINDS, f"{of.name}.field_kind", printable(kind.encode()), ", ".join(FIELD_KINDS))
        scale = None if scale is None else float(scale)
        check_setting(scale is None or math.isfinite(scale), f"{of.name}.default_scale", scale, "a number")
        return ClassAttributes(kind, scale)


def _told_by(of: Stranger, name: str, *arguments: object) -> "tuple[GuestProcess, dict[str, Any]]":
    if not of.file.is_file():
        raise SettingError(f"There is no {of.file}, which should hold the guidance {of.name}.")
    process = _process(of.seconds, of.gigabytes, of.kept, of.version)
    process.left = of.seconds
    _, said = process.ask(f"{of.file}: {of.name}", 0, name, of.file, of.name, *arguments)
    with _believed(of):
        about = json.loads(said[:LONGEST_TEXT])
        return process, {**about}


@contextlib.contextmanager
def _believed(of: Stranger) -> Iterator[None]:
    """Refuse what a process says of its class, if it is nothing that it could say."""
    try:
        yield
    except SettingError:
        raise
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise SettingError(f"{of.file}: {of.name} says of itself what cannot be read.") from error


@lru_cache(maxsize=1)
def _process(seconds: float, gigabytes: float, kept: Path | None, version: str) -> GuestProcess:
    """The one for these limits and this version of a stranger's files."""
    return GuestProcess(seconds, gigabytes, kept)


def _end(process: Forked, channel: Connection, told: Connection, made: list[Path]) -> None:
    """End a process, and remove what was made for it and is empty."""
    for each in (channel, told):
        with contextlib.suppress(OSError):
            each.close()
    process.end()
    remove_empty(made)


def printable(text: bytes) -> str:
    """A stranger's text in a line without signs that a terminal obeys."""
    line = " ".join(text[:LONGEST_TEXT].decode(errors="replace").split())
    return "".join(sign for sign in line if sign.isprintable())[:1000]
