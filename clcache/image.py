"""Images of a device, which stand where arrays stand: with a shape and a dtype, read and written whole."""

import numpy as np
import pyopencl as cl

_CHANNEL_TYPES = {np.dtype(np.float32): cl.channel_type.FLOAT, np.dtype(np.float16): cl.channel_type.HALF_FLOAT}


class Image:
    """An image of texels of four channels, uninitialised.

    shape: (rows, columns, 4), or (layers, rows, columns, 4) of a three-dimensional one; dtype: float32 or float16. `base_data`: what
    kernels are given. Raises cl.Error where the device has no such image.
    """

    def __init__(self, queue: cl.CommandQueue, shape: tuple[int, ...], dtype: np.dtype | type):
        self.shape, self.dtype = tuple(shape), np.dtype(dtype)
        self.nbytes = int(np.prod(self.shape, dtype=np.int64)) * self.dtype.itemsize
        self._queue = queue
        self._region = (*self.shape[-2::-1], *(1,) * (4 - len(self.shape)))
        texel = cl.ImageFormat(cl.channel_order.RGBA, _CHANNEL_TYPES[self.dtype])
        self.base_data = cl.create_image(queue.context, cl.mem_flags.READ_WRITE, texel, shape=self.shape[-2::-1])

    @property
    def context(self) -> cl.Context:
        """That of the device."""
        return self._queue.context

    def get(self) -> np.ndarray:
        """A copy of the texels on the host, once all that was enqueued is done."""
        values = np.empty(self.shape, self.dtype)
        cl.enqueue_copy(self._queue, values, self.base_data, origin=(0, 0, 0), region=self._region)
        return values

    def set(self, values: np.ndarray) -> None:
        """Overwrite all texels."""
        values = np.ascontiguousarray(values, self.dtype).reshape(self.shape)
        cl.enqueue_copy(self._queue, self.base_data, values, origin=(0, 0, 0), region=self._region)
