"""The door of every command: settings from the command line through Hydra, one line for what is wrong with them."""

import errno
import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import NoReturn

import hydra
import platformdirs
import yaml
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException, MissingConfigException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from benchmark.settings.composition import file_groups, files_of, register
from benchmark.settings.given_configs import check_given
from benchmark.settings.help import help_text
from benchmark.settings.overrides import checked, named, split
from benchmark.settings.run_folder import clear_run_folder
from benchmark.settings.setting import Raised, Setting, SettingError, settings_of
from benchmark.settings.typed import typed
from richmap.outputs import OF_DISKS, CacheError, DrawingError, FileRefusedError

COMPLETION = """\
_complete_benchmark() {
    if [[ ${COMP_WORDS[1]} == -m && ${COMP_WORDS[2]} == benchmark.* ]]; then
        local line="command${COMP_LINE#*"${COMP_WORDS[2]}"}"
        local offered="$(COMP_LINE="$line" "${COMP_WORDS[0]}" -m "${COMP_WORDS[2]}" -sc query=bash 2>/dev/null)"
        COMPREPLY=($(compgen -W "$offered" -- "${COMP_WORDS[COMP_CWORD]}"))
    fi
}
COMP_WORDBREAKS=${COMP_WORDBREAKS//=}
complete -o nospace -o default -F _complete_benchmark python python3"""
"""For bash, in which Hydra's own completes scripts and installed commands, but not `python -m`."""

OTHER_CACHE = "Choose another folder for the cache: XDG_CACHE_HOME=/some/folder before the command."
OUT_OF_MEMORY = (
    "error: This takes more memory than the process can have. Take larger cells (map.cell_size), fewer workers or "
    "smaller batches."
)
GONE_ON = "What was finished is stored; the same command goes on from there."
AGAIN = 5.0
"""After how long what ends a command is raised again, in [s]."""


def run_command[Config](
    main: Callable[[Config], None],
    schema: type[Config],
    name: str,
    job: Callable[[DictConfig], None] | None = None,
    sweeping: Callable[[], AbstractContextManager[None]] = nullcontext,
    positional: Sequence[str] = (),
    goes_on: bool = False,
) -> None:
    """Read settings `key=value` from the command line into a `schema` and call `main` with it.

    Defaults and descriptions are those of the schema; `conf/<name>.yaml`, if there is one, says how it is composed.
    Wrong settings end the program with status 2 and one line, before anything heavy is imported.

    Args:
        main: What the command does.
        schema: A dataclass.
        name: Of the command's configuration.
        job: What it does with each combination of a sweep, if that is something else.
        sweeping: Within what a sweep runs.
        positional: Settings that may be given by their place, without their names.
        goes_on: Whether it stores what it finishes, and goes on from there when it is called again.
    """
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises instead of printing.
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # It says where its cache is if the home is read-only.
    spec = sys.modules["__main__"].__spec__
    module = spec.name if spec and main.__module__ == "__main__" else f"benchmark.{name}"
    gone_on = [GONE_ON] * goes_on
    with _one_line_for_errors(gone_on), _stopped_by_signals(gone_on):
        if os.environ.get("MUJOCO_GL"):
            import envs  # noqa: F401, which says whether MuJoCo loads with that.
        flags, overrides = split(sys.argv[1:])
        check_given(flags, overrides, file_groups(name), name)
        overrides = named(overrides, positional, settings_of(schema))
        register(schema, name)
        sweeps = not {"-m", "--multirun"}.isdisjoint(flags) or any(
            override.startswith(("experiment=", "hydra.mode=")) for override in overrides
        )
        known = settings_of(schema) | dict.fromkeys(file_groups(name), Setting("", None, str))
        overrides = checked(overrides, known, module, sweeps) if not _completes(flags) else overrides
        if not {"-h", "--help"}.isdisjoint(flags):
            print(help_text(main, schema, name, module, flags, overrides))
        elif _completes(flags) and overrides == ["install=bash"]:
            print(COMPLETION)
        elif _completes(flags) and "COMP_LINE" not in os.environ:
            raise SettingError("Words are completed in bash alone. What you type is -sc install=bash.")
        else:
            sys.argv[1:] = [*flags, *overrides]
            with sweeping():
                _run(main, job, schema, name)
        sys.stdout.flush()


