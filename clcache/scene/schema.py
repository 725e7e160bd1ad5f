"""The keys of a TOML scene file: their types, ranges, defaults and meanings. Unknown keys are errors."""

import difflib
import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag, model_validator
from pydantic_core import PydanticCustomError

from . import generators

MAX_TRIANGLES = 20_000_000  # of one generated mesh; about 2 GB while it is built


class Table(BaseModel):
    """A table of the file. Its docstring and its fields' descriptions are the reference of the format."""

    model_config = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False, frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        for key in data if isinstance(data, dict) else ():
            if key not in cls.model_fields:
                raise PydanticCustomError(
                    "unknown_key", "{hint}", {"key": key, "hint": _hint(key, list(cls.model_fields))}
                )
        return data


def _hint(key: str, known: list[str]) -> str:
    near = difflib.get_close_matches(key, known, 1, cutoff=0.5)
    return "unknown key; " + (f"did you mean {near[0]}?" if near else f"expected one of {', '.join(known)}")


def _list_of(count: int, what: str) -> BeforeValidator:
    def check(value: Any) -> Any:
        if not isinstance(value, list) or len(value) != count:
            raise PydanticCustomError("list_of", "expected a list of {count} {what}", {"count": count, "what": what})
        return tuple(value)

    return BeforeValidator(check)


def _direction(value: tuple[float, float, float]) -> tuple[float, float, float]:
    length = math.hypot(*value)
    if length == 0 or math.isinf(length):
        raise PydanticCustomError("no_direction", "expected a vector whose length is neither 0 nor infinite")
    return tuple(x / length for x in value)


Coordinate = Annotated[float, Field(ge=-1e30, le=1e30)]
Length = Annotated[float, Field(gt=0, le=1e18)]
Vector = Annotated[tuple[Coordinate, Coordinate, Coordinate], _list_of(3, "numbers")]
Direction = Annotated[Vector, AfterValidator(_direction)]
Quaternion = Annotated[tuple[Coordinate, Coordinate, Coordinate, Coordinate], _list_of(4, "numbers")]
Row = Annotated[tuple[Coordinate, Coordinate, Coordinate, Coordinate], _list_of(4, "numbers")]
Fraction = Annotated[float, Field(ge=0, le=1)]
Reflectance = Annotated[
    tuple[Fraction, Fraction, Fraction], _list_of(3, "numbers from 0 to 1: linear red, green, blue")
]
Strength = Annotated[float, Field(ge=0, le=1e30)]
Radiance = Annotated[tuple[Strength, Strength, Strength], _list_of(3, "numbers from 0 up: linear red, green, blue")]
Scale = Annotated[Vector, BeforeValidator(lambda v: [v] * 3 if isinstance(v, int | float) else v)]
Count = Annotated[int, Field(ge=1)]


class Rotation(Table):
    """A turn about an axis, counter-clockwise as seen from the axis's tip."""

    axis: Direction = Field(description="any length but 0")
    degrees: Coordinate


class Placement(Table):
    """Where something stands: `matrix` alone, or scale, then rotation, then translation."""

    translation: Vector | None = Field(None, description="metres")
    rotation: Rotation | None = Field(None, description="{ axis = [x, y, z], degrees = a }")
    quaternion: Quaternion | None = Field(None, description="rotation as [x, y, z, w]; any length but 0")
    scale: Scale | None = Field(None, description="one number, or one for each axis")
    matrix: Annotated[tuple[Row, Row, Row], _list_of(3, "rows of 4 numbers")] | None = Field(
        None, description="3 rows of 4 numbers; applied to column vectors"
    )

    @model_validator(mode="after")
    def _one_form(self) -> "Placement":
        if self.matrix and (self.translation or self.rotation or self.quaternion or self.scale):
            raise PydanticCustomError(
                "forms", "matrix excludes translation, rotation, quaternion and scale; expected one form"
            )
        if self.rotation and self.quaternion:
            raise PydanticCustomError("forms", "rotation and quaternion exclude each other; expected one form")
        return self


