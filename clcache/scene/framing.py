"""A camera and light for scenes whose files bring none.

An object is seen from outside: from the front and above, so close that all of it is just in the picture. A room is seen
from inside. Which of the two a scene is shows on columns, vertical lines through it: where a line passes a gap above an
upward-facing surface (a floor), and from a point in that gap the nearest surfaces to all four sides face the point, one
may stand in a room; inside a solid body the surfaces show their backs. Where no ceiling closes the gap, the walls must
reach high up, which tells an atrium from a street. If many columns have such gaps, the camera goes to the one with the
deepest and richest view. If only one same side is open everywhere, as in a Cornell box, the camera looks in from there.

What the camera sees of the sky decides about light: a sun and an even sky where they can enter, else a lamp.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from .model import Camera, DirectionalLight, Environment, Light, PointLight
from .part import Part
from .transform import look_at

# Enough to tell a room from a body; of larger scenes, the largest triangles of each mesh and a selection of the others.
_MOST_TRIANGLES = 1_000_000

_OUTSIDE_FOV_Y = math.radians(40)
_INSIDE_FOV_Y = math.radians(45)  # 73 degrees wide at 16:9
_OUTSIDE_VIEW = np.array([0.5, 0.4, 0.8])  # towards the eye: front is +Z, as in glTF
_MARGIN = 0.92  # of the picture's half width and height that the object may fill

# The middle of the scene is where all but this fraction of the corners are, on each side; it counts as the scene's
# extent if it is less than a quarter of the whole, which then is a ground or a sky.
_STRAY = 0.01

_GRID = 7  # columns on each side of a regular grid
_SAMPLED = 97  # columns through the middles of triangles, which are dense where the scene has its content
_ROOM = 1 / 3  # fraction of the columns through triangles with a place to stand that makes a room
_LOWEST_GAP = 0.15  # height of a gap that counts, relative to the scene's height
_HIGH_UP = 0.85  # where in a gap without a ceiling the walls must still be

# How many places are looked around from, how many of the views from there are judged, and with how many rays.
_PLACES, _VIEWS, _HEADINGS, _RAYS = 6, 12, 16, (9, 5)
_CHUNK = 1500  # triangles cast against at once: products of matrices so small do not wait for threads
_BRIGHTEST = 8.0  # times the default light, for a camera that sees the sky through a narrow opening
_STEP_BACK = 0.9  # of the free distance behind a place, for the camera to stand there

Strength = tuple[float, float, float]


@dataclass(frozen=True)
class _World:
    """Triangles of all instances, in units in which the scene lies about the origin and its longest side measures 1.

    corners: (t, 3, 3) float32, counter-clockwise where the file's normals point. instance: (t,) the number of the
    instance that each belongs to. centre and size: of the scene, in metres.
    """

    corners: np.ndarray
    instance: np.ndarray
    centre: np.ndarray
    size: float

    def to_metres(self, camera: Camera) -> Camera:
        eye = camera.transform[:, 3] * self.size + self.centre
        return replace(camera, transform=np.column_stack([camera.transform[:, :3], eye]))

    def from_metres(self, camera: Camera) -> Camera:
        eye = (camera.transform[:, 3] - self.centre) / self.size
        return replace(camera, transform=np.column_stack([camera.transform[:, :3], eye]))


def complete(
    part: Part, environment: Environment | None, size: tuple[int, int], notes: list[str]
) -> tuple[Camera, list[Light], Environment]:
    """Camera, lights and environment of a scene, chosen where the file gives none; adds a note for each choice.

    environment: the file's, or None. size: width and height of the picture. The light is only chosen if the file has
    neither lights nor environment nor emission.
    """
    dark = environment is None and not part.lights and not any(m.is_emissive for m in part.materials)
    camera, lights = part.camera, list(part.lights)
    if camera is not None and not dark:
        return camera, lights, environment or Environment()
    world = _gather(part)
    if camera is None:
        camera = world.to_metres(_frame(world, size[0] / size[1], notes))
    if dark:
        light, sky = _light(world, camera, notes)
        lights.append(light)
        environment = Environment.constant(sky)
    return camera, lights, environment or Environment()


def _gather(part: Part) -> _World:
    """The triangles of the scene; files agree less on winding than on normals, so that normals decide on the side."""
    uses: dict[int, list[int]] = {}
    for number, instance in enumerate(part.instances):
        uses.setdefault(instance.mesh, []).append(number)
    total = sum(len(part.meshes[mesh].triangles) * len(numbers) for mesh, numbers in uses.items())
    share = min(1.0, _MOST_TRIANGLES / total)
    corners, instances = [], []
    for mesh, numbers in uses.items():
        local = _oriented(part, mesh)
        room = max(1, int(share * len(numbers) * len(local)))
        local = _selection(local, share)
        numbers = np.array(numbers)[:: math.ceil(len(numbers) * len(local) / max(room, len(local)))]
        for number in numbers:
            transform = part.instances[number].transform
            placed = local @ transform[:, :3].T + transform[:, 3]
            corners.append(placed[:, ::-1] if np.linalg.det(transform[:, :3]) < 0 else placed)
        instances.append(np.repeat(numbers, len(local)))
    corners = np.concatenate(corners)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    centre, size = (low + high) / 2, float((high - low).max())
    corners -= centre
    corners /= size
    return _World(corners.astype(np.float32), np.concatenate(instances), centre, size)


def _selection(corners: np.ndarray, share: float) -> np.ndarray:
    """A share of the triangles: most are the largest, the others spread over the mesh."""
    if share == 1:
        return corners
    squared_area = (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) ** 2).sum(axis=1)
    largest = np.argsort(-squared_area)[: math.ceil(0.75 * share * len(corners))]
    spread = np.arange(0, len(corners), math.ceil(4 / share))
    return corners[np.union1d(largest, spread)]


def _oriented(part: Part, index: int) -> np.ndarray:
    mesh = part.meshes[index]
    corners = mesh.positions[mesh.triangles].astype(np.float64)
    if mesh.normals is not None:
        geometric = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        against = np.einsum("ij,ij->i", geometric, mesh.normals[mesh.triangles].sum(axis=1)) < 0
        corners[against] = corners[against][:, ::-1]
    return corners


# The camera


@dataclass(frozen=True)
class _Place:
    """Where one may stand. point: at eye height in a gap. column: the number of its column. height: of the gap. free:
    distances to the next surface along -X, +X, -Z, +Z, infinite where there is none. faces: whether that surface faces
    the point (and a higher one, where the gap is open at the top)."""

    point: np.ndarray
    column: int
    height: float
    free: np.ndarray
    faces: np.ndarray


class _Lines:
    """All crossings of axis-parallel lines with triangles."""

    def __init__(self, triangles: np.ndarray, axis: int) -> None:
        self.high = float(triangles[:, :, axis].max())
        self._axis = axis
        self._across = [(axis + 1) % 3, (axis + 2) % 3]
        self._triangles = triangles
        self._low = _least(triangles)[:, self._across].T.copy()
        self._high = _most(triangles)[:, self._across].T.copy()

    def crossings(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates along the axis, ascending, where the line through `point` crosses triangles, and the sign of
        their normals along the axis."""
        x, y = point[self._across]
        near = np.flatnonzero((self._low[0] <= x) & (self._high[0] >= x) & (self._low[1] <= y) & (self._high[1] >= y))
        corners = self._triangles[near].astype(np.float64)
        dx, dy = corners[:, :, self._across[0]] - x, corners[:, :, self._across[1]] - y
        after, before = [1, 2, 0], [2, 0, 1]
        weight = dx[:, after] * dy[:, before] - dx[:, before] * dy[:, after]
        total = weight.sum(axis=1)
        hit = ((weight >= 0).all(axis=1) | (weight <= 0).all(axis=1)) & (total != 0)
        along = (weight[hit] * corners[hit][:, :, self._axis]).sum(axis=1) / total[hit]
        order = np.argsort(along)
        return along[order], np.sign(total[hit])[order]

    def nearest(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances from `point` to the next triangle down and up the axis (infinite: none), and whether each faces it."""
        along, sign = self.crossings(point)
        distance, faces = np.full(2, np.inf), np.zeros(2, bool)
        split = int(np.searchsorted(along, point[self._axis]))
        if split > 0:
            distance[0], faces[0] = point[self._axis] - along[split - 1], sign[split - 1] > 0
        if split < len(along):
            distance[1], faces[1] = along[split] - point[self._axis], sign[split] < 0
        return distance, faces


def _frame(world: _World, aspect: float, notes: list[str]) -> Camera:
    low, high = _extent(world.corners)
    lines = [_Lines(world.corners, axis) for axis in range(3)]
    places = list(_places(lines, _columns(world.corners, low, high), high[1] - low[1]))
    enclosed = [p for p in places if p.faces.all()]
    if _is_room(enclosed):
        notes.append("no camera in the file: as surfaces face the middle from all around, it stands inside")
        return _inside(world, enclosed, aspect)
    for side in range(4):
        if _is_room([p for p in places if np.isinf(p.free[side]) and np.delete(p.faces, side).all()]):
            notes.append("no camera in the file: it looks in from outside through the only open side")
            return _through_opening(low, high, side, aspect)
    notes.append("no camera in the file: it stands outside, in front and above, with all of the scene in the picture")
    return _outside(world.corners, low, high, aspect)


def _is_room(places: list[_Place]) -> bool:
    return len({p.column for p in places if p.column < _SAMPLED}) >= _ROOM * _SAMPLED


def _least(corners: np.ndarray) -> np.ndarray:
    """The smallest over the three corners (axis 1); many times as fast as the library's reduction of so short an axis."""
    return np.minimum(np.minimum(corners[:, 0], corners[:, 1]), corners[:, 2])


def _most(corners: np.ndarray) -> np.ndarray:
    """The largest over the three corners (axis 1)."""
    return np.maximum(np.maximum(corners[:, 0], corners[:, 1]), corners[:, 2])


def _extent(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the box that counts as the scene: all of it, or its middle where that is much smaller."""
    points = corners.reshape(-1, 3).astype(np.float64)
    low, high = points.min(axis=0), points.max(axis=0)
    middle_low, middle_high = np.quantile(points, [_STRAY, 1 - _STRAY], axis=0)
    if ((middle_high - middle_low)[[0, 2]] < 0.25 * (high - low)[[0, 2]]).all():
        return middle_low, middle_high
    return low, high


def _columns(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(n, 3) points on the vertical lines: through the middles of triangles, then on a grid."""
    chosen = np.linspace(0, len(corners) - 1, _SAMPLED).round().astype(np.int64)
    middles = corners[chosen].mean(axis=1).astype(np.float64)
    # Off the symmetric positions, where lines run along edges.
    fractions = (np.arange(_GRID) + 0.5137) / _GRID
    return np.vstack([middles, [low + (high - low) * (x, 0.5, z) for x, z in product(fractions, fractions)]])


def _places(lines: list["_Lines"], columns: np.ndarray, scene_height: float) -> Iterator[_Place]:
    """All places to stand in the columns."""
    for column, point in enumerate(columns):
        heights, facing = lines[1].crossings(point)
        if len(heights) == 0:
            continue
        top = lines[1].high
        gaps = np.append(heights[1:], max(top, heights[-1])) - heights
        for gap in np.flatnonzero((facing > 0) & (gaps > _LOWEST_GAP * scene_height)):
            yield _place(lines, column, point, heights[gap], gaps[gap], open_above=gap == len(gaps) - 1)


def _place(
    lines: list["_Lines"], column: int, point: np.ndarray, floor: float, height: float, open_above: bool
) -> _Place:
    """The place at eye height: in the middle of the gap, lower in a high narrow one."""
    point = np.array([point[0], floor + 0.3 * height, point[2]])
    for _ in range(2):
        free, faces = _around(lines, point)
        point[1] = floor + min(0.5 * height, 0.35 * min(free[0] + free[1], free[2] + free[3]))
    if open_above:
        faces &= _around(lines, np.array([point[0], floor + _HIGH_UP * height, point[2]]))[1]
    return _Place(point, column, height, free, faces)


def _around(lines: list["_Lines"], point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`_Place.free` and `_Place.faces` of a point."""
    (free_x, faces_x), (free_z, faces_z) = lines[0].nearest(point), lines[2].nearest(point)
    return np.concatenate([free_x, free_z]), np.concatenate([faces_x, faces_z])


def _inside(world: _World, places: list[_Place], aspect: float) -> Camera:
    """The best view from the most open places, each seen from as far back as the way behind it is free."""
    headings = np.arange(_HEADINGS) * (2 * math.pi / _HEADINGS)
    ahead = np.column_stack([np.sin(headings), np.zeros(_HEADINGS), np.cos(headings)])
    views = []
    for place in sorted(places, key=_openness, reverse=True)[:_PLACES]:
        point = place.point + [(place.free[1] - place.free[0]) / 2, 0.0, (place.free[3] - place.free[2]) / 2]
        free = _look_around(world, point, ahead)
        if free.min() < 0.5 * place.free.min():
            point = place.point
            free = _look_around(world, point, ahead)
        behind = np.roll(free, _HEADINGS // 2)
        for heading in np.flatnonzero(np.isfinite(free + behind)):
            eye = point - ahead[heading] * behind[heading] * _STEP_BACK
            views.append((free[heading] + behind[heading], Camera(look_at(eye, point), _INSIDE_FOV_Y)))
    views = sorted(views, key=lambda view: -view[0])[:_VIEWS]
    longest = views[0][0]
    return max((camera for _, camera in views), key=lambda camera: _richness(world, camera, aspect, longest))


def _look_around(world: _World, point: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Free distances from a point in (n, 3) level directions."""
    heights = world.corners[:, :, 1]
    near = np.flatnonzero((_least(heights) <= point[1]) & (_most(heights) >= point[1]))
    return _cast(world, near, point, level)[0]


def _openness(place: _Place) -> float:
    """The longest free line through a place, less where it is narrow or low."""
    across, along = sorted((place.free[0] + place.free[1], place.free[2] + place.free[3]))
    return min(along, 3 * across, 3 * place.height)


def _richness(world: _World, camera: Camera, aspect: float, far: float) -> float:
    """How deep a view is on average, and how many instances it shows; less where something is close before the eye."""
    distance, instance = _look(world, camera, aspect)
    depth = np.minimum(distance / far, 1)
    seen = len(np.unique(instance[instance >= 0]))
    return depth.mean() * math.sqrt(seen) * (1 - np.mean(depth < 0.1)) ** 2


def _look(world: _World, camera: Camera, aspect: float) -> tuple[np.ndarray, np.ndarray]:
    """What `_cast` finds along rays through a grid of points in a camera's picture."""
    eye, turn = camera.transform[:, 3], camera.transform[:, :3]
    y = math.tan(camera.fov_y / 2)
    half = 0.9 * np.array([y * aspect, y])
    across, up = np.meshgrid(np.linspace(-half[0], half[0], _RAYS[0]), np.linspace(-half[1], half[1], _RAYS[1]))
    directions = np.column_stack([across.ravel(), up.ravel(), -np.ones(across.size)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # Only triangles whose bounds in the picture contain a point of the grid can be hit, or those that reach behind.
    depth = _along(world.corners, eye, -turn[:, 2])
    near = _most(depth) > 0
    crosses = _least(depth) <= 0
    for axis, count in enumerate(_RAYS):
        with np.errstate(divide="ignore", invalid="ignore"):
            at = _along(world.corners, eye, turn[:, axis]) / depth
        at = (at / np.float32(half[axis]) + 1) * np.float32((count - 1) / 2)
        low, high = np.ceil(_least(at) - 1e-3), np.floor(_most(at) + 1e-3)
        near &= crosses | ((low <= high) & (low < count) & (high >= 0))
    return _cast(world, np.flatnonzero(near), eye, directions @ turn.T)


def _along(corners: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(t, 3) how far each corner is from the origin along a direction."""
    offset, (x, y, z) = np.float32(origin @ direction), direction.astype(np.float32)
    return corners[:, :, 0] * x + corners[:, :, 1] * y + corners[:, :, 2] * z - offset


def _cast(world: _World, near: np.ndarray, origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance to, and instance of, the first triangle in each of (n, 3) unit directions from one origin; infinite and
    -1 where there is none.

    near: the triangles that may be hit. A ray hits a triangle where it has the planes through the origin and each edge
    on the same side.
    """
    hits = [(np.zeros(0), np.zeros(0, int), np.zeros(0, int))]
    for start in range(0, len(near), _CHUNK):
        chunk = near[start : start + _CHUNK]
        a, b, c = (world.corners[chunk] - origin.astype(np.float32)).transpose(1, 0, 2)
        x, y, z = (np.cross(p, q) @ directions.T.astype(np.float32) for p, q in ((b, c), (c, a), (a, b)))
        volume = np.einsum("ij,ij->i", a, np.cross(b, c))
        triangle, ray = np.nonzero((np.minimum(np.minimum(x, y), z) >= 0) | (np.maximum(np.maximum(x, y), z) <= 0))
        with np.errstate(divide="ignore", invalid="ignore"):
            hits.append((volume[triangle] / (x + y + z)[triangle, ray], ray, chunk[triangle]))
    distance, ray, triangle = (np.concatenate(parts) for parts in zip(*hits, strict=True))
    ahead = np.flatnonzero(distance > 0)
    order = ahead[np.lexsort((distance[ahead], ray[ahead]))]
    found, first = np.unique(ray[order], return_index=True)
    nearest, instance = np.full(len(directions), np.inf), np.full(len(directions), -1)
    nearest[found], instance[found] = distance[order[first]], world.instance[triangle[order[first]]]
    return nearest, instance


def _through_opening(low: np.ndarray, high: np.ndarray, side: int, aspect: float) -> Camera:
    """The camera before an open side (as in `_Place.free`), from where the opening just fills the picture."""
    axis, end = 2 * (side // 2), side % 2
    centre, half = (low + high) / 2, (high - low) / 2
    t = math.tan(_OUTSIDE_FOV_Y / 2) * _MARGIN
    away = max(half[1] / t, half[2 - axis] / (t * aspect))
    eye = centre.copy()
    eye[axis] += (2 * end - 1) * (half[axis] + away)
    return Camera(look_at(eye, centre), _OUTSIDE_FOV_Y)


def _outside(triangles: np.ndarray, low: np.ndarray, high: np.ndarray, aspect: float) -> Camera:
    """The nearest camera that looks along the chosen direction and has all points of the box's content in the picture."""
    points = triangles.reshape(-1, 3).astype(np.float64)
    points = points[((points >= low) & (points <= high)).all(axis=1)]
    centre = (low + high) / 2
    turn = look_at(_OUTSIDE_VIEW, np.zeros(3))[:, :3]
    seen = (points - centre) @ turn
    t = math.tan(_OUTSIDE_FOV_Y / 2) * _MARGIN * np.array([aspect, 1.0])
    above = (seen[:, :2] + seen[:, 2:] * t).max(axis=0)
    below = (-seen[:, :2] + seen[:, 2:] * t).max(axis=0)
    # Not nearer than this, which matters to what is thin along the line of sight.
    away = max(((above + below) / (2 * t)).max(), seen[:, 2].max() + 0.2 * (high - low).max())
    offset = (above - below) / 2
    for _ in range(4):  # towards the middle in the direction that has room left
        places = (seen[:, :2] - offset) / (away - seen[:, 2:])
        offset = offset + away * (places.min(axis=0) + places.max(axis=0)) / 2
    return Camera(np.column_stack([turn, centre + turn @ np.append(offset, away)]), _OUTSIDE_FOV_Y)


# The light


def _light(world: _World, camera: Camera, notes: list[str]) -> tuple[PointLight | DirectionalLight, Strength]:
    """A sun over the camera's shoulder and an even sky, the brighter the less of the sky is open above the camera; a lamp
    above it where neither reaches it."""
    eye = world.from_metres(camera).transform[:, 3]
    distance = _cast(world, np.arange(len(world.corners)), eye, _upward_directions())[0]
    if np.isinf(distance).any():
        notes.append("no light in the file: a sun over the camera's left shoulder and an even sky were added")
        right, back = camera.transform[:, 0], camera.transform[:, 2]
        direction = np.array([0.0, -1.0, 0.0]) + 0.4 * _level(-back) + 0.25 * _level(right)
        direction /= np.linalg.norm(direction)
        strength = min(1 / np.isinf(distance).mean(), _BRIGHTEST)
        sun, sky = 3.0 * math.sqrt(strength), 0.5 * strength  # it is the sky that reaches the shade
        return DirectionalLight(tuple(direction.tolist()), (sun,) * 3), (sky,) * 3
    notes.append("no light in the file, and no sky in view: a lamp above the camera was added")
    ahead = float(np.median(_look(world, world.from_metres(camera), 1.0)[0]))
    reach = ahead if math.isfinite(ahead) else float(distance.mean())
    position = (eye + [0.0, 0.5 * distance[0], 0.0]) * world.size + world.centre
    return PointLight(tuple(position.tolist()), (3.0 * (0.7 * reach * world.size) ** 2,) * 3), (0.0, 0.0, 0.0)


def _level(vector: np.ndarray) -> np.ndarray:
    """The vector without its vertical part, of unit length if any is left."""
    flat = vector * [1.0, 0.0, 1.0]
    return flat / max(np.linalg.norm(flat), 1e-9)


def _upward_directions() -> np.ndarray:
    """(24, 3) unit directions evenly spread over the upper hemisphere, the first straight up."""
    height = 1 - np.arange(24) / 24
    turn = np.arange(24) * math.pi * (3 - math.sqrt(5))
    radius = np.sqrt(1 - height**2)
    return np.column_stack([radius * np.cos(turn), height, radius * np.sin(turn)])
