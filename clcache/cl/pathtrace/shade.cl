// One vertex of every path: a shadow ray to one of the lights, and the path's next direction, or its end. Reads the paths'
// surfaces, writes shadow rays and what each would bring, the next rays and the throughput. One work-item per path; a ray
// of length 0 is no ray.
//
// Diffuse reflection is sampled by the cosine, so that the throughput is multiplied by the albedo alone. From the bounce
// `roulette` on, a path goes on with the probability of its throughput's largest component; where `is_last`, none does.
//
// Defines: HAS_LIGHTS.

#include "common/random.cl"
#include "pathtrace/dimensions.cl"
#include "common/math.cl"

// Unit vectors that make a right-handed frame with the unit vector n (Duff et al. 2017, JCGT 6(1)).
inline void make_frame(float3 n, float3 *tangent, float3 *bitangent)
{
    float sign = copysign(1.0f, n.z);
    float a = -1.0f / (sign + n.z), b = n.x * n.y * a;
    *tangent = (float3)(1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x);
    *bitangent = (float3)(b, sign + n.y * n.y * a, -n.y);
}

inline float3 sample_cosine(float3 n, float u1, float u2)
{
    float sine, cosine;
    sincos_turns(u2, &sine, &cosine);
    float radius = sqrt(u1);
    float3 tangent, bitangent;
    make_frame(n, &tangent, &bitangent);
    return normalize3(radius * cosine * tangent + radius * sine * bitangent + sqrt(1.0f - u1) * n);
}

__kernel void shade(
    __global const Light *lights,            // (lights) or null
    __global const uint *hit_instance,       // (n)
    __global const float *point,             // (3, n)
    __global const float *offset,            // (n)
    __global const float *geometric_normal,  // (3, n)
    __global const float *shading_normal,    // (3, n)
    __global const float *albedo,            // (3, n)
    __global float *ray_origin,              // (3, n)
    __global float *ray_direction,           // (3, n)
    __global float *ray_length,              // (n)
    __global float *throughput,              // (3, n)
    __global float *shadow_direction,        // (3, n) or null
    __global float *shadow_length,           // (n) or null
    __global float *shadow_radiance,         // (3, n) or null
    __global uint *ray_counts,               // (2, n)
    uint n,
    uint light_count,
    uint vertex,
    uint roulette,
    uint is_last,
    uint sample,
    uint key0,
    uint key1)
{
    uint i = get_global_id(0);
    if (i >= n) return;
    if (hit_instance[i] == NONE) {
        ray_length[i] = 0.0f;
#if HAS_LIGHTS
        shadow_length[i] = 0.0f;
#endif
        return;
    }
    float4 random = random4(i, sample, DIMENSION_VERTEX + vertex, (uint2)(key0, key1));
    float3 ng = load_planes(geometric_normal, n, i), ns = load_planes(shading_normal, n, i);
    float3 origin = load_planes(point, n, i) + offset[i] * ng;
    float3 reflected = load_planes(throughput, n, i) * load_planes(albedo, n, i);
    store_planes(ray_origin, n, i, origin);

#if HAS_LIGHTS
    Light light = lights[min((uint)(random.w * (float)light_count), light_count - 1)];
    float3 vector = (float3)(light.vector[0], light.vector[1], light.vector[2]);
    bool is_point = light.kind == 0;
    float3 to_light = is_point ? vector - origin : vector;
    float3 towards = normalize3(to_light);
    float squared = dot3(to_light, to_light);
    float cosine = dot3(ns, towards);
    float3 power = (float3)(light.power[0], light.power[1], light.power[2]);
    float3 arriving = is_point ? power / squared : power;
    bool lit = cosine > 0.0f && dot3(ng, towards) > 0.0f && squared > 0.0f;
    shadow_length[i] = lit ? (is_point ? 1.0f : INFINITY) : 0.0f;
    store_planes(shadow_direction, n, i, to_light);
    store_planes(shadow_radiance, n, i, reflected * arriving * (cosine * ONE_OVER_PI * (float)light_count));
    ray_counts[n + i] += lit;
#endif

    float3 next = sample_cosine(ns, random.x, random.y);
    float survival = vertex + 1 >= roulette ? fmin(max_component(reflected), 1.0f) : 1.0f;
    bool goes_on = !is_last && dot3(ng, next) > 0.0f && max_component(reflected) > 0.0f && random.z < survival;
    store_planes(ray_direction, n, i, next);
    store_planes(throughput, n, i, reflected / survival);
    ray_length[i] = goes_on ? INFINITY : 0.0f;
    ray_counts[i] += goes_on;
}
