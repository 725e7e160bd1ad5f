// The hits of a queue of paths whose materials have graphs.

#include "memo/key.cl"

// A queue's hits, and the cones about their rays.
typedef struct Hits {
    __global const float *t;             // (n)
    __global const float *uv;            // (2, n)
    __global const uint *primitive;      // (n)
    __global const uint *instance;       // (n)
    __global const float *direction;     // (3, n)
    __global const float *length;        // (n), of rays: 0 is none
    __global const float *cone;          // (2, n)
    uint n;
} Hits;

// The number of the graph of a place's hit; -1 where there is none, or none that is asked for: light_only, of what graphs emit alone.
INLINED int graph_at(const Triangles *scene, const Hits *hits, uint light_only, uint i)
{
    float length = hits->length[i];
    uint number = hits->instance[i], primitive = hits->primitive[i];
    bool has_ray = length > 0.0f, is_hit = has_ray & (number != NONE);
    number = is_hit ? number : 0;
    primitive = is_hit ? primitive : 0;
    const Masks *masks = &scene->masks;
    __global const Material *m = masks->materials + masks->material[masks->instances[number].first_triangle + primitive];
    int graph = m->graph, light = m->outputs[GRAPH_EMISSION];
    return is_hit && (light >= 0 || !light_only) ? graph : -1;
}

// What the graph is given there. Of places without a hit, that of some triangle.
INLINED GraphHit graph_hit_at(const Triangles *scene, const Hits *hits, uint i)
{
    uint n = hits->n;
    uint number = hits->instance[i], primitive = hits->primitive[i];
    float u = hits->uv[i], v = hits->uv[n + i], t = hits->t[i];
    bool is_hit = number != NONE;
    return graph_hit(scene, is_hit ? number : 0, is_hit ? primitive : 0, is_hit ? u : 0.0f, is_hit ? v : 0.0f, is_hit ? t : 0.0f,
                     load_vec3(hits->direction, n, i), hits->cone[i], hits->cone[n + i]);
}
