"""The layered filter in NumPy: the meaning of Eq. 2-6 (Roth et al. 2020) in `cl/octree/filter.cl`, term by term, over whole images.

A layer is a dict of images in float64: light, albedo, own, pass, normal (H, W, 3); depth, segment, roughness, count (H, W).
"""

from types import SimpleNamespace

import numpy as np

from clcache.device import Device
from clcache.frame import FrameGraph
from clcache.passes.octree_filter import filter_buffers, filter_passes

SETTINGS = {
    "octree.filter": "bilateral",
    "octree.layered": True,
    "octree.filter_normal": 1.0,
    "octree.filter_depth": 100.0,
    "octree.filter_segment": 400.0,
    "octree.filter_albedo": 1.5,
    "octree.filter_albedo_glossy": 3.0,
    "octree.filter_luminance": 3.0,
}
KAPPA_COLOR, KAPPA_LIGHT, SLACK, LOBE, BLUR, COAT, UNLIKE = 30.0, 0.5, 2.0, 2.0, 1.0, 8.0, 8.0
_HALF = [1, 0, 0, 1, 3, 1, -2, 3, -2, -4, 5, -1, -1, 6, -5, -4, 6, -4, 2, 7, -8, -1, 4, -7]
_PAIRS = np.reshape(_HALF, (-1, 2))
TAPS = np.concatenate([_PAIRS, -_PAIRS])  # column, row
PLANES = ("light", "albedo", "own", "pass", "normal", "depth", "segment", "roughness", "count")


def make_layer(shape, **planes):
    """A layer of one diffuse plane before the eye, but for the planes given."""
    ones, all3 = np.ones(shape), np.ones((*shape, 3))
    layer = {"light": all3, "albedo": 0.5 * all3, "own": 0 * all3, "pass": 0 * all3, "normal": all3 * [0, 0, 1]}
    layer |= {"depth": ones, "segment": 0 * ones, "roughness": 0 * ones, "count": ones}
    return {name: np.array(planes.get(name, plane), np.float32).astype(np.float64) for name, plane in layer.items()}


def shifted(image, column, row, outside=0.0):
    """What is so many columns and rows away from each pixel."""
    moved = np.full_like(image, outside)
    height, width = image.shape[:2]
    to_row, to_column = slice(max(-row, 0), height - max(row, 0)), slice(max(-column, 0), width - max(column, 0))
    from_row, from_column = slice(max(row, 0), height + min(row, 0)), slice(max(column, 0), width + min(column, 0))
    if abs(row) < height and abs(column) < width:
        moved[to_row, to_column] = image[from_row, from_column]
    return moved


def reciprocal(v):
    """1 / v where that is a positive number, else 0."""
    with np.errstate(divide="ignore"):
        return np.where((v > 0) & np.isfinite(v), 1 / v, 0)


def difference(p, q):
    """Of two distances, relative to q: |p / q - 1|; where only one is endless, 1 or more; 0 where both are."""
    p, q = reciprocal(p), reciprocal(q)
    return np.where(p > 0, np.abs(q - p) / np.where(p > 0, p, 1), np.where(q > 0, 1e20 * q, 0))


def steps(plane, column, row, across):
    """The middle one of three steps from each pixel towards a neighbour: its own, and those of the pixels beside it."""
    found = []
    for beside in (-1, 0, 1):
        c, r = beside * across[0], beside * across[1]
        a, b = shifted(plane, c, r), shifted(plane, c + column, r + row)
        found.append(np.where((a > 0) & (b > 0), np.abs(a - b) / np.maximum(np.maximum(a, b), 1e-30), np.inf))
    return np.median(found, axis=0)


def slopes(plane):
    """How much a distance differs from a pixel to the next along rows and along columns."""
    x = np.minimum(steps(plane, -1, 0, (0, 1)), steps(plane, 1, 0, (0, 1)))
    y = np.minimum(steps(plane, 0, -1, (1, 0)), steps(plane, 0, 1, (1, 0)))
    return [np.where(np.isfinite(s), SLACK * s, 0) for s in (x, y)]