class FileMesh(Table):
    """A mesh file with all that is in it."""

    file: str = Field(
        min_length=1, description="path beside the scene file; any mesh file that clcache renders by itself"
    )


class Sphere(Table):
    """A geodesic sphere about the origin, smooth, of 20 * 4**subdivisions triangles."""

    generator: Literal["sphere"]
    radius: Length = 1.0
    subdivisions: Annotated[int, Field(ge=0, le=9)] = 5

    def shape(self) -> generators.Shape:
        return generators.sphere(self.radius, self.subdivisions)


class Box(Table):
    """A box about the origin."""

    generator: Literal["box"]
    size: Annotated[tuple[Length, Length, Length], _list_of(3, "lengths")] = (1.0, 1.0, 1.0)

    def shape(self) -> generators.Shape:
        return generators.box(self.size)


class Plane(Table):
    """A rectangle about the origin in the XZ plane, facing +Y."""

    generator: Literal["plane"]
    size: Annotated[tuple[Length, Length], _list_of(2, "lengths, along x and z")] = (1.0, 1.0)

    def shape(self) -> generators.Shape:
        return generators.plane(self.size)


class Grid(Table):
    """A plane cut into cells of two triangles each."""

    generator: Literal["grid"]
    size: Annotated[tuple[Length, Length], _list_of(2, "lengths, along x and z")] = (1.0, 1.0)
    cells: Annotated[tuple[Count, Count], _list_of(2, "whole numbers, along x and z")] = (10, 10)

    @model_validator(mode="after")
    def _bounded(self) -> "Grid":
        if 2 * self.cells[0] * self.cells[1] > MAX_TRIANGLES:
            raise PydanticCustomError(
                "too_many", "cells make more than {most} triangles; expected fewer", {"most": MAX_TRIANGLES}
            )
        return self

    def shape(self) -> generators.Shape:
        return generators.grid(self.size, self.cells)


class Hairball(Table):
    """A ball of thin curled ribbons about the origin, flat-shaded; exactly `triangles` triangles."""

    generator: Literal["hairball"]
    triangles: Annotated[int, Field(ge=1, le=MAX_TRIANGLES)] = 1_000_000
    segments: Annotated[int, Field(ge=1, le=10_000, description="pairs of triangles along a hair")] = 50
    radius: Length = 1.0
    thickness: Annotated[float, Field(gt=0, description="width of a hair, in radii", le=0.5)] = 0.002
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 1

    def shape(self) -> generators.Shape:
        return generators.hairball(self.triangles, self.segments, self.radius, self.thickness * self.radius, self.seed)


# The names of alternatives appear in the places of errors; none of them is also the name of a key.


def _mesh_kind(table: Any) -> str | None:
    if not isinstance(table, dict):
        return None
    return f"{'file' if 'file' in table else table.get('generator')} mesh"


def _light_kind(table: Any) -> str | None:
    return f"{table.get('type')} light" if isinstance(table, dict) else None


MeshSource = Annotated[
    Annotated[FileMesh, Tag("file mesh")]
    | Annotated[Sphere, Tag("sphere mesh")]
    | Annotated[Box, Tag("box mesh")]
    | Annotated[Plane, Tag("plane mesh")]
    | Annotated[Grid, Tag("grid mesh")]
    | Annotated[Hairball, Tag("hairball mesh")],
    Discriminator(
        _mesh_kind,
        custom_error_type="mesh_kind",
        custom_error_message="expected file = a path, or generator = sphere, box, plane, grid or hairball",
    ),
]


class InstanceTable(Placement):
    """A mesh placed in the world."""

    mesh: str = Field(description="name of a table in [meshes]")
    material: str | None = Field(None, description="name of a table in [materials]; replaces the mesh's own materials")


