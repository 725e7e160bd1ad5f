"""Surface shaders of MaterialX as this package's surface: metallic-roughness, as glTF defines it.

All supported shaders are the same layers under other names: a diffuse base, a metal, a dielectric reflection, transmission
and emission, which the surface has; and a coat, sheen, anisotropy, a thin film, which it lacks. What it lacks is left
out, and said so where its weight is not 0. Subsurface scattering is taken for diffuse reflection of its colour, which it
looks like where light travels far less than the object is wide.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from ..errors import SceneError
from .mtlx_signals import Builder, Signal

LARGEST_IOR = 10.0

Constants = dict[str, float | bool | tuple[float, ...]]


@dataclass(frozen=True)
class Shader:
    """The names of a shader's inputs for each parameter; "" where it has none. lacking: inputs that the surface has nothing
    for, what they are called in a note, and the value at which they do nothing. tints_edges: whether specular_color is that of
    a metal's edges, too."""

    base: str
    base_color: str
    metallic: str
    roughness: str
    specular: str
    specular_color: str
    ior: str
    transmission: str
    transmission_color: str
    subsurface: str
    subsurface_color: str
    thin: str
    emission: str
    emission_color: str
    normal: str
    lacking: dict[str, tuple[str, float]] = field(default_factory=dict)
    tints_edges: bool = False


SHADERS = {
    "standard_surface": Shader(
        base="base",
        base_color="base_color",
        metallic="metalness",
        roughness="specular_roughness",
        specular="specular",
        specular_color="specular_color",
        ior="specular_IOR",
        transmission="transmission",
        transmission_color="transmission_color",
        subsurface="subsurface",
        subsurface_color="subsurface_color",
        thin="thin_walled",
        emission="emission",
        emission_color="emission_color",
        normal="normal",
        lacking={
            "diffuse_roughness": ("roughness of the diffuse reflection", 0.0),
            "specular_anisotropy": ("anisotropy of the reflection", 0.0),
            "transmission_depth": ("absorption inside the body", 0.0),
            "transmission_scatter": ("scattering inside the body", 0.0),
            "transmission_dispersion": ("dispersion", 0.0),
            "transmission_extra_roughness": ("roughness of the transmission alone", 0.0),
            "sheen": ("sheen", 0.0),
            "coat": ("coat", 0.0),
            "thin_film_thickness": ("thin film", 0.0),
            "opacity": ("opacity", 1.0),
        },
        tints_edges=True,
    ),
    "gltf_pbr": Shader(
        base="",
        base_color="base_color",
        metallic="metallic",
        roughness="roughness",
        specular="specular",
        specular_color="specular_color",
        ior="ior",
        transmission="transmission",
        transmission_color="",
        subsurface="",
        subsurface_color="",
        thin="",
        emission="emissive_strength",
        emission_color="emissive",
        normal="normal",
        lacking={
            "occlusion": ("ambient occlusion", 1.0),
            "alpha_mode": ("alpha", 0.0),
            "iridescence": ("iridescence", 0.0),
            "sheen_color": ("sheen", 0.0),
            "clearcoat": ("clear coat", 0.0),
            "anisotropy_strength": ("anisotropy of the reflection", 0.0),
            "dispersion": ("dispersion", 0.0),
            "attenuation_color": ("absorption inside the body", 1.0),
        },
    ),
    "open_pbr_surface": Shader(
        base="base_weight",
        base_color="base_color",
        metallic="base_metalness",
        roughness="specular_roughness",
        specular="specular_weight",
        specular_color="specular_color",
        ior="specular_ior",
        transmission="transmission_weight",
        transmission_color="transmission_color",
        subsurface="subsurface_weight",
        subsurface_color="subsurface_color",
        thin="geometry_thin_walled",
        emission="emission_luminance",
        emission_color="emission_color",
        normal="geometry_normal",
        lacking={
            "base_diffuse_roughness": ("roughness of the diffuse reflection", 0.0),
            "specular_roughness_anisotropy": ("anisotropy of the reflection", 0.0),
            "transmission_depth": ("absorption inside the body", 0.0),
            "transmission_scatter": ("scattering inside the body", 0.0),
            "transmission_dispersion_scale": ("dispersion", 0.0),
            "fuzz_weight": ("fuzz", 0.0),
            "coat_weight": ("coat", 0.0),
            "thin_film_weight": ("thin film", 0.0),
            "geometry_opacity": ("opacity", 1.0),
        },
        tints_edges=True,
    ),
}
# Outputs that are parts of something, and so stay in [0, 1].
PARTS = ("base_color", "metallic", "roughness", "specular")


