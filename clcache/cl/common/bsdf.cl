// The one reflection model: a metallic-roughness surface as glTF 2.0 defines it (appendix B), with transmission.
//
//   f = F R + (1 - F) ((1 - transmission) base / pi + transmission base T)
//
// R: GGX reflection with Smith masking (height-correlated). T: refraction through the same microfacets (Walter et al. 2007),
// or, if thin, straight transmission as R mirrored. F: Schlick's term between f0 and f90; for what transmits, the exact
// dielectric one, which knows total internal reflection. Below ALPHA_SMOOTH the surface is a perfect mirror or window: R
// and T are then directions instead of densities, and only sampling can find them.
//
// As in glTF, F is that of the microfacet that reflects one direction into the other, for the diffuse part too: reciprocal,
// but at grazing angles and low roughness the two parts together give more than they get.
//
// Directions are in a local frame with the shading normal along z, and point away from the surface; `out` is towards where
// the path came from and has out.z > 0.
//
// Defines: HAS_SPECULAR, HAS_TRANSMISSION: compiled out where no material has them; what is left is diffuse.

#include "common/math.cl"

#define ALPHA_SMOOTH 1e-3f
#define LEAST_CONTRAST 1e-3f  // of eta to 1: a boundary with less of it is a window, however rough: it bends nothing

typedef struct Bsdf {
    float3 diffuse;      // albedo below the interface: base (1 - metallic) (1 - transmission)
    float3 f0;
    float f90;
    float alpha;         // squared roughness
    float3 transmitted;  // base (1 - metallic) transmission
    float eta;           // refractive index beyond the surface over that on the side of `out`
    bool thin;
} Bsdf;

typedef struct Scattered {
    float3 direction;
    float3 weight;  // f |cos| / density
    float density;  // per solid angle; infinite for a mirror or window
} Scattered;

inline float luminance(float3 color)
{
    return 0.2126f * color.x + 0.7152f * color.y + 0.0722f * color.z;
}

// Unit vectors that make a right-handed frame with the unit vector n (Duff et al. 2017, JCGT 6(1)).
inline void make_frame(float3 n, float3 *tangent, float3 *bitangent)
{
    float sign = copysign(1.0f, n.z);
    float a = -1.0f / (sign + n.z), b = n.x * n.y * a;
    *tangent = (float3)(1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x);
    *bitangent = (float3)(b, sign + n.y * n.y * a, -n.y);
}

inline float3 sample_cosine(float u1, float u2)
{
    float sine, cosine, radius = sqrt(u1);
    sincos_turns(u2, &sine, &cosine);
    return (float3)(radius * cosine, radius * sine, sqrt(1.0f - u1));
}

#if HAS_SPECULAR

// Density of microfacet normals. The form that does not cancel at small alpha.
inline float ggx_density(float3 h, float alpha)
{
    float x = h.x / alpha, y = h.y / alpha;
    float s = x * x + y * y + h.z * h.z;
    return 1.0f / (PI * alpha * alpha * s * s);
}

// Smith's Lambda: how much of a direction's view is masked.
inline float smith_lambda(float3 w, float alpha)
{
    float zz = w.z * w.z;
    return 0.5f * (sqrt(1.0f + alpha * alpha * (w.x * w.x + w.y * w.y) / zz) - 1.0f);
}

inline float smith_g1(float3 w, float alpha)
{
    return 1.0f / (1.0f + smith_lambda(w, alpha));
}

// A microfacet normal as seen from `out` (Dupuy and Benyoub 2023, "Sampling Visible GGX Normals with Spherical Caps").
inline float3 sample_visible_normal(float3 out, float alpha, float u1, float u2)
{
    float3 stretched = normalize3((float3)(alpha * out.x, alpha * out.y, out.z));
    float sine, cosine;
    sincos_turns(u1, &sine, &cosine);
    float z = (1.0f - u2) * (1.0f + stretched.z) - stretched.z;
    float radius = sqrt(clamp(1.0f - z * z, 0.0f, 1.0f));
    float3 h = (float3)(radius * cosine, radius * sine, z) + stretched;
    return normalize3((float3)(alpha * h.x, alpha * h.y, fmax(h.z, 0.0f)));
}

