"""The values of each node: as NumPy computes them, by closed forms, and at the extremes."""

import colorsys

import numpy as np
import pytest
from graph_nodes import OVERLOADS, NodesOnDevice, Sockets, is_dual, label, run_in_numpy, width_of

from clcache.graph.library import library
from clcache.graph.numpy_nodes import NODES, lookup3
from clcache.scene.model import Texture

KINDS = sorted({o.kind for o in OVERLOADS})
FLOAT_MAX = np.finfo(np.float32).max
INTEGERS = {"Octaves": (0, 1, 4), "Style": (0, 1), "Index": (-1, 0, 1, 2, 3, 7), "Texture": (0,)}


@pytest.fixture(scope="module")
def picture():
    pixels = np.random.default_rng(3).integers(0, 256, (12, 16, 4), dtype=np.uint8)
    return Texture("noise", pixels, srgb=True, wrap=("mirror", "clamp"))


@pytest.fixture(scope="module")
def nodes(device, picture):
    return NodesOnDevice(device, texture=picture)


def overloads_of(kind):
    return [o for o in OVERLOADS if o.kind == kind]


def integers_of(overload):
    """Every choice of the integers; no node has more than one."""
    names = overload.integers
    return [{names[0]: value} for value in INTEGERS[names[0]]] if names else [{}]


def plain(nodes, kind, integer=None, **inputs):
    """A node's only output without changes, for inputs that choose the overload by their widths; (n, width) float32."""
    inputs = {name: np.asarray(v, np.float32) for name, v in inputs.items()}
    inputs = {name: v[:, None] if v.ndim == 1 else v for name, v in inputs.items()}
    types = {name: "float" if v.shape[1] == 1 else f"float{v.shape[1]}" for name, v in inputs.items()}
    [overload] = [
        o for o in overloads_of(kind) if o.inputs == types and not any(is_dual(t) for t in o.outputs.values())
    ]
    result = nodes(
        overload,
        Sockets({name: inputs[name] for name in overload.inputs}, {}),
        dict.fromkeys(overload.integers, integer),
    )
    return next(iter(result.values.values()))


def test_numpy_knows_every_node():
    assert sorted(NODES) == KINDS
    assert set(library()) - set(KINDS) == {"UVInput", "PositionInput", "NormalInput"}


