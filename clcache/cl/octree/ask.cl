// What a vertex asks the cache for. `asked_level`: NONE where it does not; NO_LEVEL where no cell may answer; else the level
// that fits, and << 8 the coarsest that may. `asked_key`: keys at the finest level of where jitter has led, and of the vertex
// itself.

#include "octree/shape.cl"

#define NO_LEVEL 0xFFFFFFFEu

// Whether cells can know of a point: the cube may leave out what lies far away.
inline bool is_in_cube(const OctreeShape *shape, Vec3 point)
{
    Vec3 along = sub3(point, vec3(shape->origin[0], shape->origin[1], shape->origin[2]));
    float least = fmin(along.x, fmin(along.y, along.z)), most = max_component(along);
    return least >= 0.0f && most <= shape->size;
}
