// What a material's graph is given at a hit: texture coordinates, place and normal within the object, and how the first two change
// along the axes of the ray cone's footprint (MaterialMemo, section 2.2, Eq. 2.13-2.16). The thesis leaves open what r is there; here
// it is the cone's whole width, as far as neighbouring pixels are apart, which is what derivatives are of elsewhere.

#include "scene/surface.cl"

#define LEAST_COSINE 1e-2f  // of the angle at which a cone meets the surface: along it the footprint would grow without bound

typedef struct Pair {
    float u, v;
} Pair;

typedef struct GraphHit {
    Pair uv, uv_x, uv_y;
    Vec3 position, position_x, position_y, normal;
} GraphHit;

INLINED GraphHit graph_hit(const Triangles *scene, uint number, uint primitive, float u, float v, float t, Vec3 direction,
                           float cone_width, float cone_spread)
{
    const Masks *masks = &scene->masks;
    GraphHit hit;
    Instance instance = masks->instances[number];
    uint triangle = instance.first_triangle + primitive;
    uint a = masks->triangles[3 * triangle], b = masks->triangles[3 * triangle + 1], c = masks->triangles[3 * triangle + 2];
    Vec3 v0 = row3(scene->positions, a), v1 = row3(scene->positions, b), v2 = row3(scene->positions, c);
    Vec3 edge1 = sub3(v1, v0), edge2 = sub3(v2, v0);
    hit.position = add3(v0, add3(scale3(u, edge1), scale3(v, edge2)));
    hit.normal = normalize3(cross3(moderate3(edge1), moderate3(edge2)));
#if HAS_NORMALS
    Vec3 n0 = row3(scene->normals, a), n1 = row3(scene->normals, b), n2 = row3(scene->normals, c);
    Vec3 smooth = normalize3(interpolate(n0, n1, n2, u, v));
    bool is_smooth = fmin(dot3(n0, n0), fmin(dot3(n1, n1), dot3(n2, n2))) > 0.0f && dot3(smooth, smooth) > 0.5f;
    hit.normal = either3(is_smooth, smooth, hit.normal);
#endif

    // The footprint's axes on the surface, in the world; lengths as multiples of the triangle's.
    Vec3 world1 = transform_vector(instance.to_world, edge1), world2 = transform_vector(instance.to_world, edge2);
    float to_one = scale_to_one(fmax(max_component(abs3(world1)), max_component(abs3(world2))));
    world1 = scale3(to_one, world1);
    world2 = scale3(to_one, world2);
    Vec3 normal = normalize3(cross3(moderate3(world1), moderate3(world2)));
    float width = fabs(cone_width + cone_spread * t) * to_one, cosine = dot3(direction, normal);
    Vec3 slope = sub3(direction, scale3(cosine, normal));
    bool is_head_on = !(dot3(slope, slope) > 1e-12f);
    Vec3 along = normalize3(either3(is_head_on, world1, slope)), across = cross3(normal, along);
    along = scale3(width / fmax(fabs(cosine), LEAST_COSINE), along);
    across = scale3(width, across);

    // Barycentric coordinates of their tips.
    Vec3 plane = cross3(world1, world2);
    float squared = dot3(plane, plane), inverse = squared > 0.0f ? 1.0f / squared : 0.0f;
    float u_x = dot3(cross3(along, world2), plane) * inverse, v_x = dot3(cross3(world1, along), plane) * inverse;
    float u_y = dot3(cross3(across, world2), plane) * inverse, v_y = dot3(cross3(world1, across), plane) * inverse;
    hit.position_x = add3(scale3(u_x, edge1), scale3(v_x, edge2));
    hit.position_y = add3(scale3(u_y, edge1), scale3(v_y, edge2));
    __global const float *uv0 = masks->uvs + 2 * a, *uv1 = masks->uvs + 2 * b, *uv2 = masks->uvs + 2 * c;
    float du1 = uv1[0] - uv0[0], du2 = uv2[0] - uv0[0], dv1 = uv1[1] - uv0[1], dv2 = uv2[1] - uv0[1];
    hit.uv.u = uv0[0] + (u * du1 + v * du2);
    hit.uv.v = uv0[1] + (u * dv1 + v * dv2);
    hit.uv_x.u = u_x * du1 + v_x * du2;
    hit.uv_x.v = u_x * dv1 + v_x * dv2;
    hit.uv_y.u = u_y * du1 + v_y * du2;
    hit.uv_y.v = u_y * dv1 + v_y * dv2;
    return hit;
}
