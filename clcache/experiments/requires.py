"""What a scene requires: what is compiled in and out for it, and what a feature costs that is there and is not used.

Kernels are specialised by defines: for what the scene has (normals, maps, masks, kinds of materials and of light, graphs, instances), and
for the settings (the mask of a pixel's slots, memoization, filters). What is compiled out takes no time; buffers that no running pass
touches are not allocated. The kind "requires" builds a method for a scene and counts both.

That alone does not say what a feature costs where it is compiled in and nothing uses it: registers, branches, arguments, passes. The kind
"unused" measures that. A thing is hidden where no ray goes, behind the walls of a black box about the scene, once with the feature and once
without, so that trees are the same; both scenes are rendered frame by frame in turn, in one process. The ratio of their
times on the device would be 1 if the feature cost nothing. Pictures should be the same, bit for bit. Where gloss is compiled in,
diffuse light is computed by other expressions, and differs in its last bit, and so now and then a path in its course. And light is drawn from what is hidden as well: a lamp
behind the wall is sampled, since nobody knows that it is hidden, and its rays are traced; of lights it is that which is measured.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..device import Device
from ..errors import Error
from ..frame import FrameGraph, Pass, Repeat
from ..graph import compile_graph
from ..graph.library import library
from ..graph.text import read_text_form
from ..methods import METHODS, MethodSetup
from ..program import Program, read_source
from ..renderer import Frame, Renderer
from ..resources import SceneResources, features
from ..scene.emitters import Emitters
from ..scene.generators import box
from ..scene.geometry import Geometry
from ..scene.model import (
    DirectionalLight,
    Environment,
    Instance,
    Material,
    Mesh,
    PointLight,
    Scene,
    SpotLight,
    Texture,
    TextureUse,
    Track,
)
from ..settings import resolve
from .configuration import Configuration
from .experiment import Calls, Claim, Column, Experiment, Plot, Table
from .job import Machine, Result, open_scene

_FAR = 30.0  # metres: where things are hidden
_BOX = 40.0  # metres: the box's edges, which are nearer
_FAINT = 1e-6  # of light that is hidden


# ---------------------------------------------------------------------------------------------------------------------
# What is compiled in and out


class _Recorder(Device):
    """A device that remembers what was built on it. built: defines and source, by program."""

    def __init__(self, *options: object) -> None:
        self.built: dict[Program, tuple[dict, str]] = {}
        super().__init__(*options)

    def program(self, name: str, generated: Mapping[str, str] | None = None, **defines: int | float | bool) -> Program:
        """As of `Device`."""
        program = super().program(name, generated, **defines)
        self.built.setdefault(program, (defines, read_source(name, generated)))
        return program


def run(parameters: Mapping, needed: Mapping[str, Result], machine: Machine) -> Result:
    """Build a method for a scene: one row. Raises SceneError, SettingError, DeviceError.

    parameters: scene; configuration; size. The columns: configuration; feature.NAME, 1 where it is compiled in; features, how many are;
    instances, whether trees have two levels; mask, bits of a pixel's mask of slots, 0 where there is none; memo, whether values of graphs are kept;
    programs, kernels, source (bytes of OpenCL C), compile (seconds, of a driver that may have some in its cache); passes, passes_out,
    buffers, buffers_out, bytes, bytes_out: those of a frame, and those that the method declares and nothing needs; bytes.PART of the scene.
    """
    scene = open_scene(parameters["scene"])
    configuration = Configuration.of(parameters["configuration"])
    device = _Recorder(machine.device, machine.threads)
    resources = SceneResources(device, scene)
    settings = resolve(scene.defaults.settings, configuration.settings)
    setup = MethodSetup(
        device, resources, tuple(parameters["size"]), settings, configuration.stereo_blend, configuration.memo
    )
    parts = METHODS[configuration.method](setup)
    outputs = {"color", "ray_counts", *(["counters"] if parts.counters else [])}
    graph = FrameGraph(device, parts.passes, parts.buffers, outputs, exchanged=parts.exchanged)
    defines = {name: value for known, _ in device.built.values() for name, value in known.items()}
    declared, used = sum(b.nbytes for b in parts.buffers), graph.nbytes
    row = {
        "configuration": configuration.name,
        **{f"feature.{_short(name)}": int(is_in) for name, is_in in resources.features.items()},
        "features": sum(resources.features.values()),
        "instances": int(defines["HAS_INSTANCES"]),
        "mask": 32 * int(defines.get("WORDS", 0)),
        "memo": int(parts.memo is not None),
        "programs": len(device.built),
        "kernels": sum(len(list(program)) for program in device.built),
        "source": sum(len(source.encode()) for _, source in device.built.values()),
        "compile": device.compile_seconds,
        "passes": _count(graph.passes),
        "passes_out": _count(parts.passes) - _count(graph.passes),
        "buffers": len(graph.buffers),
        "buffers_out": len(parts.buffers) - len(graph.buffers),
        "bytes": used,
        "bytes_out": declared - used,
        "bytes.normals": _nbytes(resources, "normals"),
        "bytes.textures": _nbytes(resources, "uvs", "uses", "textures", "texels", "srgb"),
        "bytes.emitters": _nbytes(resources, "emitter_list", "shares"),
        "bytes.sky": _nbytes(resources, "sky", "sky_rows", "sky_columns", "sky_density", "sky_edges"),
    }
    return Result([row])


def features_of(scene: Scene) -> dict[str, bool]:
    """What a scene uses, by the defines that compile it in; without a device."""
    geometry = Geometry.of(scene)
    return features(scene, geometry, Emitters.of(scene, geometry))


def _short(define: str) -> str:
    return define.removeprefix("HAS_").lower()


def _count(passes: tuple[Pass, ...] | list[Pass]) -> int:
    return sum(_count(p.passes) if isinstance(p, Repeat) else 1 for p in passes)


def _nbytes(resources: SceneResources, *names: str) -> int:
    return sum(resources.arrays[name].nbytes for name in names if name in resources.arrays)


# ---------------------------------------------------------------------------------------------------------------------
# Scenes with something hidden


@dataclass(frozen=True)
class Feature:
    """Something that scenes may have. pair: from the base scene to the scene with a hidden thing without the feature, and with it.
    switches: the defines that it switches. keeps_bits: whether pictures stay the same, to the last bit. memo: as of `Configuration`, of the
    second scene."""

    name: str
    pair: Callable[[Scene], tuple[Scene, Scene]]
    switches: tuple[str, ...] = ()
    keeps_bits: bool = True
    memo: str = "off"


def base(scene: Scene) -> Scene:
    """A scene of one eye without normals, maps, graphs, lights that are points, or meshes that are placed twice, in a black box, so that the
    only light that anything gets is that of its emissive triangles."""
    corners = box((_BOX, _BOX, _BOX))
    meshes = [replace(scene.meshes[i.mesh], normals=None, uvs=None) for i in scene.instances]
    instances = [replace(instance, mesh=number) for number, instance in enumerate(scene.instances)]
    bare = replace(
        scene,
        meshes=tuple(meshes),
        instances=tuple(instances),
        lights=(),
        environment=Environment.constant((_FAINT,) * 3),
        defaults=replace(scene.defaults, stereo=False),
    )
    return _with_mesh(bare, Mesh("box", *_typed(corners.positions, corners.triangles)), Material("black", (0.0,) * 3))


def _typed(positions: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.float32(positions), np.uint32(triangles), np.zeros(len(triangles), np.uint32)


def _with_mesh(scene: Scene, mesh: Mesh, material: Material, *instances: Instance) -> Scene:
    """The scene with one more mesh, which is of one more material, once or at these places."""
    mesh = replace(mesh, material=np.full(len(mesh.triangles), len(scene.materials), np.uint32))
    placed = instances or (Instance(mesh.name, 0),)
    return replace(
        scene,
        meshes=(*scene.meshes, mesh),
        materials=(*scene.materials, material),
        instances=(*scene.instances, *(replace(i, mesh=len(scene.meshes)) for i in placed)),
    )


def _triangle(offset: float = 0.0) -> Mesh:
    """A small triangle behind the box, with texture coordinates."""
    corners = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]]) + [offset, 0, -_FAR]
    uvs = np.float32([[0, 0], [1, 0], [0, 1]])
    return replace(Mesh("hidden", *_typed(corners, np.array([[0, 1, 2]]))), uvs=uvs)


def _hiding(**values: object) -> Callable[[Scene], tuple[Scene, Scene]]:
    """A pair that differs in what the hidden triangle is of. values: of its material."""
    return _hiding_beside({}, values)


def _hiding_beside(common: Mapping, values: Mapping) -> Callable[[Scene], tuple[Scene, Scene]]:
    """The same, where both materials have something in common."""

    def pair(scene: Scene) -> tuple[Scene, Scene]:
        white = Texture("white", np.full((4, 4, 4), 255, np.uint8))
        plain, special = (
            _with_mesh(scene, _triangle(), Material("hidden", **common, **own)) for own in ({}, dict(values))
        )
        return plain, replace(special, textures=(*special.textures, white)) if _has_map(values) else special

    return pair


def _has_map(values: Mapping) -> bool:
    return any(isinstance(value, TextureUse) for value in values.values())


def _normals(scene: Scene) -> tuple[Scene, Scene]:
    smooth = replace(_triangle(), normals=np.float32([[0, 0, 1]] * 3))
    return tuple(_with_mesh(scene, mesh, Material("hidden")) for mesh in (_triangle(), smooth))


def _light(light: object) -> Callable[[Scene], tuple[Scene, Scene]]:
    return lambda scene: (scene, replace(scene, lights=(light,)))


def _point_lit(scene: Scene) -> Scene:
    """The scene with a point light in place of all that emits."""
    dark = tuple(replace(m, emission=(0.0, 0.0, 0.0)) for m in scene.materials)
    lamp = PointLight((0.0, 2.0, 0.0), (5.0, 5.0, 5.0))
    return replace(scene, materials=dark, lights=(lamp,), environment=Environment())


def _emissive(scene: Scene) -> tuple[Scene, Scene]:
    return _hiding(emission=(_FAINT,) * 3)(_point_lit(scene))


def _environment(scene: Scene) -> tuple[Scene, Scene]:
    lit = _point_lit(scene)
    return lit, replace(lit, environment=Environment.constant((_FAINT,) * 3))


def _sky(scene: Scene) -> tuple[Scene, Scene]:
    return scene, replace(scene, environment=Environment(np.full((8, 16, 3), _FAINT, np.float32)))


def _instances(scene: Scene) -> tuple[Scene, Scene]:
    once = _with_mesh(scene, _triangle(), Material("hidden"))
    once = _with_mesh(once, _triangle(1.0), Material("hidden again"))
    aside = np.eye(4)[:3]
    aside[0, 3] = 1.0
    twice = _with_mesh(scene, _triangle(), Material("hidden"), Instance("one", 0), Instance("other", 0, aside))
    return once, twice


def _moving(scene: Scene) -> tuple[Scene, Scene]:
    times = np.array([0.0, 100.0])
    track = Track(times, np.array([[0.0] * 3, [1.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 0.0, 1.0]] * 2), np.ones((2, 3)))
    still, moving = (
        _with_mesh(scene, _triangle(), Material("hidden"), Instance("hidden", 0, motion=motion))
        for motion in ((), (track,))
    )
    return still, moving


def _graph_material(scene: Scene) -> Scene:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "hidden.graph"
        file.write_text("PositionInput Out>0; Float1Constant 8 Out>1; Mul A<0 B<1 Out>2; ColorOutput In<2;")
        graph = compile_graph(read_text_form(file, file.name, library()))
    return _with_mesh(scene, _triangle(), Material("hidden", graph=graph))


def _graphs(scene: Scene) -> tuple[Scene, Scene]:
    return _with_mesh(scene, _triangle(), Material("hidden")), _graph_material(scene)


def _memo(scene: Scene) -> tuple[Scene, Scene]:
    both = _graph_material(scene)
    return both, both


_MAP = TextureUse(0)
FEATURES = {
    f.name: f
    for f in (
        Feature("normals", _normals, ("HAS_NORMALS",)),
        Feature("base colour maps", _hiding(base_color_texture=_MAP), ("HAS_TEXTURES", "HAS_BASE_COLOR_MAPS")),
        Feature(
            "metallic-roughness maps",
            _hiding(metallic_roughness_texture=_MAP),
            ("HAS_TEXTURES", "HAS_METALLIC_ROUGHNESS_MAPS"),
        ),
        Feature("emission maps", _hiding(emission_texture=_MAP), ("HAS_TEXTURES", "HAS_EMISSION_MAPS")),
        Feature("normal maps", _hiding(normal_texture=_MAP), ("HAS_TEXTURES", "HAS_NORMAL_MAPS")),
        Feature("alpha masks", _hiding(alpha_cutoff=0.5), ("HAS_ALPHA",)),
        Feature(
            "holes in lamps",
            _hiding_beside({"emission": (_FAINT,) * 3}, {"alpha_cutoff": 0.5}),
            ("HAS_ALPHA", "HAS_LAMP_HOLES"),
        ),
        Feature("specular reflection", _hiding(specular=1.0, roughness=0.3), ("HAS_SPECULAR",), keeps_bits=False),
        Feature(
            "transmission",
            _hiding(transmission=1.0, roughness=0.0),
            ("HAS_SPECULAR", "HAS_TRANSMISSION"),
            keeps_bits=False,
        ),
        Feature("graphs", _graphs, ("HAS_GRAPHS", "HAS_TEXTURES")),
        Feature("memoized graphs", _memo, memo="texel"),
        Feature("instances", _instances),
        Feature("moving instances", _moving),
        Feature("emissive triangles", _emissive, ("HAS_EMISSIVE", "HAS_EMISSION"), keeps_bits=False),
        Feature("environment", _environment, ("HAS_EMISSION",)),
        Feature("environment picture", _sky, ("HAS_SKY_PICTURE",), keeps_bits=False),
        Feature(
            "point lights", _light(PointLight((0.0, 0.0, -_FAR), (_FAINT,) * 3)), ("HAS_PUNCTUAL",), keeps_bits=False
        ),
        Feature(
            "spot lights",
            _light(SpotLight((0.0, 0.0, -_FAR), (0.0, 0.0, 1.0), (_FAINT,) * 3, 0.1, 0.2)),
            ("HAS_PUNCTUAL",),
            keeps_bits=False,
        ),
        Feature(
            "directional lights",
            _light(DirectionalLight((0.0, 0.0, 1.0), (_FAINT,) * 3)),
            ("HAS_PUNCTUAL",),
            keeps_bits=False,
        ),
    )
}


# ---------------------------------------------------------------------------------------------------------------------
# What a hidden thing costs


@dataclass(frozen=True)
class _Side:
    """One of the two that are compared: its renderer, and what was seen of it."""

    renderer: Renderer
    seconds: list[float] = field(default_factory=list)
    pictures: list[np.ndarray] = field(default_factory=list)

    def add(self, frame: Frame) -> None:
        """Note a frame's time, and keep its picture."""
        eye = frame.stats["eyes"]["mono"]
        self.seconds.append(sum(eye["passes"].values()))
        self.pictures.append(frame.color["mono"])


