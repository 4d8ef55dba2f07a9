"""Off-screen pictures without a display."""

import atexit
import os
from typing import Any
from weakref import WeakSet

import mujoco
import numpy as np
from jaxtyping import UInt8

from envs.drawing import short
from richmap.outputs import DrawingError

WIDTH, HEIGHT = 480, 360
"""Of a picture, in pixels, unless another size is asked for."""
LARGEST = 2048
"""Width and height that are drawn at most, in pixels."""
MISSING = "Install it, on Debian by: apt install libegl1 libgl1-mesa-dri."

_open: "WeakSet[Renderer]" = WeakSet()
_drawing: int | None = None
"""The process that has begun to draw; a fork of it has this number, too."""


class Renderer:
    """Draws a model through EGL, which needs no display; made in the process and the thread that use it.

    Without shadows, reflections and smoothed edges, which would take six of seven parts of the time where no GPU draws.

    Args:
        model: What is drawn.
        width: Of the largest picture, in pixels.
        height: Likewise.

    Raises:
        DrawingError: If nothing can be drawn here.
    """

    _buffers: mujoco.MjrContext | None = None

    def __init__(self, model: mujoco.MjModel, width: int = WIDTH, height: int = HEIGHT) -> None:
        self._context = _egl_context(width, height)
        self._context.make_current()
        self._model = model
        self._scene = mujoco.MjvScene(model, maxgeom=1000)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._scene.flags[flag] = 0
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = [0, 1, 0, 0, 0, 0]
        self._option.sitegroup[:] = 0
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = model.camera("front").id
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        model.vis.quality.offsamples = 0
        self._buffers = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._buffers)
        _open.add(self)

    def draw(self, data: mujoco.MjData, width: int, height: int) -> UInt8[np.ndarray, "height width 3"]:
        """What the front camera sees, in at most the size that the renderer was made for."""
        _check_process()
        try:
            self._context.make_current()
        except Exception as error:  # OpenGL's own.
            raise DrawingError(
                "An environment is drawn in one thread, that of its first picture; in this one EGL failed "
                f"({short(error)})."
            ) from error
        view = mujoco.MjrRect(0, 0, width, height)
        every = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, data, self._option, None, self._camera, every, self._scene)
        mujoco.mjr_render(view, self._scene, self._buffers)
        picture = np.empty((height, width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(picture, None, view, self._buffers)
        return picture[::-1].copy()

    def close(self) -> None:
        """Give the graphics memory back: its own, so its own context has to be the current one."""
        if self._buffers is not None and not _is_forked():
            self._context.make_current()
            self._buffers.free()
            self._context.free()
            self._buffers = None

    def __del__(self) -> None:
        self.close()


def is_drawn(pixels: Any) -> bool:
    """Whether a side of a picture has a length that is drawn, in pixels."""
    return isinstance(pixels, int | np.integer) and bool(8 <= pixels <= LARGEST)


def check_size(name: str, width: int, height: int) -> None:
    """Refuse a size that is not drawn.

    Raises:
        ValueError: If it is none.
    """
    for side, pixels in (("width", width), ("height", height)):
        if not is_drawn(pixels):
            raise ValueError(f"{name}_{side} is a whole number of pixels from 8 to {LARGEST}. Got {pixels!r}")


def _egl_context(width: int, height: int) -> Any:
    """A context of EGL's.

    Raises:
        DrawingError: If there is none, with what may be the cause.
    """
    global _drawing
    _check_process()
    _drawing = os.getpid()
    try:
        from mujoco.egl import GLContext

        class Context(GLContext):
            _context = None  # Which it asks for as it goes, also where it was not made.

        context = Context(width, height)
    except Exception as error:  # A missing library shows as ImportError, AttributeError or OpenGL's own errors.
        raise DrawingError(_reason(error)) from error
    atexit.unregister(_close_all)  # So that it is called before EGL ends, which was registered just now.
    atexit.register(_close_all)
    return context


def _is_forked() -> bool:
    return _drawing not in (None, os.getpid())


def _check_process() -> None:
    """Refuse to draw where EGL would wait for threads that a fork does not have."""
    if _is_forked():
        raise DrawingError(
            "This process was forked from one that had drawn, and cannot draw. Start it by spawn: "
            'gymnasium.make_vec(..., vectorization_mode="async", vector_kwargs={"context": "spawn"}).'
        )


def _reason(error: Exception) -> str:
    set_here = {name: os.environ.get(name, "") for name in ("PYOPENGL_PLATFORM", "MUJOCO_GL", "MUJOCO_EGL_DEVICE_ID")}
    suspects = [f"{name}={value}" for name, value in set_here.items() if value.lower() not in ("", "egl")]
    what = f"Unset {', '.join(suspects)} and start again." if suspects else MISSING
    return f"Pictures are drawn through EGL, which failed ({short(error)}). {what} Without pictures: render_mode=None."


def _close_all() -> None:
    """At the interpreter's end, while EGL is still there."""
    for renderer in [*_open]:
        renderer.close()
