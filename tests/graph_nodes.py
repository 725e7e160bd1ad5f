"""Every overload of every node of material graphs, called on a device and in NumPy with the same rows of numbers."""

from dataclasses import dataclass

import numpy as np

from clcache.device import Device
from clcache.graph.infer import width_of
from clcache.graph.interpret import convert
from clcache.graph.library import Overload, library
from clcache.graph.numpy_nodes import NODES, Dual
from clcache.layout import STRUCTS
from clcache.scene.model import WRAP_MODES, Texture
from clcache.scene.textures import mip_chain, srgb_to_linear

INPUT_KINDS = ("UVInput", "PositionInput", "NormalInput")
WORDS = 12  # of a socket in a row: up to four components, and their changes along both axes

OVERLOADS = tuple(o for overloads in library().values() for o in overloads if o.kind not in INPUT_KINDS)


def is_dual(type_name: str) -> bool:
    return type_name.endswith("_D")


def label(overload: Overload) -> str:
    return f"{overload.kind}({', '.join(overload.inputs.values())} -> {', '.join(overload.outputs.values())})"


def with_changes(overload: Overload) -> bool:
    """Whether any output carries changes."""
    return any(is_dual(t) for t in overload.outputs.values())


@dataclass(frozen=True)
class Sockets:
    """Values of sockets by name: (n, width) each; changes: (2, n, width) of those that carry any."""

    values: dict[str, np.ndarray]
    changes: dict[str, np.ndarray]


def run_in_numpy(
    overload: Overload, given: Sockets, integers: dict[str, int], texture: Texture | None = None
) -> Sockets:
    """What clcache.graph.numpy_nodes computes of the same, in the dtype of the values."""
    arguments: dict[str, object] = {}
    for name, type_name in overload.inputs.items():
        changes = given.changes.get(name, (None, None))
        arguments[name] = convert(Dual(given.values[name], *changes), type_name, len(given.values[name]))
    arguments |= {name: texture if name == "Texture" else integers[name] for name in overload.integers}
    with np.errstate(all="ignore"):
        result = NODES[overload.kind](**arguments)
        results = result if isinstance(result, dict) else {"Out": result}
        points = len(next(iter(given.values.values())))
        duals = {name: convert(results[name], type_name, points) for name, type_name in overload.outputs.items()}
    return Sockets(
        {name: dual.v for name, dual in duals.items()},
        {name: np.stack([dual.x, dual.y]) for name, dual in duals.items() if dual.x is not None},
    )


class NodesOnDevice:
    """Programs that call the overloads, a few dozen in each."""

    def __init__(self, device: Device, overloads: tuple[Overload, ...] = OVERLOADS, texture: Texture | None = None):
        self._device, self._overloads = device, overloads
        self._program = device.program("every_node.cl", {"every_node.cl": _source(overloads)})
        arrays = texture_arrays(texture or Texture("none", np.zeros((1, 1, 4), np.uint8)))
        self._maps = {name: device.upload(a) for name, a in arrays.items()}

    def __call__(self, overload: Overload, given: Sockets, integers: dict[str, int]) -> Sockets:
        """The outputs of one overload. integers: of each of its int parameters; Texture is 0."""
        n = len(next(iter(given.values.values())))
        rows = np.zeros((n, len(overload.inputs), 3, 4), np.float32)
        for k, name in enumerate(overload.inputs):
            value = given.values[name]
            rows[:, k, 0, : value.shape[1]] = value
            if name in given.changes:
                rows[:, k, 1:, : value.shape[1]] = given.changes[name].transpose(1, 0, 2)
        uploaded = self._device.upload(rows)  # large arrays are host memory, which must outlive the kernel
        out = self._device.empty((n, len(overload.outputs), 3, 4), np.float32)
        numbers = [integers.get(name, 0) for name in overload.integers] or [0]
        self._program["call_node"].run(
            n, self._maps, given=uploaded, out=out, node=self._overloads.index(overload),
            integer=numbers[0],
            sockets=len(overload.inputs), outputs=len(overload.outputs), n=n,
        )  # fmt: skip
        result = out.get()
        values, changes = {}, {}
        for k, (name, type_name) in enumerate(overload.outputs.items()):
            values[name] = result[:, k, 0, : width_of(type_name)]
            if is_dual(type_name):
                changes[name] = result[:, k, 1:, : width_of(type_name)].transpose(1, 0, 2)
        return Sockets(values, changes)


