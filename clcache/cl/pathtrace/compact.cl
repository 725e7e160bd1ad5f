// Between two vertices: what the shadow rays let through goes to the radiance of their paths, and the paths that have ended
// leave the queue. One work-item per chunk of the queue: those that go on move to its front, in order, with all that the next
// vertex reads; `alive` is how many they are. Behind them all rays have length 0. A chunk that no more than an eighth has left
// stays as it is.
//
// Defines: HAS_DIRECT (there are shadow rays), SETTLED (others have seen to what they let through), HAS_EMISSION (there is a density),
// HAS_TEXTURES (there are cones).

#include "pathtrace/queue.cl"

// Move the values at a chunk's places order[0 .. count - 1], ascending, to its front.
inline void close_ranks(__global float *chunk, const ushort *order, uint count)
{
    for (uint k = 0; k < count; k++) chunk[k] = chunk[order[k]];
}

__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void compact(
    __global float *ray_origin,             // (3, n)
    __global float *ray_direction,          // (3, n)
    __global float *ray_length,             // (n)
    __global float *throughput,             // (3, n)
    __global float *density,                // (n) or null
    __global float *cone,                   // (2, n) or null
    __global uint *path,                    // (n)
    __global uint *alive,                   // (chunks)
    __global float *radiance,               // (3, n) or null
    __global const uchar *occluded,         // (n) or null
    __global float *shadow_length,          // (n) or null
    __global const float *shadow_radiance,  // (3, n) or null
    uint n,
    uint chunks)
{
    uint chunk = get_global_id(0);
    if (chunk >= chunks) return;
    uint begin = chunk * CHUNK, places = alive[chunk];
#if HAS_DIRECT && SETTLED
    for (uint i = begin; i < begin + places; i++) shadow_length[i] = 0.0f;  // where nothing is shaded any more, none may be left
#elif HAS_DIRECT
    for (uint i = begin; i < begin + places; i++) {
        bool was_lit = shadow_length[i] > 0.0f && !occluded[i];
        Vec3 brought = either3(was_lit, load_vec3(shadow_radiance, n, i), all3(0.0f));
        store_planes(radiance, n, path[i], add3(load_vec3(radiance, n, path[i]), brought));
    }
#endif
    ushort order[CHUNK];
    uint count = 0;
    for (uint k = 0; k < places; k++) {
        order[count] = k;
        count += ray_length[begin + k] > 0.0f ? 1 : 0;
    }
    if (count > places - places / 8) return;
    alive[chunk] = count;
    for (uint plane = 0; plane < 3; plane++) {
        close_ranks(ray_origin + plane * n + begin, order, count);
        close_ranks(ray_direction + plane * n + begin, order, count);
        close_ranks(throughput + plane * n + begin, order, count);
    }
    close_ranks(ray_length + begin, order, count);
#if HAS_EMISSION
    close_ranks(density + begin, order, count);
#endif
#if HAS_TEXTURES
    close_ranks(cone + begin, order, count);
    close_ranks(cone + n + begin, order, count);
#endif
    for (uint k = 0; k < count; k++) path[begin + k] = path[begin + order[k]];
    for (uint i = begin + count; i < begin + places; i++) ray_length[i] = 0.0f;
#if HAS_DIRECT
    for (uint i = begin + count; i < begin + places; i++) shadow_length[i] = 0.0f;
#endif
}
