// What a hit is: point, normals and the parameters of the material there.
//
// The point is interpolated from the triangle, not taken from t, and comes with a bound on how far it can be off along the
// normal; a ray that starts that far from the surface cannot meet it again (van Antwerpen 2023, "Solving self-intersection
// artifacts in DirectX raytracing"). The bound follows the size of the numbers that were rounded, so that it holds at any
// scale and any distance from the origin.
//
// Maps are read at the level that a ray cone asks for (Akenine-Moeller et al. 2021, "Improved Shader and Texture Level of
// Detail Using Ray Cones", JCGT 10(1); MaterialMemo, section 2.2): the cone's width across the ray, in units of the texture.
//
// Defines: HAS_NORMALS, HAS_TEXTURES, HAS_BASE_COLOR_MAPS, HAS_METALLIC_ROUGHNESS_MAPS, HAS_EMISSION_MAPS, HAS_NORMAL_MAPS,
// HAS_SPECULAR, HAS_TRANSMISSION, HAS_EMISSIVE, HAS_GRAPHS: compiled out where the scene has none.

#include "common/bsdf.cl"
#include "common/transform.cl"
#include "scene/alpha.cl"

// Bounds, in units of the numbers' size: interpolation and intersection within the object; either transform.
#define OBJECT_ERROR (3.0f * UNIT_ROUNDOFF)
#define TRANSFORM_ERROR (5.0f * UNIT_ROUNDOFF)
#define WIDEST_SPREAD 1.0f  // radians: past it, and at grazing incidence, the cone's small-angle approximation diverges

// The scene's triangles, beside what tells holes.
typedef struct Triangles {
    __global const float *positions;  // (vertices, 3)
    __global const float *normals;    // (vertices, 3)
    Masks masks;
} Triangles;

// What the graph of a hit's material returned (cl/memo): its outputs, packed, as the material says.
typedef struct GraphValues {
    __global const float *values;  // (channels, n), or null where no graph is asked
    uint n, i;
} GraphValues;

// Places among a material's `outputs`, in the order of clcache.graph.OUTPUTS.
typedef enum GraphOutput {
    GRAPH_BASE_COLOR, GRAPH_METALLIC, GRAPH_ROUGHNESS, GRAPH_SPECULAR, GRAPH_SPECULAR_COLOR, GRAPH_EMISSION, GRAPH_NORMAL
} GraphOutput;

typedef struct Surface {
    Vec3 point;
    float offset;
    Vec3 geometric_normal, shading_normal;  // on the side that the ray came from
    Vec3 albedo;
    float metallic, roughness;
    float specular;
    Vec3 specular_color;
    Vec3 emitted;
    uint material;
    bool from_behind;
    float cone_width, cone_spread;
} Surface;

inline Vec3 interpolate(Vec3 a, Vec3 b, Vec3 c, float u, float v)
{
    return add3(a, add3(scale3(u, sub3(b, a)), scale3(v, sub3(c, a))));
}

// How fast the normal turns along an edge, relative to the edge's length.
inline float edge_curvature(Vec3 edge, Vec3 turn)
{
    float squared = dot3(edge, edge);
    return squared > 0.0f ? dot3(turn, edge) / squared : 0.0f;
}

// How strong the dielectric reflection is, where its tint is strongest.
inline float tinted_specular(const Surface *surface)
{
    return surface->specular * max_component(surface->specular_color);
}

// v scaled by a power of two, so that products of it neither under- nor overflow.
inline Vec3 moderate3(Vec3 v)
{
    return scale3(scale_to_one(max_component(abs3(v))), v);
}

// A number or three of a graph's, brought into a range; what the material has where the graph leaves it to that.
INLINED float graph_number(const GraphValues *graph, int place, float low, float high, float otherwise)
{
    bool is_there = graph->values && place >= 0;
    float value = is_there ? graph->values[(uint)max(place, 0) * graph->n + graph->i] : otherwise;
    return is_there ? fmin(fmax(value, low), high) : otherwise;
}

INLINED Vec3 graph_vector(const GraphValues *graph, int place, float low, float high, Vec3 otherwise)
{
    return vec3(graph_number(graph, place, low, high, otherwise.x),
                graph_number(graph, place < 0 ? -1 : place + 1, low, high, otherwise.y),
                graph_number(graph, place < 0 ? -1 : place + 2, low, high, otherwise.z));
}


