"""Whether anything can be drawn here, and which variable of the environment is in the way."""

import os

from richmap.outputs import DrawingError


def check_mujoco_gl() -> None:
    """See that MuJoCo loads with the value of `MUJOCO_GL`, with which it loads a graphics library before anything else.

    Raises:
        DrawingError: If it does not.
    """
    value = os.environ.get("MUJOCO_GL", "").strip()
    if not value:
        return
    try:
        import mujoco  # noqa: F401
    except Exception as error:  # Whatever that library's loading raises.
        raise DrawingError(
            f"MUJOCO_GL={value}: MuJoCo does not load with it ({short(error)}). Unset it, or set it to egl."
        ) from error


def short(error: Exception) -> str:
    """An error in a line."""
    return " ".join(str(error).split())[:200] or type(error).__name__
