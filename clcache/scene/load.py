"""From a file to a `Scene`: read it by its kind, then choose the camera and the light that it does not bring."""

from pathlib import Path

from ..errors import SceneError
from . import framing
from .files import Folder
from .gltf import load_gltf
from .model import Defaults, Scene
from .part import Part
from .toml import TomlScene, load_toml


def load_scene(path: str | Path, *, allow_outside: bool = False) -> Scene:
    """Load a scene: a .toml scene file, or a .gltf, .glb, .obj, .ply, .stl, .off or other mesh file that trimesh reads.

    allow_outside: let the file name other files outside its folder. A file without a camera gets one that frames the
    scene; a file without light gets some; `Scene.notes` tells what was chosen. Raises SceneError, with one line that
    names the file, the place in it, and what is wrong there.
    """
    name = str(path)
    path = Path(path)
    try:
        if not path.is_file():
            raise SceneError(f"{name}: " + ("not a regular file" if path.exists() else "no such file"))
        folder = Folder(path.parent.resolve(), allow_outside)
        if path.suffix.lower() == ".toml":
            read = load_toml(path, name, folder, lambda file, named: _load_mesh_file(file, named, folder))
        else:
            read = TomlScene(_load_mesh_file(path, name, folder), None, Defaults())
        return _complete(name, read)
    except MemoryError:
        raise SceneError(f"{name}: the scene does not fit into this machine's memory") from None


def _load_mesh_file(path: Path, name: str, folder: Folder) -> Part:
    kind = path.suffix.lower().lstrip(".")
    if kind in ("gltf", "glb"):
        return load_gltf(path, name, folder)
    from . import meshfile  # which takes as long to import as most scenes to load

    if kind in meshfile.FORMATS:
        return meshfile.load_mesh_file(path, name, folder)
    known = ", ".join(f".{k}" for k in ("toml", "gltf", "glb", *meshfile.FORMATS))
    raise SceneError(
        f"{name}: {f'.{kind}' if kind else 'no suffix'}: not a kind of file that is read; expected {known}"
    )


def _complete(name: str, read: TomlScene) -> Scene:
    part = read.part
    if not part.instances:
        left_out = ", ".join(f"{count} {what}" for what, count in part.dropped.items())
        raise SceneError(f"{name}: the scene has no triangles" + (f" (left out: {left_out})" if left_out else ""))
    part.prune()
    notes = list(part.notes)
    camera, lights, environment = framing.complete(part, read.environment, read.defaults.size, notes)
    return Scene(
        file=name,
        meshes=tuple(part.meshes),
        instances=tuple(part.instances),
        materials=tuple(part.materials),
        textures=tuple(part.textures),
        lights=tuple(lights),
        environment=environment,
        camera=camera,
        defaults=read.defaults,
        dropped=dict(part.dropped),
        notes=tuple(notes),
        graph_seconds=part.graph_seconds,
    )
