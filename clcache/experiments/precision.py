"""What float32 costs the kernels that matter: their own source, built once as it is and once in double precision, on
the same inputs.

The wrappers in cl/precision/ include the files that rendering is made of and call the functions in them. `in_double`
rewrites the text of such a program, as program.py assembles it, by rules that know no kernel: types, literals, vectors'
masks, and the constants that stand for float32's rounding. Inputs are numbers of float32 for both, so that all
differences are rounding within the kernel. Errors are in ulps, steps of float32 at the right value; or at a size that
the result is to be judged by (`scale`: the image's width for a place in it), where a result that cancels to next to
nothing is allowed to be off by the roundings of what went in. What double precision gives is compared with NumPy, which
knows the formulas from the papers only.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pyopencl as cl
import pyopencl.array as cl_array

from .. import layout
from ..device import Device
from ..errors import DeviceError
from ..program import read_source
from .experiment import Calls, Column, Experiment, Plot, Table
from .job import Machine, Result

ROWS = 200_000
QUICK_ROWS = 20_000
WIDTH, HEIGHT = 1280, 720
LOCAL_SIZE = 64

Arrays = dict[str, np.ndarray]

# In this order. Comparisons of vectors of doubles give vectors of longs.
_RULES = (
    (r"\bas_uint\(", "bits_of_narrow("),
    (r"\bas_float\(", "wide_of_bits("),
    (r"\b(|as_|convert_)float(\d*)\b", r"\1double\2"),
    (r"\b(|as_|convert_)int(8|16)\b", r"\1long\2"),
    (r"\bINT_MIN\b", "LONG_MIN"),
    (r"\b(\d+\.\d*(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)f\b", r"\1"),
)
# Constants that say how far float32 rounds, and what they are of double precision.
_ROUNDINGS = {
    "UNIT_ROUNDOFF": "1.1102230246251565e-16",
    "LEAVE_LATER": "1.000000000000001",
    "BIT_LONGER": "1.0000000000000007",
    "BIT_SHORTER": "0.9999999999999993",
}
_VECTOR = 64  # bytes of eight doubles
_WIDE = """#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef float narrow;
inline uint bits_of_narrow(double v) { return as_uint((narrow)v); }
inline double wide_of_bits(uint bits) { return as_float(bits); }
"""


def in_double(text: str) -> str:
    """A program of float32 as one of float64. Bits of numbers are still those of float32: what is made of them are
    powers of two."""
    for name, value in _ROUNDINGS.items():
        text = re.sub(rf"(#define {name}) \S+", rf"\1 {value}", text)
    text = re.sub(r"^typedef char .*\[-?.*\];$", "", text, flags=re.MULTILINE)  # the sizes of structs
    for name, dtype in layout.STRUCTS.items():
        text = text.replace(
            f"}} {name};\n",
            f"    float unused[{_padding(dtype)}];\n}} {name};\n" if _padding(dtype) else f"}} {name};\n",
        )
    for pattern, replacement in _RULES:
        text = re.sub(pattern, replacement, text)
    return _WIDE + text


def widened(dtype: np.dtype) -> np.dtype:
    """A struct or number with doubles in place of floats. Structs end at multiples of the longest vector's size, which
    arrays of them begin with."""
    if dtype.names:
        fields = [(name, widened(dtype.fields[name][0])) for name in dtype.names]
        return np.dtype(fields + ([("unused", "f8", _padding(dtype))] if _padding(dtype) else []))
    base, shape = dtype.subdtype or (dtype, ())
    return np.dtype((np.float64 if base == np.float32 else base, shape))


def _padding(dtype: np.dtype) -> int:
    """How many doubles a struct lacks; none if it is not of whole ones, of which there are no arrays here."""
    size = sum(widened(dtype.fields[name][0]).itemsize for name in dtype.names)
    return -size % _VECTOR // 8 if size % 8 == 0 else 0


class Measured:
    """A wrapper's kernel in one of the precisions. name: of the file in cl/precision/. Raises DeviceError."""

    def __init__(self, device: Device, name: str, defines: Mapping[str, int], is_wide: bool) -> None:
        text = "".join(f"#define {key} ({value})\n" for key, value in defines.items())
        text += layout.source() + read_source(f"precision/{name}.cl")
        options = ["-cl-std=CL1.2", "-w"]
        if device.capabilities.exact_division:
            options.append("-cl-fp32-correctly-rounded-divide-sqrt")
        try:
            built = cl.Program(device.context, in_double(text) if is_wide else text).build(options)
        except cl.Error as error:
            raise DeviceError(
                f"precision/{name}.cl: the driver cannot build it{' in double' if is_wide else ''}"
            ) from error
        self._kernel, self._queue, self._is_wide = cl.Kernel(built, "measure"), device.queue, is_wide

    def __call__(self, inputs: Arrays, outputs: Mapping[str, tuple], scalars: Sequence[int], items: int) -> Arrays:
        """What the kernel writes. inputs: of float32 or structs, in the order of its arguments, before outputs (shape
        and dtype), before scalars."""
        given = [self._upload(values) for values in inputs.values()]
        made = {
            name: cl_array.empty(self._queue, shape, widened(np.dtype(dtype)) if self._is_wide else np.dtype(dtype))
            for name, (shape, dtype) in outputs.items()
        }
        arguments = [a.data for a in (*given, *made.values())] + [np.uint32(s) for s in scalars]
        self._kernel(self._queue, (-(-items // LOCAL_SIZE) * LOCAL_SIZE,), (LOCAL_SIZE,), *arguments)
        return {name: array.get() for name, array in made.items()}

    def _upload(self, values: np.ndarray) -> cl_array.Array:
        if self._is_wide:
            wide = np.zeros(values.shape, widened(values.dtype))
            for name in values.dtype.names or (...,):
                wide[name] = values[name]
            values = wide
        return cl_array.to_device(self._queue, np.ascontiguousarray(values))


# ---------------------------------------------------------------------------------------------------------------------
# What is measured


@dataclass(frozen=True)
class Study:
    """A kernel that is measured. quantities: what it writes: for each, of what size its error is judged, of the inputs
    and of the right values. magnitudes: of the inputs, one after the other, and what they are. draw: inputs of a
    magnitude. model: the right values in NumPy."""

    name: str
    file: str
    quantities: Mapping[str, Callable[[Arrays, np.ndarray], np.ndarray]]
    of: str
    magnitudes: tuple[float, ...]
    draw: Callable[[np.random.Generator, int, float], Arrays]
    model: Callable[[Arrays], Arrays]
    defines: Mapping[str, int] = field(default_factory=dict)
    scalars: tuple[int, ...] = ()
    is_planar: bool = False  # outputs are planes and not rows, sixteen of each in a work-item


def itself(_inputs: Arrays, right: np.ndarray) -> np.ndarray:
    """What has no other size to be judged by."""
    return np.abs(right)


def _floats(**arrays: np.ndarray) -> Arrays:
    return {name: np.ascontiguousarray(values, dtype=np.float32) for name, values in arrays.items()}


def _rotations(rng: np.random.Generator, n: int) -> np.ndarray:
    q = rng.normal(size=(n, 4))
    x, y, z, w = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
            2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
            2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]  # fmt: skip
    return np.stack(rows, axis=1).reshape(n, 3, 3)


def _draw_points(rng: np.random.Generator, n: int, distance: float) -> Arrays:
    """Cameras so far from the origin that look about, and points that they see at 0.1 to 100 m."""
    turn, eye = _rotations(rng, n), distance * rng.uniform(-1, 1, (n, 3))
    slope = np.tan(np.radians(20))
    at = np.stack([rng.uniform(-1, 1, n) * slope * WIDTH / HEIGHT, rng.uniform(-1, 1, n) * slope, -np.ones(n)], axis=1)
    depth = 10 ** rng.uniform(-1, 2, n)
    points = eye + depth[:, None] * np.einsum("nij,nj->ni", turn, at)
    to_world = np.concatenate([turn, eye[:, :, None]], axis=2).reshape(n, 12)
    near = np.zeros((n, 1))
    cameras = np.concatenate([to_world, np.tile([slope * WIDTH / HEIGHT, slope], (n, 1)), near], axis=1)
    return _floats(cameras=cameras, points=points)


def _model_points(inputs: Arrays) -> Arrays:
    cameras, points = (inputs[name].astype(np.longdouble) for name in ("cameras", "points"))
    matrix = cameras[:, :12].reshape(-1, 3, 4)
    towards = points - matrix[:, :, 3]
    view = (matrix[:, :, :3] * towards[:, :, None]).sum(axis=1)
    x = (1 + view[:, 0] / (-view[:, 2] * cameras[:, 12])) / 2 * WIDTH
    y = (1 - view[:, 1] / (-view[:, 2] * cameras[:, 13])) / 2 * HEIGHT
    return {"x": x, "y": y, "distance": np.sqrt((towards**2).sum(axis=1))}


def _draw_slopes(rng: np.random.Generator, n: int, phi: float) -> Arrays:
    """Angles of incidence from 0 to 90 degrees, a third of them close to either end."""
    theta = np.pi / 2 * rng.random(n)
    theta[: n // 3] = 10 ** rng.uniform(-6, 0, n // 3)
    theta[n // 3 : 2 * n // 3] = np.pi / 2 - 10 ** rng.uniform(-7, 0, 2 * n // 3 - n // 3)
    angle = np.full(n, phi)
    distance = 10 ** rng.uniform(-3, 3, n)
    told = [distance, np.cos(theta), np.sin(angle), np.cos(angle), 2 * np.sin(angle / 2) ** 2]
    return _floats(told=np.stack(told, axis=1))


def _model_slopes(inputs: Arrays) -> Arrays:
    """t |1 - cos theta / cos(theta - phi)|, by extended precision."""
    t, cosine, sine_phi, _, versine = inputs["told"].astype(np.longdouble).T
    phi = np.arctan2(sine_phi, 1 - versine)
    theta = np.arccos(np.minimum(cosine, 1))
    return {"slope": t * np.abs(1 - np.cos(theta) / np.cos(theta - phi))}


def _slope_scale(inputs: Arrays, right: np.ndarray) -> np.ndarray:
    """What a pixel's angle is at that distance, or what it comes to on a slanted surface."""
    return np.maximum(inputs["told"][:, 0].astype(float) * inputs["told"][:, 2], right)


def _draw_pixels(rng: np.random.Generator, n: int, mean: float) -> Arrays:
    """Nine values about a mean that spread by 1."""
    return _floats(told=mean + rng.normal(size=(n, 9)), weights=rng.uniform(0.1, 1, (n, 9)))


def _model_pixels(inputs: Arrays) -> Arrays:
    values, weights = (inputs[name].astype(np.longdouble) for name in ("told", "weights"))
    total = weights.sum(axis=1)
    mean = (weights * values).sum(axis=1) / total
    return {"variance": (weights * (values - mean[:, None]) ** 2).sum(axis=1) / total}


def _draw_weights(rng: np.random.Generator, n: int, size: float) -> Arrays:
    """Differences and deviations about so large, from a hundredth to a hundred times that, and histories of 1 to 10,000
    frames."""
    sigma, more = (size * 10 ** rng.uniform(-2, 2, n) for _ in range(2))
    difference = size * 10 ** rng.uniform(-2, 2, n) * rng.choice([-1, 1], n)
    return _floats(told=np.stack([difference, sigma**2, np.maximum(sigma, more) ** 2, 10 ** rng.uniform(0, 4, n)]))


def _model_weights(inputs: Arrays) -> Arrays:
    """Eq. 4, with Eq. 10 and 11; and with the noise of both sides taken from the squared difference."""
    difference, around, variance, count = inputs["told"].astype(np.longdouble)
    published = 1 - around / (around + difference**2)
    bias = np.maximum(difference**2 - variance / count - around / np.longdouble(np.float64(1) * 9), 0)
    mse = bias + variance / count
    alpha = mse / (mse + variance)
    return {
        "published alpha": published,
        "corrected alpha": alpha,
        "effective N": 1 / (alpha**2 + (1 - alpha) ** 2 / count),
    }


def _one(_inputs: Arrays, right: np.ndarray) -> np.ndarray:
    return np.ones_like(right)


def _draw_eyes(rng: np.random.Generator, n: int, mean: float) -> Arrays:
    return _floats(told=mean + rng.normal(size=(n, 9)), differences=10 ** rng.uniform(-2, 2, n))


def _model_eyes(inputs: Arrays) -> Arrays:
    values, difference = inputs["told"].astype(np.longdouble), inputs["differences"].astype(np.longdouble)
    variance = values.var(axis=1)
    other = values[:, 4] + difference
    return {"1 - beta": variance / ((other[:, None] - values) ** 2).mean(axis=1)}


def _draw_rays(rng: np.random.Generator, n: int, offset: float) -> Arrays:
    """Eight triangles about 0.2 m large in 2 m, so far from the origin, their boxes, and rays towards them."""
    place = offset * rng.uniform(-1, 1, (1, 1, 1, 3))
    corners = (place + rng.uniform(-1, 1, (n, 8, 1, 3)) + 0.2 * rng.normal(size=(n, 8, 3, 3))).astype(np.float32)
    blocks = np.zeros(n, layout.STRUCTS["Block"])
    blocks["positions"] = corners.transpose(0, 2, 3, 1).reshape(n, 72)
    nodes = np.zeros(n, layout.STRUCTS["Node"])
    sides = np.stack([corners.min(axis=2), corners.max(axis=2)], axis=1)  # (n, 2, 8, 3)
    nodes["planes"] = sides.transpose(0, 3, 1, 2).reshape(n, 48)
    weights = rng.dirichlet([1, 1, 1], n)[:, :, None]
    goal = (corners[np.arange(n), rng.integers(8, size=n)] * weights).sum(axis=1)
    origins = (place[0, 0] + 3 * rng.normal(size=(n, 3))).astype(np.float32)
    bounds = np.concatenate([corners.min(axis=(0, 1, 2)), corners.max(axis=(0, 1, 2))])
    return {"nodes": nodes, "blocks": blocks} | _floats(origins=origins, directions=goal - origins, bounds=bounds)


def _model_rays(inputs: Arrays) -> Arrays:
    """The nearest of eight triangles, by their planes and the weights of their corners."""
    n = len(inputs["origins"])
    corners = (
        inputs["blocks"]["positions"].reshape(n, 3, 3, 8).transpose(0, 3, 1, 2).astype(float)
    )  # (n, 8, corner, axis)
    edge1, edge2 = corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]
    origin, d = (inputs[name].astype(float)[:, None] for name in ("origins", "directions"))
    across, away = np.cross(d, edge2), origin - corners[:, :, 0]
    determinant, turned = (edge1 * across).sum(axis=2), np.cross(away, edge1)
    u, v = (away * across).sum(axis=2) / determinant, (d * turned).sum(axis=2) / determinant
    t = (edge2 * turned).sum(axis=2) / determinant
    t[(u < 0) | (v < 0) | (u + v > 1) | (t <= 0)] = np.inf
    nearest = np.arange(n), np.argmin(t, axis=1)
    return {"t": t[nearest], "u": u[nearest], "v": v[nearest]}


def _width(_inputs: Arrays, right: np.ndarray) -> np.ndarray:
    return np.full_like(right, WIDTH)


_FEW = {"ISRT": 0, "HAS_RADIANCE": 0, "SLOTS": 12, "WORDS": 1, "NO_PREFETCH": 1}

STUDIES = {
    study.name: study
    for study in (
        Study("reprojection", "project", {"x": _width, "y": _width, "distance": itself},
              "metres of the camera from the origin",
              (1.0, 1e2, 1e4, 1e6), _draw_points, _model_points, scalars=(WIDTH, HEIGHT)),
        Study("Eq. 1", "slope", {"slope": _slope_scale}, "radians of a pixel's diagonal",
              (1e-5, 1e-4, 1e-3, 1e-2, 1e-1), _draw_slopes, _model_slopes, defines=_FEW),
        Study("moments", "moments", {"variance": itself}, "mean of values that spread by 1", (1.0, 1e2, 1e4, 1e6),
              _draw_pixels, _model_pixels, defines={"BLUR": 1}),
        Study("temporal weights", "temporal",
              {"published alpha": itself, "corrected alpha": itself, "effective N": itself},
              "size of differences and deviations", (1e-8, 1e-4, 1.0, 1e4, 1e8), _draw_weights, _model_weights,
              defines={"TAA": 0, "REJECT": 0, "CLAMP": 0, "CLIP": 0, "PUBLISHED": 0, "PER_CHANNEL": 0, "BICUBIC": 1},
              is_planar=True),
        Study("stereo weights", "stereo", {"1 - beta": itself}, "mean of values that spread by 1", (1.0, 1e2, 1e4, 1e6),
              _draw_eyes, _model_eyes, defines={"VARIANCE": 1, "PER_CHANNEL": 0}),
        Study("traversal", "traverse", {"t": itself, "u": _one, "v": _one}, "metres of the triangles from the origin",
              (0.0, 1e2, 1e4), _draw_rays, _model_rays, defines={"HAS_FP64": 1}),
    )
}  # fmt: skip


# ---------------------------------------------------------------------------------------------------------------------
# Measuring


def ulp(size: np.ndarray) -> np.ndarray:
    """The step of float32 at a size, of normal numbers."""
    return 2.0 ** (np.floor(np.log2(np.maximum(np.abs(size), np.finfo(np.float32).tiny))) - 23)


def measure(device: Device, study: Study, magnitude: float, rows: int, seed: int) -> list[dict]:
    """A row for each quantity: errors of float32, and of float64 against NumPy, in ulps of float32."""
    inputs = study.draw(np.random.default_rng([seed, *study.name.encode()]), rows, magnitude)
    names, n = list(study.quantities), rows
    shape = (len(names), n) if study.is_planar else (n, len(names))
    outputs: dict[str, tuple] = {"found": (shape, "f4")}
    if study.name == "traversal":
        outputs["lanes"] = ((n, 2), "i4")
    items = -(-n // 16) if study.is_planar else n
    narrow, wide = (
        Measured(device, study.file, study.defines, is_wide)(inputs, outputs, (*study.scalars, n), items)
        for is_wide in (False, True)
    )
    compared = np.ones(n, bool)
    more = {}
    if study.name == "traversal":
        compared, more = _agreement(narrow["lanes"], wide["lanes"])
    model = study.model(inputs)
    found = []
    for k, name in enumerate(names):
        one, right = (a["found"][k] if study.is_planar else a["found"][:, k] for a in (narrow, wide))
        one, right = one[compared].astype(float), right[compared]
        told = {key: values[compared] if len(values) == n else values for key, values in inputs.items()}
        scale = study.quantities[name](told, right)
        errors, of_scale = np.abs(one - right) / ulp(right), np.abs(one - right) / ulp(scale)
        worst = int(np.argmax(of_scale))
        numpy = np.abs(model[name][compared] - right) / ulp(scale)
        found.append({
            "configuration": study.name, "quantity": name, "of": study.of, "magnitude": magnitude, "values": len(one),
            "measured": "yes", "median": float(np.median(of_scale)), "p99.9": float(np.quantile(of_scale, 0.999)),
            "worst": float(of_scale.max()), "own median": float(np.median(errors)), "own worst": float(errors.max()),
            "numpy": float(numpy.max()),
            "where": f"float32 {one[worst]:.9g}, float64 {right[worst]:.12g}", **more,
        })  # fmt: skip
    return found


def _agreement(narrow: np.ndarray, wide: np.ndarray) -> tuple[np.ndarray, dict]:
    """Which rays find the same triangle, and how many do not; boxes that float32 enters though it need not, and those
    that it misses."""
    same = (narrow[:, 0] == wide[:, 0]) & (wide[:, 0] >= 0)
    differ = int((narrow[:, 0] != wide[:, 0]).sum())
    missed, added = wide[:, 1] & ~narrow[:, 1], narrow[:, 1] & ~wide[:, 1]
    return same, {
        "differing": differ,
        "boxes missed": int(np.bitwise_count(missed.astype(np.uint32)).sum()),
        "boxes added": int(np.bitwise_count(added.astype(np.uint32)).sum()),
    }


def run(parameters: Mapping, _needed: Mapping[str, Result], machine: Machine) -> Result:
    """Measure a study at all of its magnitudes: a row for each of these and of its quantities.

    parameters: study, a key of STUDIES; rows: inputs; seed. Columns: configuration (the study), quantity, of (what the
    magnitude is), magnitude, values; in ulps of float32 at the size that errors are judged by: median, p99.9, worst; at
    the value itself: own median, own worst; numpy: the worst difference of float64 from NumPy, in the same ulps as the
    first; where the worst is; of traversal: differing (rays), boxes missed and added; measured: no, without numbers,
    where the device has no double precision. Raises DeviceError.
    """
    device, study = machine.open(), STUDIES[parameters["study"]]
    if not device.capabilities.fp64:
        return Result([
            {"configuration": study.name, "quantity": name, "of": study.of, "magnitude": m, "measured": "no: no fp64"}
            for m in study.magnitudes for name in study.quantities
        ])  # fmt: skip
    rows = [row for m in study.magnitudes for row in measure(device, study, m, parameters["rows"], parameters["seed"])]
    return Result(rows)


EXPERIMENTS = (
    Experiment(
        name="precision",
        source="the project's own",
        title="What float32 costs: kernels against a build of the same source in double precision",
        about="Errors of single results, in ulps: steps of float32, 6e-8 to 1.2e-7 of a number. They are judged"
        " by the size of what a result is used as: a place in the image by the image's width, Eq. 1's"
        " slope by a pixel's angle at that distance, or by itself if that is more, weights of a hit by 1;"
        " all else by itself. What users see of it: a place that is off by 100 ulps is off by a 100th of a"
        " pixel; weights and variances that are off by some ulps are never seen beside noise. Far from"
        " the origin the difference of two places that float32 has is still exact, or nearly, so that"
        " places in the image stay right; what is rounded out there are the scene's own vertices. The"
        " worst t, u and v are of rays that run almost within a triangle's plane. Boxes that float32"
        " misses would be holes: there must be none. Rays that find another triangle pass within rounding"
        " of an edge.",
        plans=(
            Calls(
                "precision",
                tuple({"study": name, "rows": ROWS} for name in STUDIES),
                quick=tuple({"study": name, "rows": QUICK_ROWS} for name in STUDIES),
                is_seeded=True,
            ),
        ),
        tables=(
            Table(
                "Errors of float32, in ulps of what they are judged by, and of the values themselves",
                (
                    Column("median", "median", ".2g"),
                    Column("p99.9", "99.9 %", ".3g"),
                    Column("worst", "worst", ".3g"),
                    Column("own median", "of itself: median", ".2g"),
                    Column("own worst", "of itself: worst", ".3g"),
                    Column("numpy", "float64 against NumPy", ".2g"),
                    Column("differing", "rays that differ", ".3g"),
                    Column("boxes missed", "boxes missed", ".0f"),
                    Column("boxes added", "boxes added", ".0f"),
                ),
                by=("configuration", "quantity", "of", "magnitude", "measured"),
            ),
            Table("Where the worst is", (Column("worst", "worst", ".3g"),), by=("configuration", "quantity", "where")),
        ),
        plots=(
            Plot(
                "Worst error by magnitude of the input",
                "magnitude",
                "worst",
                by="quantity",
                facet="configuration",
                log="xy",
                x_head="magnitude",
                y_head="worst error (ulps)",
            ),
        ),
    ),
)