class MaterialTable(Table):
    """A Lambertian surface."""

    base_color: Reflectance = (0.8, 0.8, 0.8)
    base_color_texture: str | None = Field(
        None, min_length=1, description="path of a picture; multiplied with base_color"
    )
    emission: Radiance = Field((0.0, 0.0, 0.0), description="W / (m^2 sr)")


class PointTable(Table):
    """A point that radiates evenly."""

    type: Literal["point"]
    position: Vector
    intensity: Radiance = Field(description="W / sr")


class DirectionalTable(Table):
    """Parallel light, as from the sun."""

    type: Literal["directional"]
    direction: Direction = Field(description="along which the light travels; any length but 0")
    irradiance: Radiance = Field(description="W / m^2 on a surface that faces the light")


LightTable = Annotated[
    Annotated[PointTable, Tag("point light")] | Annotated[DirectionalTable, Tag("directional light")],
    Discriminator(
        _light_kind,
        custom_error_type="light_kind",
        custom_error_message="expected type = point or directional",
    ),
]


class EnvironmentTable(Table):
    """Light from all around, where no mesh is."""

    color: Radiance = Field(description="W / (m^2 sr)")


class CameraTable(Table):
    """A pinhole camera, placed by position with look_at, or by a pose whose -Z axis it looks along."""

    position: Vector | None = None
    look_at: Vector | None = Field(None, description="the point in the middle of the picture")
    up: Direction = Field((0.0, 1.0, 0.0), description="with look_at: the direction that is upwards in the picture")
    pose: Annotated[tuple[Row, Row, Row], _list_of(3, "rows of 4 numbers")] | None = Field(
        None, description="3 rows of 4 numbers, camera to world, without scale"
    )
    fov_y: Annotated[float, Field(gt=0, lt=180)] = Field(40.0, description="vertical field of view, degrees")
    near: Annotated[float, Field(ge=0, le=1e18)] = Field(0.0, description="metres along the viewing axis")

    @model_validator(mode="after")
    def _one_form(self) -> "CameraTable":
        if (self.pose is None) == (self.position is None or self.look_at is None):
            raise PydanticCustomError("forms", "expected position and look_at, or pose")
        if self.pose is not None and (self.position or self.look_at or "up" in self.model_fields_set):
            raise PydanticCustomError("forms", "pose excludes position, look_at and up")
        return self


class RenderTable(Table):
    """What a render uses where the command line says nothing else."""

    size: Annotated[
        tuple[Annotated[int, Field(ge=1, le=65536)], Annotated[int, Field(ge=1, le=65536)]],
        _list_of(2, "whole numbers, width and height"),
    ] = (640, 360)
    frames: Annotated[
        tuple[Annotated[int, Field(ge=0, le=2**31 - 1)], Annotated[int, Field(ge=0, le=2**31 - 1)]],
        _list_of(2, "whole numbers: the first frame and the one after the last"),
    ] = (0, 1)
    fps: Annotated[float, Field(gt=0, le=1e6)] = 30.0
    stereo: bool = False
    eye_distance: Annotated[float, Field(ge=0, le=1e18)] = Field(0.063, description="metres")
    spp: Annotated[int, Field(ge=1, le=2**20)] | None = Field(None, description="samples per pixel and frame")
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] | None = None
    method: Annotated[str, Field(min_length=1)] | None = None
    settings: dict[str, Any] = Field({}, description="dotted names and values, as for --set")

    @model_validator(mode="after")
    def _some_frame(self) -> "RenderTable":
        if self.frames[1] <= self.frames[0]:
            raise PydanticCustomError("frames", "frames: the range is empty; expected [first, one after the last]")
        return self


class SceneTable(Table):
    """The whole file."""

    meshes: dict[str, MeshSource] = {}
    instances: list[InstanceTable] = []
    materials: dict[str, MaterialTable] = {}
    lights: list[LightTable] = []
    environment: EnvironmentTable | None = None
    camera: CameraTable | None = None
    render: RenderTable = RenderTable()