inline float visible_normal_density(float3 out, float3 h, float alpha)
{
    return smith_g1(out, alpha) * fmax(dot3(out, h), 0.0f) * ggx_density(h, alpha) / out.z;
}

// Reflectance of a smooth dielectric; `cosine` of the angle of incidence, eta as in Bsdf. 1 beyond the critical angle.
inline float dielectric_fresnel(float cosine, float eta)
{
    float sine2 = (1.0f - cosine * cosine) / (eta * eta);
    if (sine2 >= 1.0f) return 1.0f;
    float refracted = sqrt(1.0f - sine2);
    float parallel = (eta * cosine - refracted) / (eta * cosine + refracted);
    float perpendicular = (cosine - eta * refracted) / (cosine + eta * refracted);
    return 0.5f * (parallel * parallel + perpendicular * perpendicular);
}

inline bool transmits(const Bsdf *bsdf)
{
#if HAS_TRANSMISSION
    return max_component(bsdf->transmitted) > 0.0f;
#else
    return false;
#endif
}

// Whether reflection and transmission have densities.
inline bool is_rough(const Bsdf *bsdf)
{
    bool bends = !transmits(bsdf) || bsdf->thin || fabs(bsdf->eta - 1.0f) >= LEAST_CONTRAST;
    return bsdf->alpha >= ALPHA_SMOOTH && bends;
}

inline float3 fresnel(const Bsdf *bsdf, float cosine)
{
#if HAS_TRANSMISSION
    if (transmits(bsdf)) return (float3)(dielectric_fresnel(cosine, bsdf->eta));
#endif
    float c = 1.0f - clamp(cosine, 0.0f, 1.0f), c2 = c * c;
    return bsdf->f0 + ((float3)(bsdf->f90) - bsdf->f0) * (c2 * c2 * c);
}

// Chance that a sample is taken from the diffuse part.
inline float diffuse_chance(const Bsdf *bsdf, float3 out)
{
    float reflected = max_component(fresnel(bsdf, out.z));
    float below = (1.0f - reflected) * max_component(bsdf->diffuse);
#if HAS_TRANSMISSION
    reflected += (1.0f - reflected) * max_component(bsdf->transmitted);
#endif
    float total = below + reflected;
    return total > 0.0f ? below / total : 1.0f;
}

// Chance that, at a microfacet, the reflected direction is taken and not the transmitted one.
inline float reflection_chance(const Bsdf *bsdf, float3 f)
{
    return transmits(bsdf) ? f.x : 1.0f;
}

inline float3 reflect_about(float3 out, float3 h)
{
    return 2.0f * dot3(out, h) * h - out;
}

#endif

#if HAS_TRANSMISSION

// The direction behind the surface; zero beyond the critical angle.
inline float3 refract_about(float3 out, float3 h, float eta)
{
    float cosine = dot3(out, h);
    float sine2 = (1.0f - cosine * cosine) / (eta * eta);
    if (sine2 >= 1.0f) return (float3)(0.0f);
    return (cosine / eta - sqrt(1.0f - sine2)) * h - out / eta;
}

// f |cos| of transmission into `in` (in.z < 0), and the density of sampling it, given that a microfacet was chosen.
inline float3 evaluate_transmission(const Bsdf *bsdf, float3 out, float3 in, float *density)
{
    *density = 0.0f;
    float3 mirrored = (float3)(in.x, in.y, -in.z);
    bool straight = bsdf->thin;
    float3 h = straight ? out + mirrored : -(out + bsdf->eta * in);
    h = normalize3(h);
    h = h.z < 0.0f ? -h : h;
    float out_h = dot3(out, h), in_h = straight ? dot3(mirrored, h) : dot3(in, h);
    if (!(out_h > 0.0f) || (straight ? in_h <= 0.0f : in_h >= 0.0f) || !(h.z > 0.0f)) return (float3)(0.0f);
    float passed = 1.0f - fresnel(bsdf, out_h).x;
    float jacobian;
    if (straight) jacobian = 1.0f / (4.0f * out_h);
    else {
        float denominator = out_h + bsdf->eta * in_h;
        jacobian = bsdf->eta * bsdf->eta * fabs(in_h) / (denominator * denominator);
    }
    float visible = visible_normal_density(out, h, bsdf->alpha) * jacobian;
    *density = passed * visible;
    // Radiance is compressed by 1 / eta^2 on the way in, and expands on the way out.
    float compression = straight ? 1.0f : 1.0f / (bsdf->eta * bsdf->eta);
    return bsdf->transmitted * (passed * visible * smith_g1(in, bsdf->alpha) * compression);
}

