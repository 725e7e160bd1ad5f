"""What direct light is sampled from: the scene's emitters and their shares of its power, and the environment's.

An emitter's share is what it radiates into the scene: a point 4 pi I, a spot its cone's part of that, a triangle 2 pi A L (pi
A L if it radiates on one side), and what comes from infinity its irradiance over the scene's cross-section, pi R^2. The share
of a triangle is so proportional to its area that the chance per square metre is one number for each material. A small part
of the samples goes to all lights alike, an emissive material being one: what is weak beside another light may be all that
reaches a place, and shares below float32's resolution would never be chosen.
"""

from dataclasses import dataclass

import numpy as np

from ..layout import STRUCTS
from .geometry import Geometry, instance_bounds
from .model import DirectionalLight, Light, Scene, SpotLight
from .motion import pose_at
from .textures import mean_color

_POINT, _DIRECTIONAL, _TRIANGLE, _SKY = range(4)
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
# Part of the samples that goes to all lights alike. At 64 spp, relMSE against 0.1: classroom -15 %, kitchen +1 %, city +10 %;
# 0.5 gives -30, +7 and +37 %.
_ALIKE = 0.25


@dataclass(frozen=True)
class Emitters:
    """records: (e,) Emitter. shares: (e,) float32, cumulative. material_density: (materials,) float32, the chance per square
    metre of sampling a place of that material. sky_chance: of sampling the environment."""

    records: np.ndarray
    shares: np.ndarray
    material_density: np.ndarray
    sky_chance: float

    @classmethod
    def of(cls, scene: Scene, geometry: Geometry, time: float = 0.0) -> "Emitters":
        """The emitters of a scene as it is at a time, in seconds."""
        low, high = instance_bounds(geometry)
        cross_section = np.pi * (0.5 * np.linalg.norm(high.max(axis=0) - low.min(axis=0))) ** 2
        radiance = np.array([_mean_radiance(scene, m) for m in range(len(scene.materials))])
        sides = np.array([2.0 if m.double_sided else 1.0 for m in scene.materials])
        triangles, areas, material = _emissive_triangles(geometry, radiance > 0)
        punctual = _punctual_records(scene.lights, time)
        sky = _is_sampled(scene.environment.radiance)

        power = np.concatenate(
            [
                [_punctual_power(light, cross_section) for light in scene.lights],
                np.pi * areas * (radiance * sides)[material],
                [cross_section * _mean_sky(scene.environment.radiance)] * sky,
            ]
        )
        records = np.concatenate([punctual, triangles, np.zeros(int(sky), STRUCTS["Emitter"])])
        if sky:
            records[-1]["kind"] = _SKY
        # Each punctual light is one, then each material, then the sky.
        count = len(punctual) + len(radiance) + 1
        of_light = np.concatenate([np.arange(len(punctual)), len(punctual) + material, np.full(int(sky), count - 1)])
        if not power.sum() > 0:
            return cls(records[:0], np.zeros(0, np.float32), np.zeros(len(scene.materials), np.float32), 0.0)
        factor = _chance_by_power(np.bincount(of_light, power, count))
        shares = np.cumsum(power * factor[of_light]).astype(np.float32)
        shares[-1] = 1.0
        sky_chance = float(shares[-1] - (shares[-2] if len(shares) > 1 else 0)) if sky else 0.0
        density = np.pi * radiance * sides * factor[len(punctual) : -1]
        return cls(records, shares, density.astype(np.float32), sky_chance)


def _chance_by_power(power: np.ndarray) -> np.ndarray:
    """By what the power of each light, (lights,), is multiplied to give its chance of being sampled."""
    shines = power > 0
    chance = (1 - _ALIKE) * power / power.sum() + _ALIKE * shines / shines.sum()
    return np.where(shines, chance / np.where(shines, power, 1.0), 0.0)


