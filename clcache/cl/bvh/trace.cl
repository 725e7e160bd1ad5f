// Trace rays: the nearest hit of each, or whether there is any. Reads the rays as planes, and the scene. A ray whose length is
// not above t_min is not traced: a miss, and not occluded. All go as packets (packet.cl): those of `*_hit_packets` are 16 rays
// in a row, one work-item for each 16 rays; `*_hit` finds rays that are alike within chunks, one work-item for each. The
// results are the same bits.
//
// Defines: those of bvh/traced.cl.

#include "bvh/queue.cl"

ONE_BY_ONE __kernel __attribute__((reqd_work_group_size(1, 1, 1))) void closest_hit(
    __global const Node *top_nodes,         // (top_inner)
    __global const Node *nodes,             // (inner)
    __global const Block *blocks,           // (blocks_used)
    __global const Instance *placed,        // (placements)
    __global const float *bounds,           // (6)
    __global const uint *joined_first,      // (first_ends)
    __global const uint *joined_instance,   // (joined_meshes)
    __global const Instance *instances,     // (instances) or null
    __global const uint *triangles,         // (triangles, 3) or null
    __global const uint *material,          // (triangles) or null
    __global const float *uvs,              // (vertices, 2) or null
    __global const Material *materials,     // (materials) or null
    __global const TextureUse *uses,        // (uses) or null
    __global const Texture *textures,       // (textures) or null
    __global const uint *texels,            // (texels) or null
    __global const float *srgb,             // (256) or null
    __global const float *origins,          // (3, n)
    __global const float *directions,       // (3, n)
    __global const float *t_mins,           // (n) or null
    __global const float *lengths,          // (n)
    __global float *t,                      // (n)
    __global float *uv,                     // (2, n)
    __global uint *primitive,               // (n)
    __global uint *instance,                // (n)
    uint joined,
    int top_root,
    uint n)
{
    uint begin = CHUNK * get_global_id(0);
    if (begin >= n) return;
    uint rays = min((uint)CHUNK, n - begin);
    Traced traced = { top_nodes, nodes, blocks, placed, joined_first, joined_instance, bounds, joined, top_root };
#if HAS_ALPHA
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    traced.masks = masks;
#endif
    ushort order[CHUNK];
    uint busy = order_chunk(directions, t_mins, lengths, n, begin, rays, order);
    for (uint at = 0; at < busy; at += RAYS) {
        uint together = min(RAYS, busy - at);
        Packet packet = gather_packet(origins, directions, t_mins, lengths, n, begin, order + at, together);
        trace_packet(&traced, false, true, &packet);
        scatter_hits(&traced, &packet, t, uv, primitive, instance, n, begin, order + at, together);
    }
    scatter_misses(t, uv, primitive, instance, n, begin, order + busy, rays - busy);
}

ONE_BY_ONE __kernel __attribute__((reqd_work_group_size(1, 1, 1))) void any_hit(
    __global const Node *top_nodes,         // (top_inner)
    __global const Node *nodes,             // (inner)
    __global const Block *blocks,           // (blocks_used)
    __global const Instance *placed,        // (placements)
    __global const float *bounds,           // (6)
    __global const uint *joined_first,      // (first_ends)
    __global const uint *joined_instance,   // (joined_meshes)
    __global const Instance *instances,     // (instances) or null
    __global const uint *triangles,         // (triangles, 3) or null
    __global const uint *material,          // (triangles) or null
    __global const float *uvs,              // (vertices, 2) or null
    __global const Material *materials,     // (materials) or null
    __global const TextureUse *uses,        // (uses) or null
    __global const Texture *textures,       // (textures) or null
    __global const uint *texels,            // (texels) or null
    __global const float *srgb,             // (256) or null
    __global const float *origins,          // (3, n)
    __global const float *directions,       // (3, n)
    __global const float *t_mins,           // (n) or null
    __global const float *lengths,          // (n)
    __global uchar *occluded,               // (n)
    uint joined,
    int top_root,
    uint n)
{
    uint begin = CHUNK * get_global_id(0);
    if (begin >= n) return;
    uint rays = min((uint)CHUNK, n - begin);
    Traced traced = { top_nodes, nodes, blocks, placed, joined_first, joined_instance, bounds, joined, top_root };
#if HAS_ALPHA
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    traced.masks = masks;
#endif
    ushort order[CHUNK];
    uint busy = order_chunk(directions, t_mins, lengths, n, begin, rays, order);
    for (uint at = 0; at < busy; at += RAYS) {
        uint together = min(RAYS, busy - at);
        Packet packet = gather_packet(origins, directions, t_mins, lengths, n, begin, order + at, together);
        trace_packet(&traced, true, true, &packet);
        scatter_occluded(&packet, occluded, begin, order + at, together);
    }
    for (uint k = busy; k < rays; k++) occluded[begin + order[k]] = 0;
}