def random_sockets(overload, rng, rows=600):
    """Numbers of several sizes, whole numbers, and equal ones; changes of one size."""
    values, changes = {}, {}
    for name, type_name in overload.inputs.items():
        width = width_of(type_name)
        value = rng.normal(size=(rows, width)) * rng.choice([0.1, 1.0, 8.0], size=(rows, 1))
        value[: rows // 3] = rng.integers(-2, 3, (rows // 3, width))
        value[rows // 3 : rows // 2] = rng.random((rows // 2 - rows // 3, width))
        values[name] = value.astype(np.float32)
        if is_dual(type_name):
            changes[name] = (rng.normal(size=(2, rows, width)) * 0.1).astype(np.float32)
    return Sockets(values, changes)


def moved(given, rng):
    """The same within the rounding of a few operations."""
    shift = {
        name: (v * (1 + 4e-7 * rng.choice([-1, 0, 1], v.shape))).astype(v.dtype) for name, v in given.values.items()
    }
    return Sockets(shift, given.changes)


def tolerance(overload, given, integers, texture, expected, rng):
    """What rounding may do to each output: ten times what it does to moved inputs, and 3e-6 of the value."""
    spread = {name: np.zeros_like(v) for name, v in expected.items()}
    for _ in range(8):
        other = run_in_numpy(overload, moved(given, rng), integers, texture).values
        spread = {name: np.maximum(s, np.abs(other[name] - expected[name])) for name, s in spread.items()}
    return {name: 10 * s + 3e-6 * (1 + np.abs(expected[name])) for name, s in spread.items()}


@pytest.mark.parametrize("kind", KINDS)
def test_as_numpy(nodes, picture, kind):
    for overload in overloads_of(kind):
        for integers in integers_of(overload):
            rng = np.random.default_rng(5)
            given = random_sockets(overload, rng)
            expected = run_in_numpy(overload, given, integers, picture).values
            margin = tolerance(overload, given, integers, picture, expected, rng)
            found = nodes(overload, given, integers).values
            for name, value in found.items():
                assert np.isfinite(expected[name]).all()
                assert (np.abs(value - expected[name]) <= margin[name]).all(), label(overload)


@pytest.mark.parametrize(
    "kind", [k for k in KINDS if any(is_dual(t) for o in overloads_of(k) for t in o.outputs.values())]
)
def test_changes_leave_values_as_they_are(nodes, kind):
    """Overloads with changes give the very values of the one without, where there is one."""
    plain_ones = {tuple(o.inputs.values()): o for o in overloads_of(kind) if not any(map(is_dual, o.outputs.values()))}
    compared = 0
    for overload in overloads_of(kind):
        types = tuple(t.removesuffix("_D") for t in overload.inputs.values())
        if not any(map(is_dual, overload.outputs.values())) or types not in plain_ones:
            continue
        for integers in integers_of(overload):
            given = random_sockets(overload, np.random.default_rng(6))
            dual = nodes(overload, given, integers).values
            single = nodes(plain_ones[types], Sockets(given.values, {}), integers).values
            for name, value in dual.items():
                np.testing.assert_array_equal(value, single[name], label(overload))
                compared += 1
    assert compared or kind in ("SplitLR", "SplitTB", "Image")


EXTREMES = np.array(
    [0.0, -0.0, 1.0, -1.0, 0.5, 1e-45, -1e-40, 1e-30, -1e-30, 3e9, -3e9, 2**31, -(2**31), 1e15, 1e30, -1e30], np.float32
)  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_extremes_give_numbers(nodes, kind):
    """No node gives NaN for numbers up to 1e30; and what is not finite itself, does no harm."""
    for overload in overloads_of(kind):
        rng = np.random.default_rng(7)
        values = {name: rng.choice(EXTREMES, (3000, width_of(t))) for name, t in overload.inputs.items()}
        zeros = {
            name: np.zeros((2, *values[name].shape), np.float32) for name, t in overload.inputs.items() if is_dual(t)
        }
        for integers in integers_of(overload):
            for name, value in nodes(overload, Sockets(values, zeros), integers).values.items():
                assert not np.isnan(value).any(), (label(overload), name)
            odd = {
                name: rng.choice([np.nan, np.inf, -np.inf, 1.0], v.shape).astype(np.float32)
                for name, v in values.items()
            }
            nodes(overload, Sockets(odd, zeros), integers)


@pytest.mark.parametrize(
    ("kind", "inputs", "expected"),
    [
        ("Div", {"A": [3.0, -2.0, 0.0], "B": [0.0, 0.0, 0.0]}, [0, 0, 0]),
        ("Mod", {"A": [5.5, -1.0, 5.5, 3.0, 1e20], "B": [2.0, 3.0, -2.0, 0.0, 3.0]}, [1.5, 2, -0.5, 0, 0]),
        ("Pow", {"A": [0.0, 0.0, 0.0, -2.0, -2.0, -2.0], "B": [0.0, -1.0, 2.0, 3.0, 2.0, 0.5]}, [1, 0, 0, -8, 4, 0]),
        ("Pow", {"A": [10.0, 1e-20, 2.0], "B": [100.0, 3.0, -2.0]}, [FLOAT_MAX, 0, 0.25]),
        ("SafePow", {"A": [-4.0, 4.0, 0.0], "B": [0.5, 0.5, -1.0]}, [-2, 2, 0]),
        ("Ln", {"In": [0.0, -5.0, 1.0]}, [-87.33654, -87.33654, 0]),
        ("Exp", {"In": [1e30, -1e30, 0.0]}, [FLOAT_MAX, 0, 1]),
        ("Sqrt", {"In": [-4.0, 9.0]}, [0, 3]),
        ("Asin", {"In": [2.0, -2.0]}, [np.pi / 2, -np.pi / 2]),
        ("Acos", {"In": [2.0, -2.0]}, [0, np.pi]),
        ("Atan2", {"Y": [0.0, 1.0, 0.0], "X": [0.0, 0.0, -1.0]}, [0, np.pi / 2, np.pi]),
        ("Round", {"In": [0.5, -0.5, 2.5, 1.4]}, [1, -1, 3, 1]),
        ("Smoothstep", {"In": [1.0, 0.9, 0.5], "Low": [1.0, 1.0, 0.0], "High": [1.0, 1.0, 1.0]}, [1, 0, 0.5]),
        ("Remap", {"In": [5.0, 2.0], "InLow": [1.0, 1.0], "InHigh": [1.0, 3.0], "OutLow": [7.0, 0.0], "OutHigh": [9.0, 10.0]}, [7, 5]),
        ("Clamp", {"In": [5.0, 5.0], "Low": [0.0, 3.0], "High": [1.0, 2.0]}, [1, 2]),
        ("BlendBurn", {"Fg": [0.0, 0.5], "Bg": [0.3, 0.75], "Mix": [0.5, 1.0]}, [0, 0.5]),
        ("BlendDodge", {"Fg": [1.0, 0.5], "Bg": [0.3, 0.25], "Mix": [0.5, 1.0]}, [0, 0.5]),
        ("BlendScreen", {"Fg": [0.5], "Bg": [0.5], "Mix": [1.0]}, [0.75]),
        ("IfEqual", {"Value1": [1.0, 1.0], "Value2": [1.0, 2.0], "In1": [5.0, 5.0], "In2": [6.0, 6.0]}, [5, 6]),
        ("Xor", {"A": [0.0, 2.0, 2.0], "B": [0.0, 0.0, -1.0]}, [0, 1, 0]),
        ("Rotate2D", {"In": [[1.0, 0.0]], "Angle": [90.0]}, [[0, -1]]),
        ("Rotate3D", {"In": [[1.0, 0.0, 0.0]], "Angle": [90.0], "Axis": [[0.0, 0.0, 5.0]]}, [[0, -1, 0]]),
        ("Cross", {"A": [[1.0, 0.0, 0.0]], "B": [[0.0, 1.0, 0.0]]}, [[0, 0, 1]]),
        ("Normalize", {"In": [[0.0, 0.0], [3e30, 4e30], [3e-40, 4e-40]]}, [[0, 0], [0.6, 0.8], [0.6, 0.8]]),
        ("Length", {"In": [[3e30, 4e30], [0.0, 0.0]]}, [5e30, 0]),
        ("Length", {"In": [-0.3, 3e38, 0.0]}, [0.3, 3e38, 0]),
        ("Distance", {"A": [-0.3], "B": [0.2]}, [0.5]),
        ("Dot", {"A": [-0.3], "B": [0.2]}, [-0.06]),
        ("Normalize", {"In": [-0.3, 3e38, 0.0]}, [-1, 1, 0]),
        ("HsvToRgb", {"In": [[0.3, -0.5, 0.7], [0.0, 1.0, 0.7]]}, [[0.7, 0.7, 0.7], [0.7, 0, 0]]),
        ("Unpremultiply", {"In": [[0.2, 0.4, 0.6, 0.5], [1.0, 1.0, 1.0, 0.0]]}, [[0.4, 0.8, 1.2, 0.5], [0, 0, 0, 0]]),
        ("NormalMap", {"In": [[0.0, 0.0, 0.0], [1.0, 0.25, 0.75]], "Scale": [[2.0, 3.0], [2.0, 3.0]]}, [[0, 0, 1], [2, -1.5, 0.5]]),
        ("RampTB", {"Top": [1.0, 1.0], "Bottom": [0.0, 0.0], "UV": [[9.0, 0.25], [9.0, 7.0]]}, [0.25, 1]),
        ("Append", {"A": [[1.0, 2.0, 3.0]], "B": [4.0]}, [[1, 2, 3, 4]]),
        ("BlendOver", {"Fg": [[0.5, 0.0, 0.0, 0.5]], "Bg": [[0.0, 1.0, 0.0, 1.0]], "Mix": [1.0]}, [[0.5, 0.5, 0, 1]]),
        ("BlendDisjointOver", {"Fg": [[0.5, 0.0, 0.0, 0.75]], "Bg": [[0.0, 1.0, 0.0, 0.5]], "Mix": [1.0]}, [[0.5, 0.5, 0, 1]]),
    ],
)  # fmt: skip
def test_stated_values(nodes, kind, inputs, expected):
    found = plain(nodes, kind, **inputs)
    np.testing.assert_allclose(found, np.reshape(expected, found.shape), rtol=2e-6, atol=3e-7)


@pytest.mark.parametrize(
    ("kind", "function", "low", "high", "relative"),
    [
        ("Sin", np.sin, -50, 50, 0), ("Cos", np.cos, -50, 50, 0), ("Tan", np.tan, -1.5, 1.5, 1e-5),
        ("Exp", np.exp, -80, 80, 3e-7), ("Ln", np.log, 1e-6, 100, 2e-7), ("Asin", np.arcsin, -1, 1, 0),
        ("Acos", np.arccos, -1, 1, 0), ("Sqrt", np.sqrt, 0, 100, 1e-7),
    ],
)  # fmt: skip
def test_functions_are_accurate(nodes, kind, function, low, high, relative):
    x = np.linspace(low, high, 20001, dtype=np.float32)
    exact = function(x.astype(np.float64))
    absolute = 4e-7 + 2e-7 * np.abs(x) * (kind in ("Sin", "Cos"))  # of the rounded product with 1 / (2 pi)
    assert (
        np.abs(plain(nodes, kind, In=x)[:, 0] - exact) <= relative * np.abs(exact) + absolute * (kind != "Exp")
    ).all()


def test_powers_are_accurate(nodes):
    a, b = (g.ravel().astype(np.float32) for g in np.meshgrid(np.linspace(0.01, 20, 150), np.linspace(-8, 8, 151)))
    exact = a.astype(np.float64) ** b
    assert (np.abs(plain(nodes, "Pow", A=a, B=b)[:, 0] / exact - 1) < 1.2e-5).all()


def test_hsv_is_that_of_colorsys_and_comes_back(nodes):
    rgb = np.random.default_rng(1).random((400, 3), dtype=np.float32)
    rgb[:8] = [[0, 0, 0], [1, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [0.5, 0.5, 0.5], [1, 0, 1]]
    hsv = plain(nodes, "RgbToHsv", In=rgb)
    np.testing.assert_allclose(hsv, [colorsys.rgb_to_hsv(*map(float, c)) for c in rgb], atol=2e-6)
    np.testing.assert_allclose(plain(nodes, "HsvToRgb", In=hsv), rgb, atol=2e-6)
    turned = hsv + np.float32([3, 0, 0])
    np.testing.assert_allclose(plain(nodes, "HsvToRgb", In=turned), rgb, atol=1e-5)


def test_the_hash_is_lookup3():
    """Its author's test: 30 bytes hash to 0x17770551 from an initial value of 0; eight words would count as 32."""
    words = np.frombuffer(b"Four score and seven years ago\0\0", "<u4")
    assert lookup3(*words[:, None], initial=-2)[0] == 0x17770551


@pytest.mark.parametrize(
    ("kind", "socket", "dimensions", "bound"), [("Noise2D", "UV", 2, 1.0), ("Noise3D", "Position", 3, 1.05)]
)
def test_perlin_noise(nodes, kind, socket, dimensions, bound):
    """Zero at lattice points, mean 0, and about -1 .. 1 in between; its three channels are not the same."""
    rng = np.random.default_rng(2)
    lattice = rng.integers(-(2**20), 2**20, (500, dimensions))
    assert not plain(nodes, kind, **{socket: lattice}).any()
    value = plain(nodes, kind, **{socket: rng.uniform(-300, 300, (40000, dimensions))})
    assert abs(value.mean()) < 4 * value.std() / np.sqrt(value.size) and 0.2 < value.std() < 0.4
    assert 0.7 < np.abs(value).max() <= bound
    three = plain(nodes, f"{kind}Float3", **{socket: rng.uniform(-300, 300, (4000, dimensions))})
    assert np.abs(np.corrcoef(three.T) - np.eye(3)).max() < 0.08


def test_perlin_noise_is_continuous_between_cells(nodes):
    rng = np.random.default_rng(3)
    on_face = np.column_stack([rng.integers(-50, 50, 500), rng.uniform(-50, 50, (500, 2))]).astype(np.float32)
    before = np.column_stack([np.nextafter(on_face[:, :1], np.float32(-1000)), on_face[:, 1:]])
    np.testing.assert_allclose(
        plain(nodes, "Noise3D", Position=before), plain(nodes, "Noise3D", Position=on_face), atol=2e-5
    )


def test_fractal_noise_is_a_sum_of_octaves(nodes):
    p = np.random.default_rng(4).uniform(-9, 9, (300, 3)).astype(np.float32)
    ones = np.ones(300)
    sum_of_three = sum(0.5**k * plain(nodes, "Noise3D", Position=2**k * p) for k in range(3))
    fractal = plain(nodes, "Fractal3D", 3, Position=p, Lacunarity=2 * ones, Diminish=0.5 * ones)
    np.testing.assert_allclose(fractal, sum_of_three, atol=1e-6)


def test_octaves_are_bounded(nodes):
    """A document that asks for 2^31 - 1 of them gets 32, soon; none, and less, are silence."""
    p, ones = np.full((1, 2), 0.3), np.ones(1)
    one = plain(nodes, "Fractal2D", 1, UV=p, Lacunarity=ones, Diminish=ones)
    most = plain(nodes, "Fractal2D", 2**31 - 1, UV=p, Lacunarity=ones, Diminish=ones)
    np.testing.assert_allclose(most, 32 * one, rtol=1e-5)
    for octaves in (0, -(2**31)):
        assert plain(nodes, "SimplexFractal2D", octaves, UV=p, Lacunarity=ones, Diminish=ones) == 0


@pytest.mark.parametrize("kind", ["CellNoise3D", "Noise3D", "Worley3D"])
def test_far_cells_are_the_last_ones(nodes, kind):
    """Beyond 1e9, what would not fit into an integer."""
    far = np.array([[3e9, -3e9, 0.3], [1e30, -1e30, 0.3], [np.inf, -np.inf, 0.3]])
    rest = {"integer": 0, "Jitter": np.ones(3)} if kind == "Worley3D" else {}
    last = plain(nodes, kind, Position=np.array([[1e9, -1e9, 0.3]] * 3), **rest)
    np.testing.assert_array_equal(plain(nodes, kind, Position=far, **rest), last)


def test_cell_noise_is_one_number_in_a_cell(nodes):
    rng = np.random.default_rng(5)
    cell = rng.integers(-1000, 1000, (2000, 3))
    inside = cell + rng.uniform(0.01, 0.99, cell.shape)
    value = plain(nodes, "CellNoise3D", Position=cell)
    np.testing.assert_array_equal(plain(nodes, "CellNoise3D", Position=inside), value)
    assert value.min() >= 0 and value.max() <= 1 and abs(value.mean() - 0.5) < 4 * np.sqrt(1 / 12 / 2000)
    assert len(np.unique(value)) > 0.99 * len(np.unique(cell, axis=0))


def test_worley_noise_without_jitter_is_the_distance_to_the_middles(nodes):
    p = np.random.default_rng(6).uniform(-5, 5, (500, 3)).astype(np.float32)
    distances = np.linalg.norm(p - np.floor(p) - 0.5, axis=1)
    found = plain(nodes, "Worley3D", 0, Position=p, Jitter=np.zeros(500))
    np.testing.assert_allclose(found[:, 0], distances, atol=1e-6)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_worley_noise(nodes, dimensions):
    """Distances in order, zero at a feature point, and the nearest point's cell all over its region."""
    socket = {2: "UV", 3: "Position"}[dimensions]
    rng = np.random.default_rng(7)
    p = rng.uniform(-40, 40, (3000, dimensions)).astype(np.float32)
    cell = np.floor(p)
    words = cell.astype(np.int64).astype(np.uint32).T
    feature = cell + np.stack(
        [lookup3(*words, np.full_like(words[0], k)) * 2.0**-32 for k in range(dimensions)], axis=1
    )
    jitter = np.ones(len(p))
    three = plain(nodes, f"Worley{dimensions}DFloat3", 0, **{socket: p}, Jitter=jitter)
    assert (three >= 0).all() and (np.diff(three, axis=1) >= 0).all()
    assert (three[:, 0] <= np.linalg.norm(p - feature, axis=1) + 1e-5).all()
    np.testing.assert_array_equal(three[:, :1], plain(nodes, f"Worley{dimensions}D", 0, **{socket: p}, Jitter=jitter))
    assert plain(nodes, f"Worley{dimensions}D", 0, **{socket: feature}, Jitter=jitter).max() < 1e-5
    region = plain(nodes, f"Worley{dimensions}D", 1, **{socket: feature}, Jitter=jitter)
    np.testing.assert_array_equal(region, plain(nodes, f"CellNoise{dimensions}D", **{socket: cell}))


def test_simplex_noise(nodes):
    """Zero at the triangles' corners, mean 0, and -1 .. 1."""
    rng = np.random.default_rng(8)
    i, j = rng.integers(-100, 100, (2, 400))
    back = (i + j) * (3 - np.sqrt(3)) / 6
    one = np.ones(400)
    corners = np.column_stack([i - back, j - back])
    assert np.abs(plain(nodes, "SimplexFractal2D", 1, UV=corners, Lacunarity=one, Diminish=one)).max() < 1e-3
    p, one = rng.uniform(-100, 100, (40000, 2)), np.ones(40000)
    value = plain(nodes, "SimplexFractal2D", 1, UV=p, Lacunarity=one, Diminish=one)
    assert abs(value.mean()) < 4 * value.std() / 200 and 0.85 < np.abs(value).max() <= 1.0


def test_pictures(nodes, picture):
    """A texel's own colour at its centre, and coarser levels for wider footprints."""
    [overload] = [o for o in overloads_of("Image") if not any(map(is_dual, o.outputs.values()))]
    rows, columns = np.divmod(np.arange(12 * 16), 16)
    uv = np.column_stack([(columns + 0.5) / 16, (rows + 0.5) / 12]).astype(np.float32)
    for width, deviation in ((0.0, (0.2, 0.4)), (0.25, (0.02, 0.2)), (10.0, (0.0, 1e-6))):
        changes = np.zeros((2, len(uv), 2), np.float32)
        changes[0, :, 0], changes[1, :, 1] = 2 * width, 0.5 * width  # geometric mean: width
        found = nodes(overload, Sockets({"UV": uv}, {"UV": changes}), {"Texture": 0}).values["Out"]
        assert deviation[0] <= found[:, 3].std() <= deviation[1]
        if width == 0:
            np.testing.assert_allclose(255 * found[:, 3], picture.pixels[..., 3].ravel(), atol=1e-3)


def test_a_slope_tilts_the_normal(nodes):
    """Height 16 u with scale 1 rises by 1 for each unit of u, however the footprint lies."""
    [overload] = overloads_of("HeightToNormal")
    angle = np.linspace(0, 6, 50)
    along_u = np.column_stack([np.cos(angle), np.sin(angle)])
    uv_changes = np.stack([along_u, along_u[:, ::-1] * [-1, 1]]).astype(np.float32)
    given = Sockets(
        {"Height": np.zeros((50, 1), np.float32), "Scale": np.ones((50, 1), np.float32), "UV": np.zeros((50, 2), np.float32)},
        {"Height": 16 * uv_changes[..., :1], "UV": uv_changes},
    )  # fmt: skip
    normal = nodes(overload, given, {}).values["Out"]
    half = np.sqrt(0.5)
    np.testing.assert_allclose(normal, np.broadcast_to([0.5 - half / 2, 0.5, 0.5 + half / 2], (50, 3)), atol=1e-6)
