"""How often arms are told where to be."""

CONTROL_FREQUENCY = 10
"""Control steps per second."""
