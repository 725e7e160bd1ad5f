"""Every setting, declared once: `clcache settings`, --set, the scene file's [render.settings] and the Python API all read this table."""

import difflib
from collections.abc import Mapping
from dataclasses import dataclass

from .errors import SettingError


@dataclass(frozen=True)
class Setting:
    """One setting: dotted name, default (whose type is the setting's type), inclusive range or choices, and meaning.

    of: what depends on it: what a method keeps of the "world", and all that is made of it; or no more than the "image", so that
    renders in which it differs can share what they know of the world; or the "speed" alone. trade: of a setting that trades accuracy
    for speed or memory, the values that `clcache tradeoff` tries, cheapest first where they have an order; the default is one of them.
    Values with which images do not repeat are not: what is measured is a function of what is asked for.
    """

    name: str
    default: bool | int | float | str
    meaning: str
    low: float | None = None
    high: float | None = None
    choices: tuple[str, ...] | tuple[int, ...] = ()
    of: str = "world"
    trade: tuple[bool | int | float | str, ...] = ()

    @property
    def type(self) -> str:
        """The type's name as users know it: bool, int, float or str."""
        return type(self.default).__name__

    @property
    def range(self) -> str:
        """The values that are allowed, in words."""
        if self.choices:
            return ", ".join(map(str, self.choices))
        if isinstance(self.default, bool):
            return "true, false"
        if self.low is None and self.high is None:
            return "any"
        return f"{_bound(self.low)} .. {_bound(self.high)}"

    def parse(self, value: object) -> bool | int | float | str:
        """The value, from text or from a typed value, as the setting's type. Raises SettingError."""
        if isinstance(self.default, bool):
            parsed = _parse_bool(value)
        elif isinstance(self.default, str):
            parsed = value if isinstance(value, str) else None
        else:
            parsed = _parse_number(value, type(self.default))
        in_range = (
            parsed is not None
            and (not self.choices or parsed in self.choices)
            and (self.low is None or parsed >= self.low)
            and (self.high is None or parsed <= self.high)
        )
        if not in_range:
            raise SettingError(
                f"setting {self.name}: {value!r} is not {_article(self.type)} in range; expected {self.range}"
            )
        return parsed


def _article(type_name: str) -> str:
    return f"an {type_name}" if type_name[0] in "aeiou" else f"a {type_name}"


def _parse_bool(value: object) -> bool | None:
    if isinstance(value, bool):
        return value
    return {"true": True, "on": True, "1": True, "false": False, "off": False, "0": False}.get(str(value).lower())


def _parse_number(value: object, kind: type) -> int | float | None:
    if isinstance(value, bool) or (kind is int and isinstance(value, float)):
        return None
    try:
        number = kind(value)
    except (TypeError, ValueError, OverflowError):
        return None
    return number if number == number else None  # NaN is no value of any setting


