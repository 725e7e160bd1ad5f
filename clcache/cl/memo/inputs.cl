// From hits to values: a graph's inputs as its functions take them (cl/graph/types.cl).

#include "graph/generated.cl"
#include "memo/hit.cl"

inline float3 vector_of(Vec3 v)
{
    return (float3)(v.x, v.y, v.z);
}

// The values of a graph at a hit. values: (GRAPH_CHANNELS)
inline void evaluate_at(uint graph, const GraphHit *hit, const Maps *maps, float *values)
{
    GraphInputs in;
    in.uv.v = (float2)(hit->uv.u, hit->uv.v);
    in.uv.x = (float2)(hit->uv_x.u, hit->uv_x.v);
    in.uv.y = (float2)(hit->uv_y.u, hit->uv_y.v);
    in.position.v = vector_of(hit->position);
    in.position.x = vector_of(hit->position_x);
    in.position.y = vector_of(hit->position_y);
    in.normal = vector_of(hit->normal);
    evaluate_graph(graph, &in, maps, values);
}
