"""Intel's Open Image Denoise, through its Python package, which is optional; on the host."""

import importlib

import numpy as np

from ..errors import DeviceError, SettingError

PACKAGE = "pyoidn"


class Denoiser:
    """Open Image Denoise on the CPU, for pictures of linear light of any brightness.

    threads: how many it may use, 0 for all; its result does not depend on that. Raises SettingError where its package is missing, DeviceError
    where its library does not work here.
    """

    def __init__(self, threads: int):
        try:
            self._module = importlib.import_module(PACKAGE)
        except ImportError as error:
            raise SettingError(
                f"setting octree.filter: 'oidn' needs the package {PACKAGE} ({error}); to install it: pip install {PACKAGE}"
            ) from None
        try:
            self._device = self._module.Device()
            self._device.set_int("numThreads", threads)
            self._device.set_bool("setAffinity", False)  # or its threads keep others off their processors
            self._device.commit()
        except OSError as error:
            raise DeviceError(f"{PACKAGE}: {str(error).splitlines()[0]}") from error
        self._check()
        self._filter = self._module.Filter(self._device)
        self._filter.set_bool("hdr", True)

    def __call__(self, color: np.ndarray, albedo: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """The picture without noise; (H, W, 3) float32 each. color: at least 0. albedo: 0 .. 1. normal: of any orientation; both 0
        where there is no surface. Raises DeviceError."""
        images = {"color": color, "albedo": albedo, "normal": normal, "output": np.empty(color.shape, np.float32)}
        images = {name: np.ascontiguousarray(image, np.float32) for name, image in images.items()}
        for name, image in images.items():
            self._filter.set_image(name, image, self._module.OIDN_FORMAT_FLOAT3)
        self._filter.commit()
        self._filter.execute()
        self._check()
        return images["output"]

    def __del__(self):
        for part in ("_filter", "_device"):
            if hasattr(self, part):
                getattr(self, part).release()

    def _check(self) -> None:
        message = self._device.get_error()
        if message:
            raise DeviceError(f"{PACKAGE}: {message.splitlines()[0]}")