def run_unused(parameters: Mapping, needed: Mapping[str, Result], machine: Machine) -> Result:
    """Render a base scene with something hidden, with a feature and without: one row. Raises SceneError, SettingError, DeviceError, Error.

    parameters: scene, of which `base` is made; feature, one of FEATURES; configuration; size; frames, of which `skip` count for nothing;
    seed; cold: whether to measure how long the kernels take to build. The columns: configuration (with the feature's name); method;
    feature; ratio, the geometric mean over frames of the times on the device with the feature by those without; within, the standard error
    of that over frames; device.with, device.without, seconds; same, 1 where all pictures are the same bits; difference, the largest between them; bytes, what the
    feature takes more of the device's memory; compile.with, compile.without, seconds of a process whose driver has an empty cache.
    """
    feature = FEATURES[parameters["feature"]]
    configuration = Configuration.of(parameters["configuration"])
    scenes = feature.pair(base(open_scene(parameters["scene"])))
    memos = ("off", feature.memo)
    sides = [
        _Side(_renderer(scene, configuration, memo, parameters, machine))
        for scene, memo in zip(scenes, memos, strict=True)
    ]
    frames = [side.renderer.frames(0, parameters["frames"]) for side in sides]
    for number in range(parameters["frames"]):
        for which in (0, 1) if number % 2 else (1, 0):
            sides[which].add(next(frames[which]))
    without, with_it = (side.seconds[parameters["skip"] :] for side in sides)
    logs = np.log(with_it) - np.log(without)
    row = {
        "configuration": f"{configuration.name}: {feature.name}",
        "method": configuration.name,
        "feature": feature.name,
        "ratio": float(np.exp(logs.mean())),
        "within": float(np.exp(logs.mean()) * logs.std(ddof=1) / np.sqrt(len(logs))),
        "device.without": statistics.median(without),
        "device.with": statistics.median(with_it),
        "same": int(all(map(np.array_equal, sides[0].pictures, sides[1].pictures))),
        "difference": float(np.abs(np.array(sides[0].pictures) - sides[1].pictures).max()),
        "bytes": sides[1].renderer.device.allocated - sides[0].renderer.device.allocated,
    }
    if parameters["cold"]:
        for name, which in (("without", 0), ("with", 1)):
            row[f"compile.{name}"] = _cold_compile_seconds(parameters, which, machine)
    return Result([row])