// The surface where a ray in `direction` hit a triangle at (u, v), t along the ray; the cone is that at the ray's origin. graph: what the
// material's graph returned there.
INLINED Surface find_surface(const Triangles *scene, uint number, uint primitive, float u, float v, float t, Vec3 direction,
                            float cone_width, float cone_spread, const GraphValues *graph)
{
    const Masks *masks = &scene->masks;
    Surface surface;
    Instance instance = masks->instances[number];
    uint triangle = instance.first_triangle + primitive;
    uint a = masks->triangles[3 * triangle], b = masks->triangles[3 * triangle + 1], c = masks->triangles[3 * triangle + 2];
    Vec3 v0 = row3(scene->positions, a), v1 = row3(scene->positions, b), v2 = row3(scene->positions, c);
    Vec3 edge1 = sub3(v1, v0), edge2 = sub3(v2, v0);
    Vec3 object_point = add3(v0, add3(scale3(u, edge1), scale3(v, edge2)));
    Vec3 world_point = transform_point(instance.to_world, object_point);
    Vec3 object_normal = normalize3(cross3(moderate3(edge1), moderate3(edge2)));
    Vec3 world_normal = transform_normal(instance.to_object, object_normal);

    Vec3 extent = add3(add3(abs3(edge1), abs3(edge2)), abs3(sub3(edge1, edge2)));
    Vec3 object_error = scale3(OBJECT_ERROR, add3(abs3(v0), all3(max_component(extent))));
    Vec3 object_size = add3(transform_vector_abs(instance.to_object, world_point), translation_abs(instance.to_object));
    Vec3 world_size = add3(transform_vector_abs(instance.to_world, object_point), translation_abs(instance.to_world));
    object_error = add3(object_error, scale3(TRANSFORM_ERROR, object_size));
    // The plane n.p = const of object space is world_normal.p = const: an object-space distance is 1/|world_normal| as far there.
    float to_world_scale = 1.0f / sqrt(dot3(world_normal, world_normal));
    Vec3 ng = scale3(to_world_scale, world_normal);
    surface.offset = dot3(object_error, abs3(object_normal)) * to_world_scale + TRANSFORM_ERROR * dot3(world_size, abs3(ng));
    surface.point = world_point;

    bool from_behind = dot3(ng, direction) > 0.0f;
    ng = either3(from_behind, negate3(ng), ng);
    Vec3 ns = ng;
#if HAS_NORMALS
    Vec3 n0 = row3(scene->normals, a), n1 = row3(scene->normals, b), n2 = row3(scene->normals, c);
    Vec3 smooth = normalize3(transform_normal(instance.to_object, interpolate(n0, n1, n2, u, v)));
    smooth = either3(dot3(smooth, ng) < 0.0f, negate3(smooth), smooth);
    bool is_smooth = fmin(dot3(n0, n0), fmin(dot3(n1, n1), dot3(n2, n2))) > 0.0f;  // a row of zeros: a flat triangle
    ns = either3(is_smooth && dot3(smooth, smooth) > 0.5f, smooth, ng);
#endif

    uint index = masks->material[triangle];
    __global const Material *m = masks->materials + index;
    Vec3 color = load3(m->base_color), light = load3(m->emission);
    float metallic = m->metallic, roughness = m->roughness, specular = m->specular;
    Vec3 specular_color = load3(m->specular_color);
    bool faces = !from_behind || m->double_sided != 0;

#if HAS_TEXTURES
    __global const float *uv0 = masks->uvs + 2 * a, *uv1 = masks->uvs + 2 * b, *uv2 = masks->uvs + 2 * c;
    float du1 = uv1[0] - uv0[0], du2 = uv2[0] - uv0[0], dv1 = uv1[1] - uv0[1], dv2 = uv2[1] - uv0[1];
    float across = uv0[0] + (u * du1 + v * du2), down = uv0[1] + (u * dv1 + v * dv2);
    Vec3 world_edge1 = transform_vector(instance.to_world, edge1), world_edge2 = transform_vector(instance.to_world, edge2);
    Vec3 world_cross = cross3(world_edge1, world_edge2);
    float determinant = du1 * dv2 - dv1 * du2;
    float world_area = sqrt(dot3(world_cross, world_cross)), uv_area = fabs(determinant);
    float width = fabs(cone_width + cone_spread * t);
    float footprint = world_area > 0.0f ? width * sqrt(uv_area / world_area) : 0.0f;
#if HAS_NORMALS
    Vec3 w0 = normalize3(transform_normal(instance.to_object, n0)), w1 = normalize3(transform_normal(instance.to_object, n1));
    Vec3 w2 = normalize3(transform_normal(instance.to_object, n2));
    float curvature = edge_curvature(world_edge1, sub3(w1, w0)) + edge_curvature(world_edge2, sub3(w2, w0))
                      + edge_curvature(sub3(world_edge2, world_edge1), sub3(w2, w1));
    curvature *= from_behind ? -1.0f / 3.0f : 1.0f / 3.0f;
    float bend = 2.0f * curvature * width / fmax(-dot3(ns, direction), 1e-2f);
    cone_spread = clamp(cone_spread + bend, -WIDEST_SPREAD, WIDEST_SPREAD);
#endif
    cone_width = width;

    const Maps *maps = &masks->maps;
    Texel texel;
#if HAS_BASE_COLOR_MAPS
    texel = sample_map(maps, m->base_color_map, across, down, footprint);
    color = mul3(color, vec3(texel.x, texel.y, texel.z));
#endif
#if HAS_SPECULAR && HAS_METALLIC_ROUGHNESS_MAPS
    texel = sample_map(maps, m->metallic_roughness_map, across, down, footprint);
    roughness *= texel.y;
    metallic *= texel.z;
#endif
#if HAS_EMISSIVE && HAS_EMISSION_MAPS
    texel = sample_map(maps, m->emission_map, across, down, footprint);
    light = mul3(light, vec3(texel.x, texel.y, texel.z));
#endif
#if HAS_GRAPHS
    __global const int *outputs = m->outputs;
    color = graph_vector(graph, outputs[GRAPH_BASE_COLOR], 0.0f, 1.0f, color);
    metallic = graph_number(graph, outputs[GRAPH_METALLIC], 0.0f, 1.0f, metallic);
    roughness = graph_number(graph, outputs[GRAPH_ROUGHNESS], 0.0f, 1.0f, roughness);
    specular = graph_number(graph, outputs[GRAPH_SPECULAR], 0.0f, 1.0f, specular);
    specular_color = graph_vector(graph, outputs[GRAPH_SPECULAR_COLOR], 0.0f, 1.0f, specular_color);
    light = graph_vector(graph, outputs[GRAPH_EMISSION], 0.0f, MAXFLOAT, light);
#endif
#if HAS_NORMAL_MAPS
    // The directions in which u and v grow, as glTF has them: v grows downwards in the picture, green points up.
    Vec3 along_u = scale3(1.0f / determinant, sub3(scale3(dv2, world_edge1), scale3(dv1, world_edge2)));
    Vec3 along_v = scale3(1.0f / determinant, sub3(scale3(du1, world_edge2), scale3(du2, world_edge1)));
    Vec3 outward = either3(from_behind, negate3(ns), ns);
    Vec3 tangent = normalize3(sub3(along_u, scale3(dot3(along_u, outward), outward)));
    Vec3 bitangent = cross3(outward, tangent);
    bitangent = either3(dot3(bitangent, along_v) > 0.0f, negate3(bitangent), bitangent);
    Vec3 within = vec3(0.0f, 0.0f, 1.0f);
    bool has_normal = m->normal_map >= 0;
    texel = sample_map(maps, m->normal_map, across, down, footprint);
    within = either3(has_normal, vec3(texel.x * 2.0f - 1.0f, texel.y * 2.0f - 1.0f, texel.z * 2.0f - 1.0f), within);
#if HAS_GRAPHS
    within = graph_vector(graph, outputs[GRAPH_NORMAL], -MAXFLOAT, MAXFLOAT, within);
    has_normal = has_normal || outputs[GRAPH_NORMAL] >= 0;
#endif
    Vec3 sideways = add3(scale3(within.x, tangent), scale3(within.y, bitangent));
    Vec3 bent = normalize3(add3(scale3(m->normal_scale, sideways), scale3(within.z, outward)));
    bool is_bent = has_normal && uv_area > 0.0f && dot3(bent, bent) > 0.5f;
    ns = either3(is_bent, either3(from_behind, negate3(bent), bent), ns);
#endif
#endif
    // A shading normal that points away from the viewer reflects nothing that he could see.
    ns = either3(dot3(ns, direction) < 0.0f, ns, ng);

    surface.geometric_normal = ng;
    surface.shading_normal = ns;
#if HAS_TRANSMISSION
    bool reflects = faces || m->transmission > 0.0f;
#else
    bool reflects = faces;
#endif
    surface.albedo = either3(reflects, color, all3(0.0f));
    surface.metallic = metallic;
    surface.roughness = roughness;
    surface.specular = specular;
    surface.specular_color = specular_color;
    surface.emitted = either3(faces, light, all3(0.0f));
    surface.material = index;
    surface.from_behind = from_behind;
    surface.cone_width = cone_width;
    surface.cone_spread = cone_spread;
    return surface;
}
