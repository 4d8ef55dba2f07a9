"""What orbits are compared by."""

import numpy as np

from richmap.motion.sampling import sample_workspace


def assert_none_is_lost(robot, grid):
    """Orbits that are drawn for a grid hold the poses within it that all orbits hold, and fewer beyond it."""
    every, some = (sample_workspace(robot, np.random.default_rng(5), 400, 16, grid=each) for each in (None, grid))
    (position, direction, joints), (kept, towards, of) = every.poses(), some.poses()
    held, again = grid.cells_of(position) >= 0, grid.cells_of(kept) >= 0
    assert 0 < held.sum() == again.sum() and len(some.joints) < len(every.joints)
    for one, other in ((position, kept), (direction, towards), (joints, of)):
        assert (one[held] == other[again]).all()