def _renderer(scene: Scene, configuration: Configuration, memo: str, parameters: Mapping, machine: Machine) -> Renderer:
    settings = {"memo.auto": False} if memo != "off" else {}
    whole = replace(configuration, memo=memo, settings={**configuration.settings, **settings})
    return whole.renderer(scene, tuple(parameters["size"]), False, parameters["seed"], machine.device, machine.threads)


def _cold_compile_seconds(parameters: Mapping, which: int, machine: Machine) -> float:
    """What building takes where nothing was built before: in another process, with a cache of its own."""
    code = f"from {__name__} import compile_seconds; print(compile_seconds())"
    told = json.dumps([dict(parameters), which, machine.device, machine.threads])
    with tempfile.TemporaryDirectory() as folder:
        aside = {"POCL_CACHE_DIR": folder, "XDG_CACHE_HOME": folder, "PYOPENCL_NO_CACHE": "1"}
        done = subprocess.run(
            [sys.executable, "-c", code], input=told, env={**os.environ, **aside}, capture_output=True, text=True
        )
    try:
        return float(done.stdout.splitlines()[-1])
    except (IndexError, ValueError):
        reason = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise Error(f"a process that was to build kernels failed: {reason}") from None


def compile_seconds() -> float:
    """What building the renderer takes that stdin describes, as the process that `run_unused` starts."""
    parameters, which, device, threads = json.load(sys.stdin)
    feature, configuration = FEATURES[parameters["feature"]], Configuration.of(parameters["configuration"])
    scene = feature.pair(base(open_scene(parameters["scene"])))[which]
    memo = ("off", feature.memo)[which]
    renderer = _renderer(scene, configuration, memo, parameters, Machine(device, threads))
    return renderer.stats()["seconds"]["compile"]


