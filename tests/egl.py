"""Whether pictures can be drawn on this machine."""

import pytest


def has_egl() -> bool:
    try:
        from mujoco.egl import GLContext

        GLContext(8, 8).free()
    except Exception:
        return False
    return True


needs_egl = pytest.mark.skipif(
    not has_egl(), reason="No EGL on this machine. On Debian: sudo apt-get install libegl1 libgl1-mesa-dri"
)