SETTINGS: dict[str, Setting] = {
    s.name: s
    for s in (
        Setting(
            "pathtrace.bounces",
            3,
            "indirect bounces after the first hit; 0 is direct light only",
            0,
            64,
            trade=(1, 2, 3),
        ),
        Setting(
            "pathtrace.roulette",
            2,
            "first bounce at which Russian roulette may end a path",
            1,
            64,
            trade=(1, 2, 4),
        ),
        Setting(
            "pathtrace.sampler",
            "sobol",
            "where sample points come from: an Owen-scrambled Sobol sequence, or independent random numbers",
            choices=("sobol", "independent"),
        ),
        Setting(
            "samplecache.slots",
            12,
            "samples that a pixel can keep, of samplecache; up to 16 need a mask of 32 bits, more one of 64",
            1,
            32,
            trade=(6, 12, 24),
        ),
        Setting(
            "samplecache.target",
            4.0,
            "samples that a pixel is to have, as far as it has slots",
            1,
            32,
            trade=(2.0, 4.0, 8.0),
        ),
        Setting(
            "samplecache.tolerance",
            1.0,
            "how far the mean of a pixel and its neighbours may be from the target before samples are created or purged",
            0,
            32,
        ),
        Setting(
            "samplecache.tracing",
            "adaptive",
            "which samples are traced again in a frame: one of each pixel, all, or few where the surface is plainly continuous",
            choices=("single", "multi", "adaptive"),
            trade=("single", "adaptive", "multi"),
        ),
        Setting(
            "samplecache.reprojection",
            "deterministic",
            "how samples get their slots: racing, in two passes without a race, or so that no order of threads matters",
            choices=("single-pass", "two-pass", "deterministic"),
        ),
        Setting(
            "samplecache.shading",
            "adaptive",
            "which samples are shaded in a frame: one of each pixel, or those of pixels with the fewest radiance samples first",
            choices=("uniform", "adaptive"),
            trade=("uniform", "adaptive"),
        ),
        Setting(
            "samplecache.shading_rate",
            0.9,
            "samples shaded in a frame for each pixel, on average",
            0.0625,
            1,
            trade=(0.25, 0.5, 0.9, 1.0),
        ),
        Setting(
            "samplecache.demodulate",
            False,
            "keep radiance without the first hit's albedo, which is then read anew in every frame",
            trade=(False, True),
        ),
        Setting(
            "samplecache.alpha",
            0.0,
            "weight of a new radiance sample against those before; 0: by their number, so that all count alike, but more on glossy surfaces",
            0,
            1,
        ),
        Setting(
            "samplecache.sharpness",
            0.8,
            "of stereo blending: 1 takes each pixel by itself, 0 blurs moments and the other eye's colour the most",
            0,
            1,
            trade=(1.0, 0.8, 0.5),
        ),
        Setting(
            "isrt.superresolution",
            3,
            "cells along a pixel's edge, each of which keeps one sample",
            1,
            5,
            trade=(2, 3, 4),
        ),
        Setting(
            "voxelhash.capacity",
            2097152,
            "voxels that the table has room for, 24 bytes each and 4 of scratch",
            1,
            2**28,
            trade=(131072, 524288, 2097152),
        ),
        Setting("voxelhash.probe", 16, "places of the table that a voxel may be at", 1, 64),
        Setting(
            "voxelhash.lifetime",
            64,
            "updates, of which --spp is the number in a frame, without access after which a voxel's place may be taken",
            1,
            2**29,
        ),
        Setting(
            "voxelhash.jitter",
            True,
            "let a hit find its voxel at random among its neighbours, which hides the voxels' edges",
            trade=(False, True),
        ),
        Setting(
            "voxelhash.gate",
            True,
            "follow paths on from hits that lie closer to where they come from than a voxel is wide: there its edges would show",
            trade=(False, True),
        ),
        Setting(
            "voxelhash.lod",
            "incidence",
            "what the size of voxels follows: the distance, or the pixel's footprint on the surface, which slanted ones stretch",
            choices=("distance", "incidence"),
            trade=("distance", "incidence"),
        ),
        Setting(
            "voxelhash.level_bias",
            0.0,
            "added to the level of detail: 1 doubles the width of voxels",
            -8,
            8,
            trade=(2.0, 1.0, 0.0, -1.0),
        ),
        Setting(
            "voxelhash.inherit",
            True,
            "let a new voxel begin with the radiance of the coarser or finer one at its place",
            trade=(False, True),
        ),
        Setting(
            "voxelhash.alpha",
            0.0,
            "weight of a new radiance sample against those before; 0: by their number, so that all count alike",
            0,
            1,
        ),
        Setting(
            "octree.resolution",
            1024,
            "cells of the finest level along the scene's longest edge: finer ones keep finer shadows; twice as many take four times the"
            " memory, and four times the samples to fill",
            choices=(64, 128, 256, 512, 1024, 2048, 4096),
            trade=(256, 512, 1024, 2048),
        ),
        Setting(
            "octree.store",
            3,
            "vertices of each caching path whose light is kept: more of them fill cells beyond what is in view, and make paths longer",
            1,
            16,
            trade=(1, 2, 3, 4),
        ),
        Setting(
            "octree.length",
            -1,
            "bounces that the light which is kept of a vertex has come by, at most: fewer are faster, and darker; -1: as many as"
            " pathtrace.bounces, so that first hits get the light that path tracing gives them",
            -1,
            64,
        ),
        Setting(
            "octree.paths",
            "camera",
            "where caching paths begin: at the camera, which fills what is seen, or anywhere on the surfaces, which fills all alike and"
            " more slowly, for sequences to come",
            choices=("camera", "surfaces"),
            of="image",
        ),
        Setting(
            "octree.caching_resolution",
            1.0,
            "caching paths along the image's edges, as part of its pixels: fewer make faster frames, and a cache that grows better more"
            " slowly; 0: nothing is cached any more, and only read",
            0,
            1,
            of="image",
            trade=(0.25, 0.5, 1.0),
        ),
        Setting(
            "octree.frame_time",
            0.0,
            "milliseconds that an update may take while the camera moves, for which caching paths are made fewer; images then depend on"
            " the machine's speed; 0: no limit",
            0,
            60000,
            of="image",
        ),
        Setting(
            "octree.samples",
            32,
            "samples that a cell is to have, else a coarser one answers that has them, up to three levels above: more of them give less noise,"
            " and softer shadows where all is new",
            1,
            65535,
            of="image",
            trade=(8, 32, 128),
        ),
        Setting(
            "octree.level_bias",
            0.0,
            "added to the level that a pixel's footprint calls for: 1 halves the width of cells, which is sharper, and has more noise",
            -4,
            4,
            of="image",
            trade=(-1.0, 0.0, 1.0),
        ),
        Setting(
            "octree.jitter",
            0.5,
            "how far along the surface hits ask beside their place, at random, in widths of a cell: hides cells' edges, and blurs; 0: off",
            0,
            2,
            of="image",
            trade=(0.0, 0.5, 1.0),
        ),
        Setting(
            "octree.gate",
            True,
            "let no cell answer that is wider than the way from which its hit is reached: its edges would show in corners, and light from"
            " behind them; where finer ones do not know, the hit is traced for itself",
            of="image",
            trade=(False, True),
        ),
        Setting(
            "octree.filter",
            "bilateral",
            "what filters each image, by the surfaces' features: a cross-bilateral filter, nothing, or Intel's Open Image Denoise, which"
            " is an extra to install, and slower",
            choices=("bilateral", "none", "oidn"),
            of="image",
            trade=("none", "bilateral", "oidn"),
        ),
        Setting(
            "octree.layered",
            True,
            "filter the light of each surface along specular and glossy paths by itself, from the last to the first; else only the image"
            " by what is seen first, which is faster, and blurs what mirrors and glass show",
            of="image",
            trade=(False, True),
        ),
        Setting(
            "octree.filter_normal",
            1.0,
            "of octree.filter=bilateral: a neighbour counts by this times its normal's cosine to the pixel's, at most 1; more blurs bent"
            " surfaces",
            0,
            1e6,
            of="image",
        ),
        Setting(
            "octree.filter_depth",
            100.0,
            "of octree.filter=bilateral: how much a neighbour loses by lying farther along its path, or less far; more keeps edges of"
            " things sharper",
            0,
            1e6,
            of="image",
        ),
        Setting(
            "octree.filter_segment",
            400.0,
            "of octree.filter=bilateral with octree.layered, where a surface is glossy: the same for the way from there to the next one; more keeps sharper what"
            " it reflects",
            0,
            1e6,
            of="image",
        ),
        Setting(
            "octree.filter_albedo",
            1.5,
            "of octree.filter=bilateral, for diffuse light: how much a neighbour loses by having another albedo",
            0,
            1e6,
            of="image",
        ),
        Setting(
            "octree.filter_albedo_glossy",
            3.0,
            "the same with octree.layered, for what glossy surfaces reflect",
            0,
            1e6,
            of="image",
        ),
        Setting(
            "octree.filter_luminance",
            3.0,
            "of octree.filter=bilateral: how much a neighbour loses by having other light, as far as that is no noise; more keeps shadows'"
            " edges, and noise",
            0,
            1e6,
            of="image",
        ),
        Setting(
            "temporal.history",
            "bicubic",
            "how temporal filters read the frame before between its pixels: bicubic stays sharper",
            choices=("bilinear", "bicubic"),
            of="image",
            trade=("bilinear", "bicubic"),
        ),
        Setting(
            "taa.alpha",
            0.1,
            "weight of the new frame against the history, of --temporal taa",
            0,
            1,
            of="image",
            trade=(0.05, 0.1, 0.2),
        ),
        Setting(
            "taa.validation",
            "clamp",
            "what becomes of a history that lies outside the new pixel's neighbourhood of 3x3: it is kept, dropped, put to the"
            " edge of the neighbours' range, or drawn towards their mean as far as taa.gamma standard deviations",
            choices=("none", "reject", "clamp", "clip"),
            of="image",
            trade=("none", "reject", "clamp", "clip"),
        ),
        Setting(
            "taa.gamma",
            1.0,
            "standard deviations that taa.validation=clip lets the history be off",
            0,
            10,
            of="image",
            trade=(0.5, 1.0, 2.0),
        ),
        Setting(
            "varianceblend.per_channel",
            False,
            "of both --temporal and --stereo-blend varianceblend: weigh each colour channel by its own variance; else all three by"
            " that of the luminance",
            of="image",
            trade=(False, True),
        ),
        Setting(
            "varianceblend.estimate",
            "corrected",
            "how --temporal varianceblend estimates the history's bias: as published, where the new frame's noise counts as bias,"
            " or corrected for that noise; --stereo-blend varianceblend does it as published",
            choices=("published", "corrected"),
            of="image",
            trade=("published", "corrected"),
        ),
        Setting(
            "stereo.beta",
            0.5,
            "weight of the own eye's colour, of --stereo-blend constant",
            0,
            1,
            of="image",
            trade=(0.5, 0.75),
        ),
        Setting(
            "memo.capacity",
            0,
            "texels, or tiles, that the cache of material graphs has room for: a larger one forgets less, and takes memory; 0: as many"
            " as hold 2^21 texels",
            0,
            2**28,
            trade=(32768, 0),
        ),
        Setting(
            "memo.probe",
            8,
            "places of the cache that a texel or tile may be at: more of them fill the table better, and take longer to search",
            1,
            64,
        ),
        Setting(
            "memo.eviction",
            "lru-frame",
            "what makes room where all places are taken: nothing, so that what is new is discarded; a place at random; or what was"
            " written (lrw) or used (lru) longest ago, by the frame, or by a counter that tells more apart and is written more often",
            choices=("none", "random", "lrw-frame", "lru-frame", "lrw-counter", "lru-counter"),
            trade=("none", "random", "lru-frame"),
        ),
        Setting(
            "memo.tile",
            "4x4",
            "texels of a tile, width x height, with those that neighbours share under memo.filter=bilinear: larger tiles are missed"
            " less often, and have more texels that nothing asks for",
            choices=("2x2", "3x3", "4x4", "5x5", "6x5", "8x4"),
            trade=("2x2", "4x4", "8x4"),
        ),
        Setting(
            "memo.filter",
            "nearest",
            "how tiles are read: the nearest texel, or four of them, which is smoother, takes longer, and stores a row and a column twice",
            choices=("nearest", "bilinear"),
            trade=("nearest", "bilinear"),
        ),
        Setting(
            "memo.snap",
            True,
            "of --memo texel: evaluate graphs at the texel's own place, so that images repeat bit for bit; else where the first hit in"
            " it lies, which shows less of a grid, and depends on the order of threads",
        ),
        Setting(
            "memo.bias",
            0.0,
            "added to the level of detail of texels: 1 halves their width, which is sharper, and fills the cache four times as fast",
            -4,
            4,
            trade=(-1.0, 0.0, 1.0),
        ),
        Setting(
            "memo.primary",
            True,
            "whether hits of camera rays are memoized, too; else the cache blurs only what is seen by way of other surfaces",
            trade=(True, False),
        ),
        Setting(
            "memo.precision",
            "float",
            "how values are stored; as half they take half the memory, and keep 11 bits",
            choices=("float", "half"),
            trade=("half", "float"),
        ),
        Setting(
            "memo.auto",
            True,
            "memoize only graphs that get faster by it: by times that are measured before the first frame, and by the hits since; two runs"
            " may decide differently, and so differ in the image",
        ),
        Setting(
            "memo.read",
            "counter",
            "how a reader knows that an entry was not written meanwhile: by its key, read before and after, or by a counter of its writes,"
            " which also tells where the same key came back",
            choices=("key", "counter"),
        ),
        Setting(
            "memo.layout",
            "buffer",
            "where tiles are stored, which changes only the speed: behind their keys, in a buffer of their own, or in images",
            choices=("entry", "buffer", "image2d", "image3d"),
        ),
        Setting(
            "memo.builder",
            "serial",
            "how a tile is built, which changes only the speed: by one work-item after the other, or by the lanes of a sub-group together",
            choices=("lanes", "serial"),
        ),
        Setting(
            "memo.grouped",
            False,
            "of memo.builder=lanes: build tiles of the same graph together, which spares lanes waiting and costs the sorting; images stay"
            " the same",
        ),
        Setting(
            "memo.passes",
            "1",
            "whether hits are looked up all at once; in 2 or 4 turns, of which later ones find what earlier ones stored; or, of pathtrace,"
            " after the paths of one pixel of each 2x2, 4x4 or 8x8, which fill the cache: less is evaluated twice, for more launches",
            choices=("1", "2", "4", "prepass2", "prepass4", "prepass8"),
        ),
        Setting(
            "device.local_size",
            64,
            "work-items in a work-group of kernels that do not prescribe it; no effect on the image",
            1,
            1024,
            of="speed",
        ),
        Setting(
            "device.fast_math",
            False,
            "let the compiler round less carefully where no hit is decided: reorder sums, divide and take roots by approximations",
            of="image",
            trade=(True, False),
        ),
    )
}