#endif

// f |cos| for light from `in`, without mirrors and windows; *density: of sample_bsdf for it, per solid angle.
inline float3 evaluate_bsdf(const Bsdf *bsdf, float3 out, float3 in, float *density)
{
#if !HAS_SPECULAR
    *density = fmax(in.z, 0.0f) * ONE_OVER_PI;
    return bsdf->diffuse * *density;
#else
    float chance = diffuse_chance(bsdf, out);
    bool rough = is_rough(bsdf);
    *density = 0.0f;
    if (in.z > 0.0f) {
        float3 h = normalize3(out + in);
        float out_h = fmax(dot3(out, h), 0.0f);
        float3 f = fresnel(bsdf, out_h);
        float3 value = ((float3)(1.0f) - f) * bsdf->diffuse * (in.z * ONE_OVER_PI);
        *density = chance * in.z * ONE_OVER_PI;
        if (rough && out_h > 0.0f) {
            float d = ggx_density(h, bsdf->alpha);
            float lambda_out = smith_lambda(out, bsdf->alpha), lambda_in = smith_lambda(in, bsdf->alpha);
            float g = transmits(bsdf) ? 1.0f / ((1.0f + lambda_out) * (1.0f + lambda_in)) : 1.0f / (1.0f + lambda_out + lambda_in);
            value += f * (d * g / (4.0f * out.z));
            *density += (1.0f - chance) * reflection_chance(bsdf, f) * d / ((1.0f + lambda_out) * 4.0f * out.z);
        }
        return value;
    }
#if HAS_TRANSMISSION
    if (rough && transmits(bsdf) && in.z < 0.0f) {
        float3 value = evaluate_transmission(bsdf, out, in, density);
        *density *= 1.0f - chance;
        return value;
    }
#endif
    return (float3)(0.0f);
#endif
}

// A direction that light comes from. `pick` chooses the part; weight 0: absorbed.
inline Scattered sample_bsdf(const Bsdf *bsdf, float3 out, float pick, float u1, float u2)
{
    Scattered scattered = { (float3)(0.0f, 0.0f, 1.0f), (float3)(0.0f), 0.0f };
#if !HAS_SPECULAR
    scattered.direction = sample_cosine(u1, u2);
    scattered.density = scattered.direction.z * ONE_OVER_PI;
    scattered.weight = bsdf->diffuse;
    return scattered;
#else
    float chance = diffuse_chance(bsdf, out);
    bool rough = is_rough(bsdf);
    if (pick < chance) scattered.direction = sample_cosine(u1, u2);
    else {
        float rest = (pick - chance) / (1.0f - chance);
        float3 h = rough ? sample_visible_normal(out, bsdf->alpha, u1, u2) : (float3)(0.0f, 0.0f, 1.0f);
        float3 f = fresnel(bsdf, dot3(out, h));
        float reflected = reflection_chance(bsdf, f);
        bool reflects = rest < reflected;
        scattered.direction = reflect_about(out, h);
#if HAS_TRANSMISSION
        if (!reflects) {
            float3 mirror = scattered.direction;
            scattered.direction = bsdf->thin ? (float3)(mirror.x, mirror.y, -mirror.z) : refract_about(out, h, bsdf->eta);
        }
#endif
        if (!rough) {
            float taken = (1.0f - chance) * (reflects ? reflected : 1.0f - reflected);
            float3 value = f;
#if HAS_TRANSMISSION
            float compression = bsdf->thin ? 1.0f : 1.0f / (bsdf->eta * bsdf->eta);
            if (!reflects) value = bsdf->transmitted * ((1.0f - f.x) * compression);
#endif
            scattered.weight = taken > 0.0f ? value / taken : (float3)(0.0f);
            scattered.density = INFINITY;
            return scattered;
        }
        if (reflects != (scattered.direction.z > 0.0f)) return scattered;
    }
    float3 value = evaluate_bsdf(bsdf, out, scattered.direction, &scattered.density);
    scattered.weight = scattered.density > 0.0f ? value / scattered.density : (float3)(0.0f);
    return scattered;
#endif
}