# ---------------------------------------------------------------------------------------------------------------------
# The experiments

_SCENES = (
    *("atrium", "city", "classroom", "cornell", "fence", "graphs", "hairball", "kitchen", "landscape", "spheres"),
    "spinning",
)
_METHODS = (
    Configuration("pathtrace", "pathtrace"),
    Configuration("pathtrace, memoized", "pathtrace", memo="texel"),
    Configuration("samplecache", "samplecache"),
    Configuration("samplecache, 24 slots", "samplecache", {"samplecache.slots": 24}),
    Configuration("isrt", "isrt"),
    Configuration("voxelhash", "voxelhash"),
    Configuration("hybrid", "hybrid"),
    Configuration("octree", "octree", {"octree.resolution": 256}),
)
_MEASURED = (Configuration("pathtrace", "pathtrace", spp=4), Configuration("samplecache", "samplecache"))


def _built(configuration: Configuration, size: tuple[int, int]) -> dict:
    return {"configuration": configuration.entry(), "size": list(size)}


def _unused(configuration: Configuration, feature: str, **values: object) -> dict:
    return {"configuration": configuration.entry(), "feature": feature, "skip": 2, **values}


_NAMES = [f"feature.{_short(n)}" for n in (
    *("HAS_NORMALS", "HAS_TEXTURES", "HAS_BASE_COLOR_MAPS", "HAS_METALLIC_ROUGHNESS_MAPS", "HAS_EMISSION_MAPS"),
    *("HAS_NORMAL_MAPS", "HAS_ALPHA", "HAS_LAMP_HOLES", "HAS_SPECULAR", "HAS_TRANSMISSION", "HAS_EMISSIVE"),
    *("HAS_EMISSION", "HAS_SKY_PICTURE", "HAS_DIRECT", "HAS_PUNCTUAL", "HAS_GRAPHS"),
)]  # fmt: skip

