"""Run kernels under Oclgrind, a simulator that reports data races, accesses out of bounds, and uninitialised values.

    python tools/race_check.py            every case
    python tools/race_check.py CASE ...   some: trees, render, ...

Each case runs in a process of its own, on scenes of a few dozen triangles and rays, for the simulator is slow. Exit code: 0
if it reports nothing, 1 if it reports something (printed), 2 if Oclgrind or a case is missing.

Oclgrind (Debian package `oclgrind`) is found by its command. The loader is shown its driver and no other; the
command's own way, a library loaded ahead of all others, does not reach the loader that PyOpenCL's wheels bring.

The cases `racy`, `outside` and `uninitialised` hold one defect each, and are left out unless named: they show that
reports arrive. Oclgrind takes compare-and-exchange for synchronisation, and so passes over races beside it.

Its search for uninitialised values (version 21.10) has faults of its own, which `suit_oclgrind` goes round: it fails on what
the compiler's optimiser makes (loops over float3, `freeze`), takes a new buffer for the released one whose number
it has, and does not see that a fill initialises.
"""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TIME_LIMIT = 300  # seconds for a case; the slowest takes about 20

# A report is a line and what is indented below it.
REPORT = re.compile(r"^\S.*\n(?:\t.*\n)+", re.MULTILINE)
# PyOpenCL asks devices for properties of vendors' extensions, and takes a refusal for an answer. Of vectors of sixteen, of
# which traversal and the temporal filters are made, the simulator calls some uninitialised that are not: where one of the
# rays is none, all; of shorter vectors taken from a longer one, some.
HARMLESS = re.compile(
    r"Function: clGetDeviceInfo"
    r"|(uninitialized value|Uninitialized address used to (read from|write to) private memory address \w+)"
    r"\n\tKernel: (closest|any)_hit"
    r"|(uninitialized value|Uninitialized value written to global memory address \w+)"
    r"\n\tKernel: (lay_out|filter|show_effective)\n"
)


def driver() -> Path | None:
    """Oclgrind's library for OpenCL loaders, if it is installed."""
    command = shutil.which("oclgrind")
    if command is None:
        return None
    found = sorted(Path(command).resolve().parent.parent.glob("lib*/**/liboclgrind-rt-icd.so"))
    return found[0] if found else None


def run(case: str) -> list[str]:
    """Run a case under Oclgrind in a child process: its reports, each of several lines.

    Raises RuntimeError if the case itself failed.
    """
    environment = {
        **os.environ,
        "OCL_ICD_VENDORS": str(driver()),
        "OCLGRIND_CHECK_API": "1",
        "OCLGRIND_DATA_RACES": "1",
        "OCLGRIND_UNINITIALIZED": "1",
        "PYOPENCL_BUILD_OPTIONS": "-cl-opt-disable -DINLINED=inline -DNO_PREFETCH",
        "PYOPENCL_NO_CACHE": "1",
        "PYTHONPATH": os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")])),
    }
    environment.pop("CLCACHE_DEVICE", None)
    command = [sys.executable, __file__, "--here", case]
    child = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=TIME_LIMIT)
    reports = [r for r in REPORT.findall(child.stderr) if not HARMLESS.search(r)]
    if child.returncode or f"{case} is done" not in child.stdout:
        raise RuntimeError(f"case {case} failed under Oclgrind:\n{child.stdout}{child.stderr}")
    return reports


