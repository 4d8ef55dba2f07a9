import time
from io import StringIO

import pytest
from rich.console import Console

from richmap import progress


@pytest.mark.parametrize("terminal", [False, True])
def test_a_line_is_said_now_and_then_where_no_bar_can_move(terminal, monkeypatch):
    monkeypatch.setattr(progress, "SAY_EVERY", 60.0)
    now = [0.0]
    monkeypatch.setattr(progress, "monotonic", lambda: now[0])
    said = StringIO()
    with progress.progress_bar(Console(file=said, force_terminal=terminal, width=200)) as bar:
        task = bar.add_task("Test poses of panda", total=10)
        before = said.getvalue().count("Test poses")
        for now[0] in (30.0, 61.0, 90.0, 122.0):
            bar.advance(task, 2)
        lines = [line.split(", about ")[0] for line in said.getvalue().splitlines()]
    if terminal:
        assert "Test poses of panda  4/10" not in lines
    else:
        assert before == 0 and lines == ["Test poses of panda  4/10", "Test poses of panda  8/10"]
        assert said.getvalue().isascii()  # Also its last line.
        assert said.getvalue().splitlines()[2:] == ["Test poses of panda  8/10, 0:00:00 used"]


def test_no_line_is_cut_where_no_bar_can_move():
    said, name = StringIO(), "custom-a-name-that-is-long.urdf-9fb79929"
    with progress.progress_bar(Console(file=said, width=80)) as bar:
        bar.add_task(f"Map of {name}, built for the first time, with a word or two more", total=1)
    assert name in said.getvalue() and len(said.getvalue().splitlines()) == 1


def test_what_is_tracked_is_counted_where_no_bar_can_move():
    said = StringIO()
    with progress.progress_bar(Console(file=said, width=80)) as bar:
        for _ in bar.track(range(3), description="Replays"):
            time.sleep(0.15)  # Longer than a bar takes to be drawn anew.
    assert said.getvalue() == "Replays 3/3, 0:00:00 used\n"