def picture_shares(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cumulative shares of an equirectangular picture's light: of the rows (h,), and of the pixels within each row (h, w),
    both float32. picture: (h, w, 3). Each pixel counts with its neighbours, into which bilinear lookups spread it."""
    weight = np.maximum(picture @ _LUMINANCE, 0.0)
    weight = weight + 0.5 * (np.roll(weight, 1, axis=1) + np.roll(weight, -1, axis=1))
    padded = np.pad(weight, ((1, 1), (0, 0)), mode="edge")
    weight = padded[1:-1] + 0.5 * (padded[:-2] + padded[2:])
    height = len(weight)
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    heights = edges[:-1] - edges[1:]
    rows = weight.sum(axis=1) * heights
    rows = rows if rows.any() else heights  # a black sky: never sampled, but looked up
    columns = np.cumsum(np.where(weight.sum(axis=1, keepdims=True) > 0, weight, 1.0), axis=1)
    columns = (columns / columns[:, -1:]).astype(np.float32)
    rows = (np.cumsum(rows) / rows.sum()).astype(np.float32)
    rows[-1] = columns[:, -1] = 1.0
    return rows, columns


def picture_density(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """(h, w) float32: with which density per solid angle a picture's directions are found by these shares."""
    height, width = columns.shape
    of_row = np.diff(rows.astype(np.float64), prepend=0.0)
    of_column = np.diff(columns.astype(np.float64), axis=1, prepend=0.0)
    edges = np.cos(np.pi * np.arange(height + 1) / height)
    angle = 2 * np.pi / width * (edges[:-1] - edges[1:])
    return (of_column * (of_row / angle)[:, None]).astype(np.float32)


def _is_sampled(picture: np.ndarray) -> bool:
    """A sky of one colour is found best by the surfaces' own rays."""
    return picture.shape[:2] != (1, 1) and bool((picture @ _LUMINANCE).any())


def _mean_sky(picture: np.ndarray) -> float:
    """Mean luminance over the sphere, times pi: the irradiance of a surface that is turned every way."""
    rows = np.cos(np.pi * np.arange(len(picture) + 1) / len(picture))
    share = 0.5 * (rows[:-1] - rows[1:])
    return float(np.pi * ((picture @ _LUMINANCE).mean(axis=1) * share).sum())


def _mean_radiance(scene: Scene, index: int) -> float:
    material = scene.materials[index]
    if "emission" in material.driven:  # of which the mean is not known: rays find it by themselves
        return 0.0
    color = np.asarray(material.emission, np.float64)
    if material.emission_texture is not None and color.any():
        color = color * mean_color(scene.textures[material.emission_texture.index])
    return float(color @ _LUMINANCE)


def _emissive_triangles(geometry: Geometry, is_emissive: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Records, world-space areas and materials of the emissive triangles of all instances."""
    parts = []
    for instance, mesh in enumerate(geometry.instance_mesh):
        first, last = geometry.first_triangle[mesh], geometry.first_triangle[mesh + 1]
        primitive = np.flatnonzero(is_emissive[geometry.material[first:last]])
        if not len(primitive):
            continue
        corners = geometry.positions[geometry.triangles[first + primitive]].astype(np.float64)
        matrix = geometry.to_world[instance, :, :3].astype(np.float64)
        edge1, edge2 = (corners[:, 1] - corners[:, 0]) @ matrix.T, (corners[:, 2] - corners[:, 0]) @ matrix.T
        records = np.zeros(len(primitive), STRUCTS["Emitter"])
        material = geometry.material[first + primitive]
        records["kind"], records["instance"], records["primitive"] = _TRIANGLE, instance, primitive
        records["material"] = material
        records["position"] = corners[:, 0] @ matrix.T + geometry.to_world[instance, :, 3]
        records["direction"], records["power"] = edge1, edge2
        records["cone"][:, 0] = np.sign(np.linalg.det(matrix))
        area = 0.5 * np.linalg.norm(np.cross(edge1, edge2), axis=1)
        parts.append((records, area, material))
    if not parts:
        return np.zeros(0, STRUCTS["Emitter"]), np.zeros(0), np.zeros(0, np.int64)
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))


def _punctual_records(lights: tuple[Light, ...], time: float) -> np.ndarray:
    records = np.zeros(len(lights), STRUCTS["Emitter"])
    for record, light in zip(records, lights, strict=True):
        pose = pose_at(light.motion, time) if light.motion else np.eye(3, 4)
        if isinstance(light, DirectionalLight):
            direction = pose[:, :3] @ light.direction
            record["kind"], record["power"] = _DIRECTIONAL, light.irradiance
            record["direction"] = -direction / np.linalg.norm(direction)
            continue
        record["kind"], record["power"], record["cone"] = _POINT, light.intensity, (0.0, 1.0)
        record["position"] = pose[:, :3] @ light.position + pose[:, 3]
        if isinstance(light, SpotLight):
            axis = pose[:, :3] @ light.direction
            inner, outer = np.cos(light.inner_angle), np.cos(light.outer_angle)
            slope = 1.0 / max(inner - outer, 1e-4)
            record["direction"], record["cone"] = axis / np.linalg.norm(axis), (slope, -outer * slope)
    return records


def _punctual_power(light: Light, cross_section: float) -> float:
    if isinstance(light, DirectionalLight):
        return cross_section * float(np.asarray(light.irradiance) @ _LUMINANCE)
    part = 4 * np.pi
    if isinstance(light, SpotLight):
        part = 2 * np.pi * (1 - 0.5 * (np.cos(light.inner_angle) + np.cos(light.outer_angle)))
    return part * float(np.asarray(light.intensity) @ _LUMINANCE)
