// A cached first hit: 128 bits from which its point follows for any later position of the scene (SampleCache, Listing 1; there
// the barycentric coordinates leave no room for the material's bits, so here they have 24 bits each).
//
//   x: u (24 bits) | bits 0-7 of the material      y: v (24 bits) | bits 8-15 of the material
//   z: primitive                                   w: instance
//
// The background is a sample, too: instance NONE, and the direction towards it, octahedrally, in place of u and v.

#include "common/camera.cl"

#define FIXED_ONE 0xFFFFFFu  // 1 in 24 bits

typedef struct FirstHit {
    uint x, y, z, w;
} FirstHit;

// The scene's triangles where they are now.
typedef struct Geometry {
    __global const float *positions;  // (vertices, 3)
    __global const uint *triangles;   // (triangles, 3)
    __global const Instance *instances;
} Geometry;

typedef struct Located {
    Vec3 point;
    Vec3 normal;  // of the triangle, of unit length; to either side
} Located;

inline FirstHit load_first_hit(__global const uint *first_hit, uint sample)
{
    __global const uint *words = first_hit + words_of(sample);
    FirstHit hit = { words[0], words[1], words[2], words[3] };
    return hit;
}

inline void store_first_hit(__global uint *first_hit, uint sample, FirstHit hit)
{
    __global uint *words = first_hit + words_of(sample);
    words[0] = hit.x;
    words[1] = hit.y;
    words[2] = hit.z;
    words[3] = hit.w;
}

// A number in [0, 1] to the nearest multiple of 1 / FIXED_ONE, and back; above 2^23 all products are whole.
INLINED uint to_fixed(float v)
{
    float scaled = fmin(fmax(v, 0.0f), 1.0f) * (float)FIXED_ONE;
    return (uint)(int)(scaled < 8388608.0f ? floor(scaled + 0.5f) : scaled);
}

inline float from_fixed(uint word)
{
    return (float)(int)(word & FIXED_ONE) / (float)FIXED_ONE;
}

INLINED FirstHit pack_first_hit(float u, float v, uint primitive, uint instance, uint material)
{
    FirstHit hit = { to_fixed(u) | (material & 0xFFu) << 24, to_fixed(v) | (material >> 8 & 0xFFu) << 24, primitive, instance };
    return hit;
}

inline float unpack_u(FirstHit hit)
{
    return from_fixed(hit.x);
}

inline float unpack_v(FirstHit hit)
{
    return from_fixed(hit.y);
}

inline uint unpack_material(FirstHit hit)
{
    return hit.x >> 24 | hit.y >> 24 << 8;
}

inline bool is_background(FirstHit hit)
{
    return hit.w == NONE;
}

// direction: of any length but 0. The octahedron's lower half is folded over the upper one (Cigolle et al. 2014, "A Survey of
// Efficient Representations for Independent Unit Vectors", JCGT 3(2)).
INLINED FirstHit pack_background(Vec3 direction)
{
    float size = fabs(direction.x) + fabs(direction.y) + fabs(direction.z);
    float x = direction.x / size, y = direction.y / size;
    float folded_x = copysign(1.0f - fabs(y), x), folded_y = copysign(1.0f - fabs(x), y);
    bool below = direction.z < 0.0f;
    return pack_first_hit(0.5f + 0.5f * (below ? folded_x : x), 0.5f + 0.5f * (below ? folded_y : y), NONE, NONE, 0);
}

INLINED Vec3 unpack_direction(FirstHit hit)
{
    float x = 2.0f * unpack_u(hit) - 1.0f, y = 2.0f * unpack_v(hit) - 1.0f;
    float z = 1.0f - fabs(x) - fabs(y), fold = fmax(-z, 0.0f);
    return normalize3(vec3(x - copysign(fold, x), y - copysign(fold, y), z));
}

// Where a first hit lies now; not for the background.
INLINED Located locate(const Geometry *geometry, FirstHit hit)
{
    Instance instance = geometry->instances[hit.w];
    uint triangle = 3 * (instance.first_triangle + hit.z);
    Vec3 v0 = row3(geometry->positions, geometry->triangles[triangle]);
    Vec3 edge1 = sub3(row3(geometry->positions, geometry->triangles[triangle + 1]), v0);
    Vec3 edge2 = sub3(row3(geometry->positions, geometry->triangles[triangle + 2]), v0);
    Vec3 within = add3(v0, add3(scale3(unpack_u(hit), edge1), scale3(unpack_v(hit), edge2)));
    edge1 = transform_vector(instance.to_world, edge1);
    edge2 = transform_vector(instance.to_world, edge2);
    edge1 = scale3(scale_to_one(max_component(abs3(edge1))), edge1);  // so that products of them neither under- nor overflow
    edge2 = scale3(scale_to_one(max_component(abs3(edge2))), edge2);
    Located located = { transform_point(instance.to_world, within), normalize3(cross3(edge1, edge2)) };
    return located;
}
