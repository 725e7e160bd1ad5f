"""The AOVs: what a frame can carry beside its colour, declared once for passes, files and the command line."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Aov:
    """One AOV: its name, the channels that it has in a file with a single view, what they mean, and whether files have it
    where nothing else is said.

    An AOV of one channel is an (H, W) image, one of three channels (H, W, 3); all are float32.
    """

    name: str
    channels: tuple[str, ...]
    meaning: str
    default: bool = True


AOVS: dict[str, Aov] = {
    aov.name: aov
    for aov in (
        Aov(
            "albedo",
            ("albedo.R", "albedo.G", "albedo.B"),
            "linear Rec. 709 albedo of the first hit; 0 where nothing was hit",
        ),
        Aov("N", ("N.X", "N.Y", "N.Z"), "unit shading normal of the first hit, world space; 0 where nothing was hit"),
        Aov(
            "variance",
            ("variance.R", "variance.G", "variance.B"),
            "variance of the colour as an estimate of the true mean, from the spread of the pixel's samples",
            default=False,
        ),
        Aov("samples", ("samples",), "samples that the pixel's colour is the mean of", default=False),
        Aov("occupancy", ("occupancy",), "cached samples in the pixel's slots", default=False),
        Aov("visible", ("visible",), "those of them that are visible", default=False),
        Aov(
            "age",
            ("age",),
            "updates (of --spp 1, frames): mean age of the visible samples; of voxelhash, since the voxel's last access before this update,"
            " infinite where it is new",
            default=False,
        ),
        Aov("trace", ("trace",), "part of the pixel's samples that were traced in this frame, 0 to 1", default=False),
        Aov("voxel", ("voxel.R", "voxel.G", "voxel.B"), "a colour of its own for each voxel, or cell", default=False),
        Aov(
            "level",
            ("level",),
            "level of the voxel, whose edges are 2^level metres; of octree, of the cell, 0 being the whole scene; infinite where there is"
            " none",
            default=False,
        ),
        Aov(
            "count", ("count",), "radiance samples that the voxel's, or the cell's, light is the mean of", default=False
        ),
        *(
            Aov(
                f"{name}{layer}",
                tuple(f"{name}{layer}.{channel}" for channel in "RGB"),
                f"light from the {order} surface along specular and glossy paths, with all from behind it, {when} the filter",
                default=False,
            )
            for name, when in (("layer", "before"), ("filtered", "after"))
            for layer, order in enumerate(("first", "second", "third"))
        ),
        Aov("alpha", ("alpha",), "weight of the new frame in the temporal filter, 0 to 1", default=False),
        Aov(
            "effective",
            ("effective",),
            "effective sample count of the temporally filtered pixel, in frames: how many of equal weight had as little noise",
            default=False,
        ),
        Aov("beta", ("beta",), "weight of the own eye's colour in the stereo blend, 0 to 1", default=False),
        Aov(
            "Z",
            ("Z",),
            "planar depth along the viewing axis of the nearest first hit, metres; +inf where nothing was hit",
        ),
    )
}

DEFAULT_AOVS = tuple(aov.name for aov in AOVS.values() if aov.default)