def texture_arrays(*textures: Texture) -> dict[str, np.ndarray]:
    """The arrays of Maps for textures that are used as they are, in this order."""
    uses = np.zeros(len(textures), STRUCTS["TextureUse"])
    uses["texture"], uses["transform"] = np.arange(len(textures)), [1, 0, 0, 0, 1, 0]
    records, texels = np.zeros(len(textures), STRUCTS["Texture"]), []
    for record, texture in zip(records, textures, strict=True):
        chain = mip_chain(texture)
        record["height"], record["width"] = texture.pixels.shape[:2]
        record["levels"], record["srgb"] = len(chain), texture.srgb
        record["wrap"] = [WRAP_MODES.index(mode) for mode in texture.wrap]
        for k, level in enumerate(chain):
            record["first_texel"][k] = sum(map(len, texels))
            texels.append(np.ascontiguousarray(level).reshape(-1, 4).view("<u4")[:, 0])
    table = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
    return {"uses": uses, "textures": records, "texels": np.concatenate(texels), "srgb": table}


def _source(overloads: tuple[Overload, ...]) -> str:
    headers = dict.fromkeys(["graph/types.cl", "scene/maps.cl", *(f"graph/{f}" for o in overloads for f in o.needs)])
    parts = [f'#include "{header}"' for header in headers]
    parts += dict.fromkeys(o.source for o in overloads)
    parts += [_READ]
    parts += [_call(k, overload) for k, overload in enumerate(overloads)]
    cases = "\n".join(f"    case {k}: call_{k}(in, values, integer, &maps); break;" for k in range(len(overloads)))
    return "\n".join(parts) + _KERNEL.replace("CASES", cases)


def _call(number: int, overload: Overload) -> str:
    lines, arguments, sockets = [], [], 0
    for name in overload.parameters:
        if name in overload.inputs:
            type_name = overload.inputs[name]
            plain, at = type_name.removesuffix("_D"), f"in + {WORDS * sockets}"
            width = "" if width_of(plain) == 1 else width_of(plain)
            reads = [f"read{width}({at} + {4 * k})" for k in range(3)]
            lines.append(
                f"{type_name} {name}_ = "
                + (f"with_changes({', '.join(reads)});" if is_dual(type_name) else f"{reads[0]};")
            )
            arguments.append(name + "_")
            sockets += 1
        elif name in overload.outputs:
            lines.append(f"{overload.outputs[name]} {name}_;")
            arguments.append(f"&{name}_")
        else:
            arguments.append(
                "integer" if name in overload.integers and name != "Texture" else "0" if name == "Texture" else name
            )
    lines.append(f"{overload.kind}({', '.join(arguments)});")
    lines += [f"write({name}_, values + {WORDS * k});" for k, name in enumerate(overload.outputs)]
    body = "\n".join("    " + line for line in lines)
    head = (
        f"NOINLINE void call_{number}(__global const float *in, __global float *values, int integer, const Maps *maps)"
    )
    return f"{head}\n{{\n{body}\n}}"


_READ = """
float read(__global const float *in) { return in[0]; }
float2 read2(__global const float *in) { return vload2(0, in); }
float3 read3(__global const float *in) { return vload3(0, in); }
float4 read4(__global const float *in) { return vload4(0, in); }
NODE void write(float a, __global float *out) { out[0] = a; }
NODE void write(float2 a, __global float *out) { vstore2(a, 0, out); }
NODE void write(float3 a, __global float *out) { vstore3(a, 0, out); }
NODE void write(float4 a, __global float *out) { vstore4(a, 0, out); }
NODE void write(float_D a, __global float *out) { write(a.v, out); write(a.x, out + 4); write(a.y, out + 8); }
NODE void write(float2_D a, __global float *out) { write(a.v, out); write(a.x, out + 4); write(a.y, out + 8); }
NODE void write(float3_D a, __global float *out) { write(a.v, out); write(a.x, out + 4); write(a.y, out + 8); }
NODE void write(float4_D a, __global float *out) { write(a.v, out); write(a.x, out + 4); write(a.y, out + 8); }
"""

_KERNEL = """
__kernel void call_node(
    __global const float *given,         // (n, sockets, 3, 4)
    __global float *out,                 // (n, outputs, 3, 4)
    __global const TextureUse *uses,     // (uses)
    __global const Texture *textures,    // (textures)
    __global const uint *texels,         // (texels)
    __global const float *srgb,          // (256)
    int node,
    int integer,
    uint sockets,
    uint outputs,
    uint n)
{
    uint row = get_global_id(0);
    if (row >= n)
        return;
    Maps maps = { uses, textures, texels, srgb };
    __global const float *in = given + row * sockets * 12;
    __global float *values = out + row * outputs * 12;
    switch (node) {
CASES
    }
}
"""