ONE_BY_ONE __kernel void closest_hit_packets(
    __global const Node *top_nodes,         // (top_inner)
    __global const Node *nodes,             // (inner)
    __global const Block *blocks,           // (blocks_used)
    __global const Instance *placed,        // (placements)
    __global const float *bounds,           // (6)
    __global const uint *joined_first,      // (first_ends)
    __global const uint *joined_instance,   // (joined_meshes)
    __global const Instance *instances,     // (instances) or null
    __global const uint *triangles,         // (triangles, 3) or null
    __global const uint *material,          // (triangles) or null
    __global const float *uvs,              // (vertices, 2) or null
    __global const Material *materials,     // (materials) or null
    __global const TextureUse *uses,        // (uses) or null
    __global const Texture *textures,       // (textures) or null
    __global const uint *texels,            // (texels) or null
    __global const float *srgb,             // (256) or null
    __global const float *origins,          // (3, n)
    __global const float *directions,       // (3, n)
    __global const float *t_mins,           // (n) or null
    __global const float *lengths,          // (n)
    __global float *t,                      // (n)
    __global float *uv,                     // (2, n)
    __global uint *primitive,               // (n)
    __global uint *instance,                // (n)
    uint joined,
    int top_root,
    uint n)
{
    uint first = 16 * get_global_id(0);
    if (first >= n) return;
    Traced traced = { top_nodes, nodes, blocks, placed, joined_first, joined_instance, bounds, joined, top_root };
#if HAS_ALPHA
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    traced.masks = masks;
#endif
    Packet packet = load_packet(origins, directions, t_mins, lengths, n, first);
    trace_packet(&traced, false, false, &packet);
    store_hits(&traced, &packet, t, uv, primitive, instance, n, first);
}

ONE_BY_ONE __kernel void any_hit_packets(
    __global const Node *top_nodes,         // (top_inner)
    __global const Node *nodes,             // (inner)
    __global const Block *blocks,           // (blocks_used)
    __global const Instance *placed,        // (placements)
    __global const float *bounds,           // (6)
    __global const uint *joined_first,      // (first_ends)
    __global const uint *joined_instance,   // (joined_meshes)
    __global const Instance *instances,     // (instances) or null
    __global const uint *triangles,         // (triangles, 3) or null
    __global const uint *material,          // (triangles) or null
    __global const float *uvs,              // (vertices, 2) or null
    __global const Material *materials,     // (materials) or null
    __global const TextureUse *uses,        // (uses) or null
    __global const Texture *textures,       // (textures) or null
    __global const uint *texels,            // (texels) or null
    __global const float *srgb,             // (256) or null
    __global const float *origins,          // (3, n)
    __global const float *directions,       // (3, n)
    __global const float *t_mins,           // (n) or null
    __global const float *lengths,          // (n)
    __global uchar *occluded,               // (n)
    uint joined,
    int top_root,
    uint n)
{
    uint first = 16 * get_global_id(0);
    if (first >= n) return;
    Traced traced = { top_nodes, nodes, blocks, placed, joined_first, joined_instance, bounds, joined, top_root };
#if HAS_ALPHA
    Maps maps = { uses, textures, texels, srgb };
    Masks masks = { instances, triangles, material, uvs, materials, maps };
    traced.masks = masks;
#endif
    Packet packet = load_packet(origins, directions, t_mins, lengths, n, first);
    trace_packet(&traced, true, true, &packet);
    store_occluded(&packet, occluded, n, first);
}
