// The surface of a cached sample, and its albedo.
//
// With DEMODULATE radiance is stored without the first hit's albedo, by which it is divided: by no less than LEAST_ALBEDO, since of
// a surface that is darker most of the light is reflected by its gloss.
//
// Defines: those of surface.cl.

#include "common/camera.cl"
#include "scene/first_hit.cl"
#include "scene/surface.cl"

#define LEAST_ALBEDO 0.05f

// The surface of a sample as the eye sees it; the cone about the ray to it begins with no width. graph: what its material's graph
// returned there.
INLINED Surface surface_of(const Triangles *scene, const Camera *camera, FirstHit hit, const GraphValues *graph,
                           Vec3 *direction, float *t)
{
    Geometry geometry = { scene->positions, scene->masks.triangles, scene->masks.instances };
    Vec3 towards = sub3(locate(&geometry, hit).point, eye_of(camera));
    *direction = normalize3(towards);
    *t = dot3(towards, *direction);
    return find_surface(scene, hit.w, hit.z, unpack_u(hit), unpack_v(hit), *t, *direction, 0.0f, pixel_spread(camera),
                        graph);
}

// By what the radiance of a surface is divided.
inline Vec3 modulation(const Surface *surface)
{
    Vec3 albedo = surface->albedo;
    return vec3(fmax(albedo.x, LEAST_ALBEDO), fmax(albedo.y, LEAST_ALBEDO), fmax(albedo.z, LEAST_ALBEDO));
}