def surface_of(
    shader: Shader, b: Builder, parameter: Callable[[str], Signal], normal: Signal | None
) -> tuple[dict[str, Signal], Constants]:
    """The outputs of a graph and the constants of a material that a shader's parameters make.

    parameter: the value of an input of the shader. normal: what its normal is connected to. Raises SceneError for parameters
    that the surface holds only as constants and that are connected to nodes that vary."""

    at = b.place

    def value_of(name: str) -> Signal:
        value = parameter(name)
        b.place = at
        return value

    def value_or_none(name: str) -> Signal | None:
        """None for what is not supported, which matters not where it is left out."""
        try:
            return parameter(name)
        except SceneError:
            return None
        finally:
            b.place = at

    def constant(name: str) -> float:
        value = parameter(name)
        if value.constant is None:
            b.fail(f"{name} varies over the surface; expected a constant")
        b.place = at
        return value.constant[0]

    transmission = _between(b, shader.transmission, constant(shader.transmission), 0.0, 1.0)
    ior = _between(b, shader.ior, constant(shader.ior), 1.0, LARGEST_IOR)
    # Without a volume, glTF's transmission is that of a thin wall.
    thin = bool(constant(shader.thin)) if shader.thin else transmission > 0.0 and constant("thickness") == 0.0
    values = {
        "base_color": _base_color(shader, b, value_of, transmission),
        "metallic": value_of(shader.metallic),
        "roughness": value_of(shader.roughness),
        "specular": value_of(shader.specular),
        "specular_color": value_of(shader.specular_color),
        "emission": value_of(shader.emission_color) * value_of(shader.emission),
    }
    for name, (what, without) in shader.lacking.items():
        if name.startswith(("transmission", "attenuation")) and transmission == 0.0:
            continue
        if not _is(value_or_none(name), without):
            b.note(f"its {what} is left out ({name})")
    if shader.tints_edges and not _is(values["metallic"], 0.0) and not _is(values["specular_color"], 1.0):
        b.note(f"its colour of a metal's edges is left out ({shader.specular_color})")
    outputs, constants = {}, {"ior": ior, "transmission": transmission, "thin": thin}
    for name, value in values.items():
        if value.constant is None:
            outputs[name] = value
            continue
        limit = 1.0 if name in PARTS else float("inf")
        numbers = tuple(_between(b, name, x, 0.0, limit) for x in value.constant)
        constants[name] = numbers if len(numbers) > 1 else numbers[0]
    if normal is not None and not _is_the_meshs(b, normal):
        if not normal.tangent:
            b.fail("its normal is connected to a node that is no normalmap; expected a normalmap")
        outputs["normal"] = normal
    return outputs, constants


def _is(signal: Signal | None, value: float) -> bool:
    """Whether a signal is that number, in all channels, everywhere."""
    return signal is not None and signal.constant is not None and all(x == value for x in signal.constant)


def _base_color(shader: Shader, b: Builder, parameter: Callable[[str], Signal], transmission: float) -> Signal:
    """The colour of what is neither reflected by the dielectric nor emitted: the diffuse base, of which subsurface scattering
    and transmission take their parts."""
    color = parameter(shader.base_color)
    if shader.base:
        color = color * parameter(shader.base)
    if shader.subsurface:
        weight = parameter(shader.subsurface)
        if weight.constant is None or weight.constant[0] > 0.0:
            b.note("its subsurface scattering is approximated by diffuse reflection")
        color = b.call("Mix", Fg=parameter(shader.subsurface_color), Bg=color, Mix=weight)
    if shader.transmission_color and transmission > 0.0:
        if transmission < 1.0:
            b.note("its diffuse and its transmitted light get the same colour")
        color = b.call("Mix", Fg=parameter(shader.transmission_color), Bg=color, Mix=transmission)
    return color


def _between(b: Builder, name: str, value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        b.note(f"{name} of {value:g} is taken as {min(max(value, low), high):g}")
    return min(max(value, low), high)


def _is_the_meshs(b: Builder, normal: Signal) -> bool:
    """Whether a normal is the one that the mesh has anyway."""
    return normal.constant is None and b.nodes[normal.source.node].kind == "NormalInput"