@contextmanager
def _stopped_by_signals(gone_on: Sequence[str]) -> Iterator[None]:
    """SIGINT and SIGTERM end the command with a line; once it is over they end the process, as nothing would catch an
    exception then.

    Args:
        gone_on: What to say besides.
    """
    _stops.clear()
    hook = sys.unraisablehook
    sys.unraisablehook = lambda ignored: None if issubclass(ignored.exc_type, KeyboardInterrupt) else hook(ignored)
    for number, stop in ((signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, _Terminated)):
        if signal.getsignal(number) is not signal.SIG_IGN:  # As a shell has SIGINT for what runs in the background.
            signal.signal(number, _raising(stop))
    try:
        yield
    except BaseException as error:
        if not isinstance(error, KeyboardInterrupt) and not _stops:
            raise
        _end(143 if _Terminated in (type(error), *_stops) else 130, "Interrupted.", *gone_on)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        sys.unraisablehook = hook
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, signal.SIG_DFL)


@contextmanager
def _one_line_for_errors(gone_on: Sequence[str]) -> Iterator[None]:
    """End the program with a status and one line for what a user can mend.

    Args:
        gone_on: What to say besides where the command was cut off.
    """
    try:
        yield
    except BrokenPipeError:  # Whoever read what is printed, such as `head`, has seen enough.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (SettingError, CacheError, DrawingError, FileRefusedError, OmegaConfBaseException) as error:
        _refuse(error)
    except HydraException as error:
        _refuse(_in_our_words(error))
    except yaml.YAMLError as error:  # Of a file that Hydra composes.
        _refuse(SettingError(" ".join(str(error).split())))
    except BrokenProcessPool:
        _end(1, "error: A worker process was killed, perhaps for want of memory.", *gone_on)
    except MemoryError:
        _end(1, OUT_OF_MEMORY, *gone_on)
    except OSError as error:
        if error.errno == errno.ENOMEM:
            _end(1, OUT_OF_MEMORY, *gone_on)
        if error.filename is None and error.errno in OF_DISKS:
            _end(1, f"error: {os.strerror(error.errno)}, as a file was written.", *gone_on)
        if error.filename is None or error.strerror is None:
            raise
        in_cache = Path(str(error.filename)).is_relative_to(platformdirs.user_cache_path())
        _end(1, f"error: {error.strerror}: {error.filename}.", *[OTHER_CACHE] * in_cache, *gone_on)


def _run[Config](
    main: Callable[[Config], None], job: Callable[[DictConfig], None] | None, schema: type[Config], name: str
) -> None:
    """Hand over to Hydra, which composes the settings and calls with them what is to be done."""

    def enter(config: DictConfig) -> None:
        if job is not None and HydraConfig.get().mode == RunMode.MULTIRUN:
            job(config)
            return
        try:
            main(typed(config, schema))
        except Exception as error:
            raise Raised from error

    try:
        hydra.main(version_base="1.3", config_path=files_of(name), config_name=name)(enter)()
    except Raised as raised:
        clear_run_folder()
        error = raised.__cause__
        assert error
        raise error from error.__cause__
    except HydraException:
        raise
    except ValueError as error:  # Of flags that do not go together; one of `main` is `Raised`.
        raise SettingError(str(error)) from error
    except OSError as error:
        raise SettingError(f"hydra.run.dir or hydra.sweep.dir: {error.strerror}: {error.filename}.") from error


class _Terminated(KeyboardInterrupt):
    """By SIGTERM, which ends a command and its workers as Ctrl-C does."""


_stops: list[type[KeyboardInterrupt]] = []
"""What was raised to end the command. A library in which it comes up may lose it, or raise an error of its own."""


def _raising(stop: type[KeyboardInterrupt]) -> Callable[..., NoReturn]:
    """A signal's handler that raises this, and again every few seconds until the command ends."""

    def handle(*_: object) -> NoReturn:
        _stops.append(stop)
        signal.signal(signal.SIGALRM, handle)
        signal.setitimer(signal.ITIMER_REAL, AGAIN)
        raise stop

    return handle


def _completes(flags: list[str]) -> bool:
    """Whether a shell asks how a word can go on."""
    return not {"-sc", "--shell-completion"}.isdisjoint(flags)


def _in_our_words(error: HydraException) -> str:
    """Hydra's errors of several lines in one."""
    if isinstance(error, MissingConfigException) and error.options and error.missing_cfg_file:
        group, _, choice = error.missing_cfg_file.rpartition("/")
        return f"{group}={choice} is not allowed. Allowed: {', '.join(sorted(error.options))}."
    return str(error)


def _refuse(error: Exception | str) -> NoReturn:
    _end(2, f"error: {' '.join(str(error).split())}")


def _end(status: int, *sentences: str) -> NoReturn:
    print(*sentences, file=sys.stderr)
    sys.exit(status)
