"""clcache: cached, temporally stable, stereo ray tracing on OpenCL."""

from .errors import DeviceError, Error, SceneError, SettingError
from .version import __version__

__all__ = [
    "DeviceError",
    "Error",
    "Frame",
    "Renderer",
    "SceneError",
    "SettingError",
    "Tracer",
    "__version__",
    "graph",
    "load_scene",
    "metrics",
]


def __getattr__(name: str):
    """What is slow to import, or needs an OpenCL library, is imported when it is first asked for."""
    if name == "load_scene":
        from .scene import load_scene

        return load_scene
    if name in ("Renderer", "Frame"):
        from . import renderer

        return getattr(renderer, name)
    if name in ("graph", "metrics"):
        import importlib

        return importlib.import_module(f".{name}", __name__)
    if name == "Tracer":
        from .bvh import Tracer

        return Tracer
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