# Methods with a cache, whose frames hold samples of earlier ones; spp counts the updates of each frame.
CACHED_METHODS = ("samplecache", "isrt", "voxelhash", "hybrid", "octree")

TEMPORALS = ("none", "taa", "varianceblend")  # what a frame can be joined with those before it by
DEFAULT_TEMPORALS = {"voxelhash": "varianceblend"}  # by method; of the others none

MEMOS = ("off", "texel", "tile")  # how values of material graphs can be kept

STEREO_BLENDS = ("none", "constant", "varianceblend", "samples")  # what a stereo render can join the eyes by


def _bound(value: float | None) -> str:
    """The end of a range in words; whole numbers with all their digits."""
    return "" if value is None else str(value) if isinstance(value, int) else f"{value:g}"


def find(name: str) -> Setting:
    """The setting of this dotted name. Raises SettingError, with the nearest known name."""
    if name in SETTINGS:
        return SETTINGS[name]
    near = difflib.get_close_matches(name, SETTINGS, 1)
    raise SettingError(
        f"setting {name}: unknown" + (f"; did you mean {near[0]}?" if near else "; 'clcache settings' lists all")
    )


def resolve(*layers: Mapping[str, object]) -> dict[str, bool | int | float | str]:
    """All settings by name: defaults, overridden by each layer in turn (values as text or typed). Raises SettingError."""
    values: dict[str, bool | int | float | str] = {name: s.default for name, s in SETTINGS.items()}
    for layer in layers:
        for name, value in layer.items():
            values[name] = find(name).parse(value)
    return values