def lab(color):
    """CIE 1976 L*a*b* of linear Rec. 709, relative to D65."""
    to_xyz = [
        [0.4123908, 0.3575843, 0.1804808],
        [0.2126390, 0.7151687, 0.0721923],
        [0.0193308, 0.1191948, 0.9505322],
    ]
    t = color @ np.transpose(to_xyz) / [0.9504559, 1.0, 1.0890578]
    x, y, z = np.moveaxis(np.where(t > (6 / 29) ** 3, np.cbrt(t), t * (29 / 6) ** 2 / 3 + 4 / 29), -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def luminance(color):
    """Of linear Rec. 709."""
    return color @ [0.2126, 0.7152, 0.0722]


def unit(v):
    """Brought to [0, 1]."""
    return np.clip(v, 0, 1)


def normal_weight(s, p, q):
    """Eq. 2."""
    return unit(s * np.maximum(0, (p * q).sum(-1)))


def distance_weight(s, p, q, slack):
    """Eq. 3 and 4."""
    return unit(1 - s * np.maximum(difference(p, q) - slack, 0))


def albedo_weight(s, p, q):
    """Eq. 5, of colours in L*a*b*."""
    c = np.log1p(KAPPA_COLOR * np.linalg.norm(p - q, axis=-1)) / KAPPA_COLOR
    return unit(1 - s * c / (c + 1))


def light_weight(s, p, q, samples):
    """Eq. 6. samples: n_p n_q / (n_p + n_q)."""
    total = p + q
    apart = KAPPA_LIGHT * np.sqrt(samples) * np.where(total > 0, np.abs(p - q) / np.where(total > 0, total, 1), 0)
    return unit(1 - np.log1p(s * apart / (apart + 1)))


class Planes:
    """A layer's guides, its E and R, and those of any tap."""

    def __init__(self, layer, rest, is_plain):
        is_there = (layer["depth"] > 0) & np.isfinite(layer["depth"])
        self.normal, self.lab = layer["normal"], lab(layer["albedo"])
        self.depth = np.where(is_there, layer["depth"], 0)
        self.segment = np.where(is_there & (layer["segment"] > 0), layer["segment"], -1)
        self.light, self.count = layer["light"], np.minimum(layer["count"], 65535)
        self.rest, self.rough = rest, np.where(is_there, layer["roughness"], 0)
        if is_plain:
            self.light, self.count = layer["albedo"] * layer["light"] + rest, np.maximum(self.count, 1)
        else:
            is_diffuse = layer["albedo"].max(-1) > 0
            self.count = np.where(is_diffuse, self.count, 0)
            self.rough = np.where(is_diffuse, self.rough, -self.rough)
        self.count = np.where(is_there, self.count, 0)

    def tap(self, column, row):
        """What is so many columns and rows away."""
        return SimpleNamespace(**{name: shifted(plane, column, row) for name, plane in vars(self).items()})


def filtered(layer, rest, settings, pixel_angle, is_plain=False):
    """filter(E) and filter(R) of a layer."""
    s = {name.removeprefix("octree.filter_"): value for name, value in settings.items()}
    p = Planes(layer, rest, is_plain)
    is_near = (p.segment > 0) & np.isfinite(p.segment)
    (slope_x, slope_y), (segment_x, segment_y) = slopes(p.depth), slopes(np.where(is_near, p.segment, 0))
    beyond = np.where(is_near, p.segment / np.where(is_near, p.depth + p.segment, 1), 1)
    reach = BLUR * np.where(p.rough > 0, COAT, 1) * p.rough**2 * beyond / pixel_angle
    radius = np.maximum(reach, 1)
    light, known = p.count[..., None] * p.light, p.count.copy()
    mean, weight = p.rest.copy(), np.ones(p.depth.shape)
    for x, y in TAPS:
        q = p.tap(x, y)
        place = (q.depth > 0) * normal_weight(s["normal"], p.normal, q.normal)
        place = place * distance_weight(s["depth"], p.depth, q.depth, abs(x) * slope_x + abs(y) * slope_y)
        samples = p.count * q.count / np.maximum(p.count + q.count, 1e-30)
        w = place * albedo_weight(s["albedo"], p.lab, q.lab) * q.count
        w = w * light_weight(s["luminance"], luminance(p.light), luminance(q.light), samples)
        light, known = light + w[..., None] * q.light, known + w
        w = place * albedo_weight(s["albedo_glossy"], p.lab, q.lab) * (q.rough != 0)
        w = w * unit(1 - UNLIKE * np.abs(p.rough - q.rough)) * unit(1 - (x * x + y * y) / radius**2)
        slack = abs(x) * segment_x + abs(y) * segment_y + LOBE * p.rough**2
        alike = distance_weight(s["segment"], p.segment, q.segment, slack)
        w = w * np.where((p.segment > 0) & (q.segment > 0), alike, 1)
        mean, weight = mean + w[..., None] * q.rest, weight + w
    light = light / np.where(known > 0, known, 1)[..., None]
    return light, np.where((reach > 1)[..., None], mean / weight[..., None], rest)


def run(layers, settings, pixel_angle):
    """out[i] of every layer, and what it is without this layer's own filter."""
    kind, is_layered = settings["octree.filter"], settings["octree.layered"]
    outs, unfiltered = [None] * len(layers), [None] * len(layers)
    for i in reversed(range(len(layers))):
        layer = layers[i]
        rest = layer["own"] + (layer["pass"] * outs[i + 1] if i + 1 < len(layers) else 0)
        has_light, emitted = (layer["depth"] != 0)[..., None], layer.get("emitted", 0)
        out = unfiltered[i] = np.where(has_light, layer["albedo"] * layer["light"] + rest + emitted, 0)
        if kind == "bilateral" and (is_layered or i == 0):
            e, r = filtered(layer, rest, settings, pixel_angle, not is_layered)
            near = np.isfinite(layer["depth"])[..., None] & has_light
            light = np.where(near, layer["albedo"] * e + r if is_layered else e, layer["own"])
            out = np.where(has_light, light + emitted, 0)
        outs[i] = out
    return outs, unfiltered


class OnDevice:
    """The passes, over layers that are uploaded."""

    def __init__(self, device: Device, layers, settings, aovs=(), pixel_angle=0.002):
        height, width = layers[0]["depth"].shape
        size = width, height
        self.shape, self.pixel_angle = (height, width), pixel_angle
        passes = filter_passes(device, size, len(layers), settings, emits="emitted" in layers[0])
        buffers = filter_buffers(len(layers), size, settings)
        self.graph = FrameGraph(device, passes, buffers, {"layer0_filtered", *aovs}, self.upload(device, layers))
        slope = 0.5 * pixel_angle * height
        self.state = SimpleNamespace(camera={"slope": np.float32([slope, slope])})

    @staticmethod
    def upload(device, layers):
        """The buffers of layers."""
        planes = {}
        for i, layer in enumerate(layers):
            for name in layer:
                plane = np.float32(layer[name])
                plane = np.moveaxis(plane, -1, 0).reshape(3, -1) if plane.ndim == 3 else plane.ravel()
                planes[f"layer{i}_{name}"] = device.upload(plane)
        return planes

    def run(self):
        """The image."""
        self.graph.run(self.state)
        return np.moveaxis(self.graph.of()["layer0_filtered"].get().reshape(3, *self.shape), 0, -1)

    def picture(self, name):
        """An AOV of the last run."""
        return self.graph.of()[name].get().reshape(*self.shape, 3)
