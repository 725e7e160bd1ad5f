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
    animated: bool = Field(
        True, description="whether the file's animation is played; otherwise it stands as at 0 seconds"
    )
    materials: dict[str, str] = Field(
        {},
        description="{ \"name in the file\" = name of a table in [materials], ... }: what replaces the file's materials; 'default'"
        " is that of triangles without any",
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


Seconds = Annotated[float, Field(ge=-1e9, le=1e9)]


def _ascending(keys: tuple) -> tuple:
    for earlier, later in zip(keys[:-1], keys[1:], strict=True):
        if later.time <= earlier.time:
            raise PydanticCustomError(
                "ascending",
                "time {later} after {earlier}; expected times that ascend",
                {"later": later.time, "earlier": earlier.time},
            )
    return keys


class PlacementKey(Placement):
    """Where something stands at a time; what it does not say is as in the table around it."""

    time: Seconds = Field(description="seconds; keys ascend in time")

    @model_validator(mode="after")
    def _no_matrix(self) -> "PlacementKey":
        if self.matrix:
            raise PydanticCustomError(
                "forms", "matrix cannot be interpolated; expected translation, rotation and scale"
            )
        return self


class Moving(Table):
    """Something with key frames."""

    step: bool = Field(False, description="whether each key holds until the next, instead of moving on to it")


class InstanceTable(Placement, Moving):
    """A mesh placed in the world."""

    mesh: str = Field(description="name of a table in [meshes]")
    material: str | None = Field(None, description="name of a table in [materials]; replaces the mesh's own materials")
    keys: Annotated[list[PlacementKey], Field(min_length=1), AfterValidator(_ascending)] | None = Field(
        None, description="{ time = seconds, translation, rotation or quaternion, scale }, ..."
    )

    @model_validator(mode="after")
    def _keys_or_matrix(self) -> "InstanceTable":
        if self.keys and self.matrix:
            raise PydanticCustomError("forms", "matrix excludes keys; expected one form")
        return self


Wrap = Literal["repeat", "clamp", "mirror"]


def _pair(value: Any) -> Any:
    return [value] * 2 if isinstance(value, int | float | str) else value


class TextureTable(Table):
    """A picture and how texture coordinates find their place in it; a path alone stands for { file = path }."""

    file: str = Field(min_length=1, description="path of a picture that Pillow reads")
    wrap: Annotated[tuple[Wrap, Wrap], _list_of(2, "of repeat, clamp and mirror"), BeforeValidator(_pair)] = Field(
        ("repeat", "repeat"), description="beyond the picture: repeat, clamp or mirror; one, or one for u and v each"
    )
    scale: Annotated[tuple[Coordinate, Coordinate], _list_of(2, "numbers"), BeforeValidator(_pair)] = Field(
        (1.0, 1.0), description="of the texture coordinates: 2 shows the picture twice"
    )
    rotation: Coordinate = Field(0.0, description="of the scaled coordinates, degrees counter-clockwise in the picture")
    offset: Annotated[tuple[Coordinate, Coordinate], _list_of(2, "numbers")] = Field(
        (0.0, 0.0), description="added last, in pictures"
    )


def _path_or_table(value: Any) -> Any:
    return {"file": value} if isinstance(value, str) else value


TextureSource = Annotated[TextureTable, BeforeValidator(_path_or_table)]


class MaterialTable(Table):
    """A metallic-roughness surface, as glTF defines it; Lambertian where nothing but base_color is given."""

    base_color: Reflectance = (0.8, 0.8, 0.8)
    base_color_texture: TextureSource | None = Field(None, description="sRGB; multiplied with base_color")
    alpha_cutoff: Fraction | None = Field(
        None, description="there is no surface where the base colour's alpha is below"
    )
    metallic: Fraction = 0.0
    roughness: Fraction = Field(1.0, description="the square root of GGX's alpha; 0: a perfect mirror or window")
    metallic_roughness_texture: TextureSource | None = Field(
        None, description="blue multiplies metallic, green roughness"
    )
    specular: Fraction | None = Field(
        None,
        description="strength of a dielectric's reflection; default 1 if roughness, ior, specular_color or "
        "metallic_roughness_texture is given, else 0",
    )
    specular_color: Reflectance = Field((1.0, 1.0, 1.0), description="tint of that reflection at normal incidence")
    ior: Annotated[float, Field(ge=1, le=1e4)] = Field(1.5, description="refractive index")
    transmission: Fraction = Field(0.0, description="part of the light that enters a dielectric that goes through")
    thin: bool = Field(False, description="light goes straight through, as through a pane, instead of being refracted")
    emission: Radiance = Field((0.0, 0.0, 0.0), description="W / (m^2 sr)")
    emission_texture: TextureSource | None = Field(None, description="sRGB; multiplied with emission")
    normal_texture: TextureSource | None = Field(None, description="tangent-space normals, green up")
    normal_scale: Coordinate = 1.0
    double_sided: bool = Field(True, description="otherwise it is black and dark from behind")
    graph: str | None = Field(
        None,
        min_length=1,
        description="path of a .graph or MaterialX .mtlx document, which computes some of the above; the other keys stand beside it,"
        " and before what it sets to constants",
    )
    graph_material: str | None = Field(
        None, min_length=1, description="name of the material in the document, where there are several"
    )

    @model_validator(mode="after")
    def _something_to_multiply(self) -> "MaterialTable":
        if self.emission_texture is not None and not any(self.emission):
            raise PydanticCustomError(
                "no_emission", "emission_texture is multiplied with emission, which is 0; expected both"
            )
        return self

    @model_validator(mode="after")
    def _a_document_to_look_in(self) -> "MaterialTable":
        if self.graph_material is not None and not (self.graph or "").lower().endswith(".mtlx"):
            raise PydanticCustomError("no_document", "graph_material names a material of a .mtlx file; expected graph")
        return self


class PointKey(Table):
    """Where a point light is at a time."""

    time: Seconds
    position: Vector


class DirectionKey(Table):
    """Where a directional light shines at a time."""

    time: Seconds
    direction: Direction


class SpotKey(Table):
    """Where a spot light is and shines at a time."""

    time: Seconds
    position: Vector
    direction: Direction


class PointTable(Moving):
    """A point that radiates evenly."""

    type: Literal["point"]
    position: Vector | None = None
    intensity: Radiance = Field(description="W / sr")
    keys: Annotated[list[PointKey], Field(min_length=1), AfterValidator(_ascending)] | None = Field(
        None, description="instead of position: { time, position }, ..."
    )

    _one_form = model_validator(mode="after")(lambda self: _keys_or(self, "position"))


class DirectionalTable(Moving):
    """Parallel light, as from the sun."""

    type: Literal["directional"]
    direction: Direction | None = Field(None, description="along which the light travels; any length but 0")
    irradiance: Radiance = Field(description="W / m^2 on a surface that faces the light")
    keys: Annotated[list[DirectionKey], Field(min_length=1), AfterValidator(_ascending)] | None = Field(
        None, description="instead of direction: { time, direction }, ..."
    )

    _one_form = model_validator(mode="after")(lambda self: _keys_or(self, "direction"))


class SpotTable(Moving):
    """A point that radiates into a cone."""

    type: Literal["spot"]
    position: Vector | None = None
    direction: Direction | None = Field(None, description="the cone's axis; any length but 0")
    intensity: Radiance = Field(description="W / sr, on the axis")
    inner_angle: Annotated[float, Field(ge=0, lt=90)] = Field(
        0.0, description="degrees from the axis up to which it is full"
    )
    outer_angle: Annotated[float, Field(gt=0, le=90)] = Field(
        45.0, description="degrees from the axis past which it is 0"
    )
    keys: Annotated[list[SpotKey], Field(min_length=1), AfterValidator(_ascending)] | None = Field(
        None, description="instead of position and direction: { time, position, direction }, ..."
    )

    @model_validator(mode="after")
    def _one_form(self) -> "SpotTable":
        if self.inner_angle >= self.outer_angle:
            raise PydanticCustomError(
                "cone", "inner_angle is not below outer_angle; expected inner_angle < outer_angle"
            )
        return _keys_or(self, "position", "direction")


def _keys_or(table: Any, *names: str) -> Any:
    """The table, if it has either keys or all of the fields that they replace."""
    given = [name for name in names if getattr(table, name) is not None]
    if (table.keys is None and len(given) < len(names)) or (table.keys is not None and given):
        raise PydanticCustomError("forms", "expected {names}, or keys", {"names": " and ".join(names)})
    return table


LightTable = Annotated[
    Annotated[PointTable, Tag("point light")]
    | Annotated[DirectionalTable, Tag("directional light")]
    | Annotated[SpotTable, Tag("spot light")],
    Discriminator(
        _light_kind,
        custom_error_type="light_kind",
        custom_error_message="expected type = point, directional or spot",
    ),
]


class ImageTable(Table):
    """A picture of all directions, latitude by longitude: its top is +Y, its centre -Z, its right half +X; a path alone stands
    for { file = path }."""

    file: str = Field(min_length=1, description="path of an .exr or .hdr picture")
    rotation: Coordinate = Field(0.0, description="about +Y, degrees counter-clockwise as seen from above")
    scale: Strength = Field(1.0, description="what its values are multiplied with")


class SkyTable(Table):
    """A clear sky with its sun (Preetham et al. 1999)."""

    turbidity: Annotated[float, Field(ge=1.7, le=10)] = Field(3.0, description="haze: 2 is very clear, 10 hazy")
    sun_direction: Direction | None = Field(None, description="towards the sun; any length but 0")
    elevation: Annotated[float, Field(le=90)] | None = Field(None, description="of the sun above the horizon, degrees")
    azimuth: Coordinate = Field(0.0, description="of the sun, degrees from -Z towards +X")
    scale: Strength = Field(1.0, description="what the radiance of sky and sun is multiplied with")
    sun: bool = Field(True, description="whether the sun shines, as a directional light; it is never in the picture")
    resolution: Annotated[int, Field(ge=8, le=4096, multiple_of=4)] = Field(
        512, description="width of the sky's picture, pixels"
    )

    @model_validator(mode="after")
    def _sun_above_horizon(self) -> "SkyTable":
        if (self.sun_direction is None) == (self.elevation is None):
            raise PydanticCustomError("forms", "expected sun_direction, or elevation with azimuth")
        if self.sun_direction is not None and "azimuth" in self.model_fields_set:
            raise PydanticCustomError("forms", "sun_direction excludes azimuth; expected one form")
        if self.to_sun[1] <= 0:
            raise PydanticCustomError("night", "the sun is not above the horizon; expected a sky by day")
        return self

    @property
    def to_sun(self) -> tuple[float, float, float]:
        """Unit vector to the sun."""
        if self.sun_direction is not None:
            return self.sun_direction
        up, around = math.radians(self.elevation), math.radians(self.azimuth)
        return math.cos(up) * math.sin(around), math.sin(up), -math.cos(up) * math.cos(around)


class EnvironmentTable(Table):
    """Light from all around, where no mesh is: of one colour, of a picture, or of a clear sky."""

    color: Radiance | None = Field(None, description="W / (m^2 sr)")
    image: Annotated[ImageTable, BeforeValidator(_path_or_table)] | None = None
    sky: SkyTable | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> "EnvironmentTable":
        if sum(kind is not None for kind in (self.color, self.image, self.sky)) != 1:
            raise PydanticCustomError("forms", "expected one of color, image and sky")
        return self


class CameraKey(Table):
    """Where the camera is at a time, and either the point that it looks at, or its rotation; what it does not say is as in
    [camera]."""

    time: Seconds
    position: Vector | None = None
    look_at: Vector | None = None
    up: Vector | None = None
    rotation: Rotation | None = Field(
        None, description="{ axis = [x, y, z], degrees = a }, of a camera that looks along -Z"
    )
    quaternion: Quaternion | None = Field(None, description="rotation as [x, y, z, w]; any length but 0")

    @model_validator(mode="after")
    def _one_form(self) -> "CameraKey":
        if sum(form is not None for form in (self.look_at, self.rotation, self.quaternion)) > 1:
            raise PydanticCustomError("forms", "look_at, rotation and quaternion exclude each other; expected one form")
        return self


class CameraTable(Moving):
    """A pinhole camera: placed by position with look_at, or by a pose whose -Z axis it looks along; moved by keys, or by the
    poses of a file."""

    position: Vector | None = None
    look_at: Vector | None = Field(None, description="the point in the middle of the picture")
    up: Direction = Field((0.0, 1.0, 0.0), description="with look_at: the direction that is upwards in the picture")
    pose: Annotated[tuple[Row, Row, Row], _list_of(3, "rows of 4 numbers")] | None = Field(
        None, description="3 rows of 4 numbers, camera to world, without scale"
    )
    keys: Annotated[list[CameraKey], Field(min_length=1), AfterValidator(_ascending)] | None = Field(
        None, description="{ time = seconds, position, look_at or rotation or quaternion }, ..."
    )
    poses: str | None = Field(None, min_length=1, description="path of a .csv file: time,px,py,pz,qx,qy,qz,qw")
    fov_y: Annotated[float, Field(gt=0, lt=180)] = Field(40.0, description="vertical field of view, degrees")
    near: Annotated[float, Field(ge=0, le=1e18)] = Field(0.0, description="metres along the viewing axis")

    @model_validator(mode="after")
    def _one_form(self) -> "CameraTable":
        if sum(form is not None for form in (self.pose, self.keys, self.poses)) > 1:
            raise PydanticCustomError("forms", "pose, keys and poses exclude each other; expected one form")
        placed = self.position is not None or self.look_at is not None or "up" in self.model_fields_set
        if (
            self.keys is None
            and self.poses is None
            and self.pose is None
            and (self.position is None or self.look_at is None)
        ):
            raise PydanticCustomError("forms", "expected position and look_at, or pose, or keys, or poses")
        if placed and (self.pose is not None or self.poses is not None):
            raise PydanticCustomError("forms", "pose and poses exclude position, look_at and up")
        for key in self.keys or ():
            if key.position is None and self.position is None:
                raise PydanticCustomError("forms", "keys: the key at {time} s has no position", {"time": key.time})
            if self.look_at is None and key.look_at is None and key.rotation is None and key.quaternion is None:
                raise PydanticCustomError(
                    "forms",
                    "keys: the key at {time} s has neither look_at nor rotation nor quaternion",
                    {"time": key.time},
                )
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
