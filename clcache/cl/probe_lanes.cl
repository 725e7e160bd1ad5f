// Follows common/lane_group.cl: every function of a lane group, and a function that some lanes call and that passes vectors on. One
// work-item per value; of its group: the lanes that a ballot holds, the value of lane 5, that of a lane which each lane chooses,
// as a word and as a number, and the least value; and what the calls gave, 0 where there was none.

__attribute__((noinline)) void mix_vectors(float2 a, float3 b, float3 *mixed)
{
    *mixed = (float3)(a.x, a.y, a.x + a.y) * b + (float3)(1.0f, 2.0f, b.x);
}

__attribute__((noinline)) void call_with_vectors(const float *in, float *out)
{
    float3 mixed;
    mix_vectors((float2)(in[0], in[1]), (float3)(2.0f, 3.0f, in[0]), &mixed);
    out[0] = mixed.x + mixed.y;
    out[1] = mixed.z;
}

__kernel __attribute__((reqd_work_group_size(32, 1, 1) IN_LANES)) void probe(
    __global const uint *value,  // (n)
    __global uint *found,        // (7, n)
    uint n)
{
    __local uint words[LANES];
    Lanes lanes = lanes_of(words);
    uint i = get_global_id(0), own = i < n ? value[i] : 0, other = (own >> 7) % LANES;
    uint held = lane_ballot(&lanes, (own & 1u) != 0);
    uint fifth = lane_broadcast(&lanes, own, 5u), chosen = lane_shuffle(&lanes, own, other);
    float number = lane_shuffle(&lanes, (float)(own >> 8), other);
    uint least = lane_min(&lanes, own);
    float in[2] = { (float)(own & 255u), (float)(own >> 8 & 255u) }, out[2] = { 0.0f, 0.0f };
    if (own & 1u) call_with_vectors(in, out);
    if (i < n) {
        found[i] = held;
        found[n + i] = fifth;
        found[2 * n + i] = chosen;
        found[3 * n + i] = (uint)number;
        found[4 * n + i] = least;
        found[5 * n + i] = (uint)out[0];
        found[6 * n + i] = (uint)out[1];
    }
}
