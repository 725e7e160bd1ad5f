"""Scenes: files become plain values and NumPy arrays; nothing here touches OpenCL."""

from .load import load_scene
from .model import (
    NO_TEXTURE,
    WRAP_MODES,
    Camera,
    Defaults,
    DirectionalLight,
    Instance,
    Material,
    Mesh,
    PointLight,
    Scene,
    Texture,
)

__all__ = [
    "NO_TEXTURE",
    "WRAP_MODES",
    "Camera",
    "Defaults",
    "DirectionalLight",
    "Instance",
    "Material",
    "Mesh",
    "PointLight",
    "Scene",
    "Texture",
    "load_scene",
]
