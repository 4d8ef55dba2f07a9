"""Where and how often the task acts: the few numbers that physics, outcome and environment share."""

import numpy as np

CONTROL_FREQUENCY = 10
"""Control steps per second."""
WORKSPACE = np.array([[0.15, -0.5], [0.7, 0.5]])
"""Box that the commanded effector is kept in, lower and upper xy in [m]."""
