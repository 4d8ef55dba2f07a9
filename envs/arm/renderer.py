"""Off-screen pictures without a display."""

import mujoco
import numpy as np
from jaxtyping import UInt8

WIDTH, HEIGHT = 480, 360
"""Of a picture, in pixels."""


class Renderer:
    """Draws a model through EGL, which needs no display; made in the process that uses it.

    Raises:
        RuntimeError: If this machine has no EGL.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        try:
            from mujoco.egl import GLContext

            self._context = GLContext(WIDTH, HEIGHT)
        except Exception as error:  # A missing library shows as ImportError, AttributeError or OpenGL's own errors.
            raise RuntimeError(
                f'render_mode="rgb_array" needs EGL, which this machine lacks ({error}). '
                f"On Debian: apt install libegl1 libgl1-mesa-dri. Without pictures: render_mode=None."
            ) from error
        self._context.make_current()
        self._model = model
        self._scene = mujoco.MjvScene(model, maxgeom=1000)
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = [0, 1, 0, 0, 0, 0]
        self._option.sitegroup[:] = 0
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
        self._camera.fixedcamid = model.camera("front").id
        model.vis.global_.offwidth, model.vis.global_.offheight = WIDTH, HEIGHT
        model.vis.quality.shadowsize = 2048
        self._buffers = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._buffers)

    def draw(self, data: mujoco.MjData) -> UInt8[np.ndarray, "height width 3"]:
        """What the front camera sees."""
        self._context.make_current()
        view = mujoco.MjrRect(0, 0, WIDTH, HEIGHT)
        every = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, data, self._option, None, self._camera, every, self._scene)
        mujoco.mjr_render(view, self._scene, self._buffers)
        picture = np.empty((HEIGHT, WIDTH, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(picture, None, view, self._buffers)
        return picture[::-1].copy()

    def close(self) -> None:
        """Give the graphics memory back."""
        self._buffers.free()
        self._context.free()