def suit_oclgrind() -> None:
    """Keep every buffer until the process ends, and fill buffers by copies."""
    import numpy as np
    import pyopencl as cl

    from clcache.device import Device

    kept, empty = [], Device.empty

    def keep(device: Device, *arguments: object):
        kept.append(empty(device, *arguments))
        return kept[-1]

    def fill(queue: cl.CommandQueue, buffer: cl.Buffer, pattern: np.generic, offset: int, size: int) -> cl.Event:
        return cl.enqueue_copy(queue, buffer, np.full(size // pattern.nbytes, pattern), dst_offset=offset)

    Device.empty, Device.release, cl.enqueue_fill_buffer = keep, lambda device, *arrays: None, fill


def _grid(n: int, height: float):
    """A wavy sheet of 2 n^2 triangles."""
    import numpy as np

    x, z = np.meshgrid(np.linspace(-1, 1, n + 1), np.linspace(-1, 1, n + 1))
    positions = np.column_stack([x.ravel(), height + 0.2 * np.sin(3 * x.ravel() * z.ravel()), z.ravel()])
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).reshape(-1, 1)
    triangles = np.vstack([first + [0, n + 1, n + 2], first + [0, n + 2, 1]])
    return positions.astype(np.float32), triangles.astype(np.uint32)


def _scene():
    """A sheet with normals and a texture, a smaller one placed twice, and a mesh of a single triangle."""
    import numpy as np

    from clcache.scene.model import (
        Camera,
        DirectionalLight,
        Environment,
        Instance,
        Material,
        Mesh,
        PointLight,
        Scene,
        Texture,
        TextureUse,
    )

    lamp = (np.float32([[-0.3, 1.5, 0], [0.3, 1.5, 0], [0, 1.5, 0.3]]), np.uint32([[0, 1, 2]]))
    shapes = [_grid(4, 0.0), _grid(2, 0.5), lamp]
    use = TextureUse(0)
    rough = {"metallic": 0.3, "roughness": 0.5, "metallic_roughness_texture": use, "normal_texture": use}
    materials = (
        Material("checked", base_color_texture=use, alpha_cutoff=0.2, specular=1.0, **rough),
        Material("glass", roughness=0.3, specular=1.0, transmission=0.5),
        Material("lamp", emission=(5.0, 5.0, 5.0)),
    )
    meshes = [
        Mesh(m.name, p, t, np.full(len(t), k, np.uint32))
        for k, (m, (p, t)) in enumerate(zip(materials, shapes, strict=True))
    ]
    up = np.tile(np.float32([0, 1, 0]), (len(meshes[0].positions), 1))
    meshes[0] = replace(meshes[0], normals=up, uvs=3 * meshes[0].positions[:, [0, 2]])
    pixels = np.random.default_rng(2).integers(0, 256, (3, 2, 4), dtype=np.uint8)
    aside = np.column_stack([0.5 * np.eye(3), [0.4, 0.2, 0.1]])
    camera = Camera(np.column_stack([np.eye(3), [0, 0.5, 3]]), 0.9)
    return Scene(
        file="race_check",
        meshes=tuple(meshes),
        instances=(Instance("a", 0), Instance("b", 1), Instance("c", 1, aside), Instance("lamp", 2)),
        materials=materials,
        textures=(Texture("noise", pixels, wrap=("repeat", "mirror")),),
        lights=(PointLight((0.0, 2.0, 0.0), (3.0, 3.0, 3.0)), DirectionalLight((0.0, -1.0, 0.0), (1.0, 1.0, 1.0))),
        environment=Environment(np.random.default_rng(3).uniform(0.2, 1, (4, 8, 3)).astype(np.float32)),
        camera=camera,
    )


def trees() -> None:
    """Build the trees of a scene (cl/bvh/build.cl), and trace 30 rays both ways (cl/bvh/trace.cl)."""
    import numpy as np

    from clcache.bvh import MISS, Tracer
    from clcache.device import Device

    tracer = Tracer(_scene(), Device("oclgrind", local_size=8))
    rng = np.random.default_rng(1)
    origins = rng.uniform(-1, 1, (30, 3)) + [0, 2, 0]
    directions = rng.uniform(-1, 1, (30, 3)) - origins
    hits = tracer.closest_hit(origins, directions, t_max=0.8)
    occluded = tracer.any_hit(origins, directions, t_max=0.8)
    assert 5 < np.count_nonzero(occluded) < 30
    assert np.array_equal(occluded, hits["instance"] != MISS)


def render() -> None:
    """Path trace 4 x 3 pixels (cl/pathtrace, cl/scene): lights, emission, two bounces, both eyes."""
    from clcache.renderer import Renderer

    # Oclgrind 21.10 ends with a segmentation fault on the Sobol sampler, which touches no memory.
    settings = {"pathtrace.sampler": "independent", "pathtrace.bounces": 2, "device.local_size": 8}
    options = {"size": (4, 3), "spp": 1, "stereo": True, "aovs": ("albedo", "N", "Z", "variance"), "device": "oclgrind"}
    renderer = Renderer(_scene(), settings=settings, **options)
    (frame,) = renderer.frames(0, 1)
    assert all(0 < color.mean() < 100 for color in frame.color.values())


_OF_SAMPLES = ("albedo", "N", "Z", "variance", "samples", "occupancy", "visible", "age", "trace")
_OF_VOXELS = ("albedo", "N", "Z", "samples", "voxel", "level", "count", "age", "alpha", "effective", "beta")


def _cached(
    method: str,
    stereo_blend: str | None = None,
    temporal: str | None = None,
    aovs: tuple[str, ...] = _OF_SAMPLES,
    lost: tuple[str, ...] = ("dropped", "overflow", "stolen"),
    **settings: object,
) -> None:
    """Three frames of 6 x 5 pixels from a camera that moves, and of instances that do. lost: counters of which one at least is to
    count something. settings: by dotted name, or the last name of samplecache's."""
    from dataclasses import replace

    import numpy as np

    from clcache.renderer import Renderer
    from clcache.scene.model import Track

    scene, seconds = _scene(), np.array([0.0, 1.0])
    still, size = np.array([[0, 0, 0, 1.0], [0, 0, 0, 1.0]]), np.ones((2, 3))
    path = Track(seconds, np.array([[0, 0.5, 3], [0.6, 0.7, 1.5]]), still, size)
    fall = Track(seconds, np.array([[0, 0.3, 0.5], [0.2, 0, 0]]), still, size)
    moving = (*scene.instances[:1], replace(scene.instances[1], motion=(fall,)), *scene.instances[2:])
    scene = replace(
        scene, instances=moving, camera=replace(scene.camera, motion=(path,)), defaults=replace(scene.defaults, fps=6.0)
    )
    settings = {name if "." in name else f"samplecache.{name}": value for name, value in settings.items()}
    settings |= {"isrt.superresolution": 2}
    settings |= {"pathtrace.sampler": "independent", "pathtrace.bounces": 0, "device.local_size": 8}
    options = {"size": (6, 5), "stereo": stereo_blend is not None, "stereo_blend": stereo_blend, "aovs": aovs}
    options["temporal"] = temporal
    frames = list(Renderer(scene, method, settings=settings, device="oclgrind", **options).frames(0, 3))
    assert all(0 < color.mean() < 100 for color in frames[-1].color.values())
    assert sum(eye["cache"][name] for f in frames for eye in f.stats["eyes"].values() for name in lost) > 0


def samplecache() -> None:
    """Reproject, trace, shade and blend cached samples (cl/samplecache), so few to a pixel that some are lost."""
    _cached("samplecache", "samples", slots=2, target=2.0, tolerance=0.0, shading="adaptive", shading_rate=0.7)


def two_pass() -> None:
    """The same where slots are for those who come first, in two passes; of one eye; albedo apart."""
    _cached("samplecache", slots=2, target=2.0, tolerance=0.0, reprojection="two-pass", demodulate=True)


def isrt() -> None:
    """The same where slots are places in the pixel."""
    _cached("isrt", target=3.0)


def voxelhash() -> None:
    """Voxels in a table that is too small (cl/voxelhash), some hits too near for them, and both filters after them (cl/filter)."""
    table = {"voxelhash.capacity": 2, "voxelhash.lifetime": 1}
    _cached("voxelhash", "varianceblend", "varianceblend", _OF_VOXELS, ("discarded",), **table)


def hybrid() -> None:
    """The same at cached first hits, with room enough, however near."""
    table = {"voxelhash.capacity": 256, "voxelhash.gate": False}
    few = {"slots": 2, "target": 2.0, "tolerance": 0.0}
    _cached("hybrid", "constant", "taa", ("albedo", "N", "Z", "samples", "trace"), **few, **table)


def lanes() -> None:
    """What lanes tell each other (cl/common/lane_group.cl)."""
    import numpy as np

    from clcache.device import Device
    from clcache.probe import lanes_expected

    device = Device("oclgrind")
    source = '#include "common/lane_group.cl"\n#include "probe_lanes.cl"\n'
    values = np.random.default_rng(1).integers(0, 2**32, 96, dtype=np.uint32)
    found = device.empty((7, 96), np.uint32)
    device.program("lanes.cl", {"lanes.cl": source})["probe"].run(
        96, {"value": device.upload(values), "found": found}, n=96
    )
    assert np.array_equal(found.get(), lanes_expected(values))


def tiles() -> None:
    """A group of lanes builds tiles (cl/memo/tile.cl), finds them again, and meets those of others in their places. (Groups that run
    at once race for the table by design; so there is one.)"""
    import numpy as np

    from clcache.device import Device
    from clcache.passes.tiles import tile_buffers, tile_defines
    from clcache.settings import SETTINGS

    device, n, capacity, channels = Device("oclgrind"), 30, 40, 5
    graph = """
#include "graph/types.cl"
#include "scene/maps.cl"

NOINLINE void evaluate_graph(uint graph, const GraphInputs *in, const Maps *maps, float *out)
{
    for (uint c = 0; c < 3 + graph; c++) out[c] = in->uv.v.x + (float)c;
}
"""
    chosen = {"memo.tile": "3x3", "memo.filter": "bilinear", "memo.builder": "lanes", "memo.grouped": True}
    settings = {name: s.default for name, s in SETTINGS.items()} | chosen
    table = {"READ_COUNTER": 1, "EVICTION": 3, "HALF": 0, "VALUE_WORDS": channels, "RECORD_WORDS": 4, "TILED": 1}
    defines = {**table, **tile_defines(settings, 4, channels), "GRAPH_CHANNELS": channels, "NATIVE_SUBGROUPS": 0}
    kernel = device.program("memo/tile.cl", {"graph/generated.cl": graph}, **defines)["look_up_tiles"]
    kept = {b.name: np.zeros(b.shape, b.dtype) for b in tile_buffers(settings, channels, capacity, n) if b.persistent}
    kept |= {"memo_records": np.zeros((capacity, defines["RECORD_STRIDE"]), np.uint32)}
    kept |= {"memo_counters": np.zeros(10, np.uint32), "memo_graph_count": np.zeros((3, 2), np.uint32)}
    arrays = {name: device.upload(values) for name, values in kept.items()}
    hits, values = np.arange(n), device.upload(np.zeros((channels, n), np.float32))
    for first in (0, 0, 30):
        tile, levels = first + hits // 2, np.full(n, 28 | 28 << 8)  # the footprint's and the texels': 2^-4
        requests = {
            "alive": np.uint32([n]),
            "memo_place": np.uint32(tile % capacity),
            "memo_check": np.uint32(tile + 100),
            "memo_cell": np.int32([tile, -tile, levels, hits // 2 % 3]),
            "memo_within": np.float32([hits % 5 / 4, hits % 3 / 2]),
        }
        sent = {name: device.upload(array) for name, array in requests.items()}
        scalars = {"capacity": capacity, "probe": 1, "stamp": first + 1, "turn": 0, "turns": 1, "n": n}
        kernel.run(n, sent, arrays, graph_value=values, **scalars)
        assert np.array_equal(values.get()[0], (2 * tile + hits % 5 / 4 + 0.5) / 16)
    lookups, found, inserted, evicted = arrays["memo_counters"].get()[:4].tolist()
    assert (lookups, found, inserted) == (3 * n, n, n) and evicted == 5


_GRAPH = """
UVInput Out>0; Float2Constant 9 7 Out>1; Dot A<0 B<1 Out>2; Fract In<2 Out>3; RoughnessOutput In<3;
Float3Constant 0.3 0.6 0.9 Out>4; Mul A<3 B<4 Out>5; ColorOutput In<5;
"""


def _graphs(memo: str, size: tuple[int, int] = (4, 4), **settings: object) -> None:
    """Two frames, of both eyes, of materials by graph, kept in a table so small that entries are evicted."""
    import numpy as np

    from clcache.graph import compile_graph
    from clcache.graph.library import library
    from clcache.graph.text import parse
    from clcache.renderer import Renderer
    from clcache.scene.model import Material

    scene = _scene()
    texts = {
        "of coordinates": _GRAPH,
        "of places": _GRAPH.replace("UV", "Position").replace("Float2Constant 9 7", "Float3Constant 9 7 5"),
    }
    by_graph = [
        Material(n, specular=1.0, graph=compile_graph(parse(t, f"{n}.graph", library()))) for n, t in texts.items()
    ]
    scene = replace(scene, materials=(*by_graph, scene.materials[2]))
    if memo == "texel":  # half of the sheet is a single texel, so that some are found again
        sheet, *others = scene.meshes
        uvs = sheet.uvs * np.float32(sheet.uvs[:, :1] > 0)
        scene = replace(scene, meshes=(replace(sheet, uvs=uvs), *others))
    settings = {f"memo.{name}": value for name, value in settings.items()}
    settings |= {
        "memo.auto": False,
        "memo.capacity": 8,
        "memo.probe": 2,
        "pathtrace.sampler": "independent",
        "pathtrace.bounces": 1,
    }
    settings |= {"device.local_size": 8}
    renderer = Renderer(scene, size=size, spp=1, stereo=True, memo=memo, settings=settings, device="oclgrind")
    values = renderer._graph.of("left")["graph_value"]
    values.set(
        np.zeros(values.shape, values.dtype)
    )  # where rays miss, whoever shades reads them all the same, to no effect
    frames = list(renderer.frames(0, 2))
    assert all(0 < color.mean() < 100 for color in frames[-1].color.values())
    counted = [eye["memo"] for frame in frames for eye in frame.stats["eyes"].values()]
    assert all(sum(eye[name] for eye in counted) > 0 for name in ("hits", "inserted", "evicted"))


def graph_texels() -> None:
    """What graphs return, kept by texels (cl/memo): of so few hits that one work-item sees them all, for what several do at once races by
    design (`graph_texels_at_once`)."""
    _graphs("texel", eviction="lru-counter")


def graph_texels_as_halves() -> None:
    """The same at the hits themselves, in half precision."""
    _graphs("texel", snap=False, precision="half", read="key", eviction="random")


def graph_tiles() -> None:
    """The same by tiles, which one work-item builds."""
    _graphs("tile", tile="2x2")


def graph_tiles_in_entries() -> None:
    """The same of tiles that overlap, beside their keys."""
    _graphs("tile", tile="3x3", layout="entry", filter="bilinear", precision="half")


def graph_texels_at_once() -> None:
    """Texels of more hits, by many: it races by design, and so is left out unless named."""
    _graphs("texel", (12, 8))


def single_pass() -> None:
    """The same in one pass, which races by design, and so is left out unless named."""
    _cached("samplecache", slots=2, target=2.0, tolerance=0.0, reprojection="single-pass")


def _defect(source: str, elements: int, fill: bool = True) -> None:
    import numpy as np
    import pyopencl as cl

    context = cl.create_some_context(interactive=False)
    queue = cl.CommandQueue(context)
    program = cl.Program(
        context, f"__kernel void defect(__global uint *x) {{ uint i = get_global_id(0); {source} }}"
    ).build()
    buffer = cl.Buffer(context, cl.mem_flags.READ_WRITE, 4 * elements)
    if fill:
        cl.enqueue_copy(queue, buffer, np.zeros(elements, np.uint32))
    cl.Kernel(program, "defect")(queue, (8,), (4,), buffer)
    queue.finish()


def racy() -> None:
    """A defect: all work-items write different values to one place."""
    _defect("x[0] = i;", 8)


def outside() -> None:
    """A defect: the last work-item writes beyond the end."""
    _defect("x[i + 1] = i;", 8)


def uninitialised() -> None:
    """A defect: a value that nothing wrote decides a branch."""
    _defect("if (x[i] > 3) x[i] = 1;", 8, fill=False)


CASES: dict[str, Callable[[], None]] = {
    f.__name__: f
    for f in (
        *(trees, render, samplecache, two_pass, isrt, voxelhash, hybrid, lanes, tiles),
        *(graph_texels, graph_texels_as_halves, graph_tiles, graph_tiles_in_entries),
    )
}
DEFECTS: dict[str, Callable[[], None]] = {f.__name__: f for f in (racy, outside, uninitialised)}
RACING: dict[str, Callable[[], None]] = {f.__name__: f for f in (single_pass, graph_texels_at_once)}


def main(arguments: list[str]) -> int:
    """Run the named cases, or all; the exit code."""
    known = {**CASES, **RACING, **DEFECTS}
    if arguments[:1] == ["--here"]:
        suit_oclgrind()
        known[arguments[1]]()
        print(f"{arguments[1]} is done")
        return 0
    if unknown := [a for a in arguments if a not in known]:
        print(f"unknown case {unknown[0]}; expected some of {', '.join(known)}", file=sys.stderr)
        return 2
    if driver() is None:
        print("Oclgrind is not installed; expected the Debian package oclgrind", file=sys.stderr)
        return 2
    found = False
    for case in arguments or CASES:
        reports = run(case)
        print(f"{case}: {len(reports)} reports", *reports, sep="\n")
        found = found or bool(reports)
    return int(found)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