EXPERIMENTS = (
    Experiment(
        name="requires",
        source="the project's own",
        title="What is compiled in and out for each scene",
        about="For each scene of data/ and each method: which features the kernels are built with, and what the method declares that"
        " no running pass needs, and that is therefore not allocated. 1: compiled in.",
        plans=(
            Calls(
                "requires",
                tuple(_built(c, (640, 360)) for c in _METHODS),
                _SCENES,
                tuple(_built(c, (96, 54)) for c in _METHODS[:1]),
            ),
        ),
        tables=(
            Table(
                "Features that kernels are built with",
                tuple(Column(n, n.removeprefix("feature.").replace("_", " "), ".0f") for n in (*_NAMES, "instances")),
            ),
            Table(
                "Kernels and passes",
                (
                    Column("features", "features", ".0f"),
                    Column("mask", "mask of slots (bits)", ".0f"),
                    Column("memo", "memoized", ".0f"),
                    Column("programs", "programs", ".0f"),
                    Column("kernels", "kernels", ".0f"),
                    Column("source", "source (KiB)", ".0f", 1 / 1024),
                    Column("passes", "passes", ".0f"),
                    Column("passes_out", "passes left out", ".0f"),
                ),
            ),
            Table(
                "Memory, in MiB",
                (
                    Column("bytes", "buffers", ".1f", 2**-20),
                    Column("bytes_out", "buffers left out", ".1f", 2**-20),
                    Column("bytes.normals", "normals", ".2f", 2**-20),
                    Column("bytes.textures", "textures", ".2f", 2**-20),
                    Column("bytes.emitters", "emitters", ".2f", 2**-20),
                    Column("bytes.sky", "sky", ".2f", 2**-20),
                ),
            ),
        ),
    ),
    Experiment(
        name="requires-unused",
        source="the project's own",
        title="What a feature costs that is there, and that no ray meets",
        about="The Cornell box in a black box, with a thing behind that: with the feature and without, frame by frame in turn. The goal is a"
        " ratio of 1. Lights are sampled though nothing sees them, so that of them the ratio has what their shadow rays cost.",
        plans=(
            Calls(
                "unused",
                tuple(_unused(c, name, size=[320, 180], frames=26, cold=True) for c in _MEASURED for name in FEATURES),
                ("cornell",),
                tuple(
                    _unused(_MEASURED[0], name, size=[96, 54], frames=8, cold=False)
                    for name in ("normals", "alpha masks", "specular reflection")
                ),
                is_seeded=True,
            ),
        ),
        tables=(
            Table(
                "Time with the feature, by the time without",
                (
                    Column("ratio", "ratio", ".4f"),
                    Column("within", "error over frames", ".4f"),
                    Column("device.without", "without (ms)", ".2f", 1e3),
                    Column("device.with", "with (ms)", ".2f", 1e3),
                    Column("same", "same bits", ".0f"),
                    Column("difference", "largest difference", ".1e"),
                    Column("bytes", "more memory (KiB)", ".1f", 1 / 1024),
                    Column("compile.without", "building without (s)", ".2f"),
                    Column("compile.with", "building with (s)", ".2f"),
                ),
                by=("method", "feature"),
            ),
        ),
        plots=(
            Plot(
                "What a feature costs that is not used",
                "feature",
                "ratio",
                "bars",
                by="method",
                x_head="feature",
                y_head="time with it / without",
            ),
        ),
        claims=(
            *(
                Claim(
                    f"{c.name}: {name} cost at most 2 % where nothing uses them",
                    "ratio",
                    f"{c.name}: {name}",
                    high=1.02,
                )
                for c in _MEASURED
                for name in FEATURES
            ),
            *(
                Claim(f"{c.name}: {name} leave pictures the same, bit for bit", "same", f"{c.name}: {name}", low=1.0)
                for c in _MEASURED
                for name, feature in FEATURES.items()
                if feature.keeps_bits
            ),
        ),
    ),
)
