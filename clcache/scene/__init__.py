"""Scenes: files become plain values and NumPy arrays; nothing here touches OpenCL."""

from .load import load_scene
from .model import (
    WRAP_MODES,
    Camera,
    Defaults,
    DirectionalLight,
    Environment,
    Instance,
    Light,
    Material,
    Mesh,
    PointLight,
    Scene,
    SpotLight,
    Texture,
    TextureUse,
    Track,
)

__all__ = [
    "WRAP_MODES",
    "Camera",
    "Defaults",
    "DirectionalLight",
    "Environment",
    "Instance",
    "Light",
    "Material",
    "Mesh",
    "PointLight",
    "Scene",
    "SpotLight",
    "Texture",
    "TextureUse",
    "Track",
    "load_scene",
]
