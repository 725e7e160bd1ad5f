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
// LEAST_DIFFUSE_CHANCE, where there is one: of sampling the diffuse part, however little of the light it reflects.

#include "common/math.cl"

#define ALPHA_SMOOTH 1e-3f
#define LEAST_CONTRAST 1e-3f  // of eta to 1: a boundary with less of it is a window, however rough: it bends nothing

#define LEAST_DENSITY 1e-37f    // of a sample that counts: the reciprocal is finite

typedef struct Bsdf {
    Vec3 diffuse;      // albedo below the interface: base (1 - metallic) (1 - transmission)
    Vec3 f0;
    float f90;
    float alpha;       // squared roughness
    Vec3 transmitted;  // base (1 - metallic) transmission
    float eta;         // refractive index beyond the surface over that on the side of `out`
    bool thin;
} Bsdf;

typedef struct Scattered {
    Vec3 direction;
    Vec3 weight;    // f |cos| / density
    float density;  // per solid angle; infinite for a mirror or window
} Scattered;

// Unit vectors that make a right-handed frame with the unit vector n (Duff et al. 2017, JCGT 6(1)).
inline void make_frame(Vec3 n, Vec3 *tangent, Vec3 *bitangent)
{
    float sign = copysign(1.0f, n.z);
    float a = -1.0f / (sign + n.z), b = n.x * n.y * a;
    *tangent = vec3(1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x);
    *bitangent = vec3(b, sign + n.y * n.y * a, -n.y);
}

inline Vec3 sample_cosine(float u1, float u2)
{
    float sine, cosine, radius = sqrt(u1);
    sincos_turns(u2, &sine, &cosine);
    return vec3(radius * cosine, radius * sine, sqrt(1.0f - u1));
}

#if HAS_SPECULAR

// Density of microfacet normals. The form that does not cancel at small alpha.
inline float ggx_density(Vec3 h, float alpha)
{
    float x = h.x / alpha, y = h.y / alpha;
    float s = x * x + y * y + h.z * h.z;
    return 1.0f / (PI * alpha * alpha * s * s);
}

// Smith's Lambda: how much of a direction's view is masked.
inline float smith_lambda(Vec3 w, float alpha)
{
    float zz = w.z * w.z;
    return 0.5f * (sqrt(1.0f + alpha * alpha * (w.x * w.x + w.y * w.y) / zz) - 1.0f);
}

inline float smith_g1(Vec3 w, float alpha)
{
    return 1.0f / (1.0f + smith_lambda(w, alpha));
}

// A microfacet normal as seen from `out` (Dupuy and Benyoub 2023, "Sampling Visible GGX Normals with Spherical Caps").
INLINED Vec3 sample_visible_normal(Vec3 out, float alpha, float u1, float u2)
{
    Vec3 stretched = normalize3(vec3(alpha * out.x, alpha * out.y, out.z));
    float sine, cosine;
    sincos_turns(u1, &sine, &cosine);
    float z = (1.0f - u2) * (1.0f + stretched.z) - stretched.z;
    float radius = sqrt(clamp(1.0f - z * z, 0.0f, 1.0f));
    Vec3 h = add3(vec3(radius * cosine, radius * sine, z), stretched);
    return normalize3(vec3(alpha * h.x, alpha * h.y, fmax(h.z, 0.0f)));
}

inline float visible_normal_density(Vec3 out, Vec3 h, float alpha)
{
    return smith_g1(out, alpha) * fmax(dot3(out, h), 0.0f) * ggx_density(h, alpha) / out.z;
}

// Reflectance of a smooth dielectric; `cosine` of the angle of incidence, eta as in Bsdf. 1 beyond the critical angle.
inline float dielectric_fresnel(float cosine, float eta)
{
    float sine2 = (1.0f - cosine * cosine) / (eta * eta);
    float refracted = sqrt(fmax(1.0f - sine2, 0.0f));
    float parallel = (eta * cosine - refracted) / (eta * cosine + refracted);
    float perpendicular = (cosine - eta * refracted) / (cosine + eta * refracted);
    return sine2 >= 1.0f ? 1.0f : 0.5f * (parallel * parallel + perpendicular * perpendicular);
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

inline Vec3 fresnel(const Bsdf *bsdf, float cosine)
{
    float c = 1.0f - clamp(cosine, 0.0f, 1.0f), c2 = c * c;
    Vec3 schlick = add3(bsdf->f0, scale3(c2 * c2 * c, sub3(all3(bsdf->f90), bsdf->f0)));
#if HAS_TRANSMISSION
    return either3(transmits(bsdf), all3(dielectric_fresnel(cosine, bsdf->eta)), schlick);
#else
    return schlick;
#endif
}

// Chance that a sample is taken from the diffuse part.
inline float diffuse_chance(const Bsdf *bsdf, Vec3 out)
{
    float reflected = max_component(fresnel(bsdf, out.z));
    float below = (1.0f - reflected) * max_component(bsdf->diffuse);
#if HAS_TRANSMISSION
    reflected += (1.0f - reflected) * max_component(bsdf->transmitted);
#endif
    float total = below + reflected, chance = total > 0.0f ? below / total : 1.0f;
#ifdef LEAST_DIFFUSE_CHANCE
    chance = below > 0.0f ? fmax(chance, LEAST_DIFFUSE_CHANCE) : chance;
#endif
    return chance;
}

// Chance that, at a microfacet, the reflected direction is taken and not the transmitted one.
inline float reflection_chance(const Bsdf *bsdf, Vec3 f)
{
    return transmits(bsdf) ? f.x : 1.0f;
}

inline Vec3 reflect_about(Vec3 out, Vec3 h)
{
    return sub3(scale3(2.0f * dot3(out, h), h), out);
}

#endif

#if HAS_TRANSMISSION

// The direction behind the surface; zero beyond the critical angle.
inline Vec3 refract_about(Vec3 out, Vec3 h, float eta)
{
    float cosine = dot3(out, h);
    float sine2 = (1.0f - cosine * cosine) / (eta * eta);
    float along = cosine / eta - sqrt(fmax(1.0f - sine2, 0.0f));
    Vec3 refracted = sub3(scale3(along, h), scale3(1.0f / eta, out));
    return either3(sine2 >= 1.0f, all3(0.0f), refracted);
}

// f |cos| of transmission into `in` (in.z < 0), and the density of sampling it, given that a microfacet was chosen.
INLINED Vec3 evaluate_transmission(const Bsdf *bsdf, Vec3 out, Vec3 in, float *density)
{
    Vec3 mirrored = vec3(in.x, in.y, -in.z);
    bool straight = bsdf->thin;
    Vec3 h = either3(straight, add3(out, mirrored), negate3(add3(out, scale3(bsdf->eta, in))));
    h = normalize3(h);
    h = either3(h.z < 0.0f, negate3(h), h);
    float out_h = dot3(out, h), in_h = straight ? dot3(mirrored, h) : dot3(in, h);
    bool possible = out_h > 0.0f && (straight ? in_h > 0.0f : in_h < 0.0f) && h.z > 0.0f;
    float passed = 1.0f - fresnel(bsdf, out_h).x;
    float denominator = out_h + bsdf->eta * in_h;
    float bent = bsdf->eta * bsdf->eta * fabs(in_h) / (denominator * denominator);
    float jacobian = straight ? 1.0f / (4.0f * out_h) : bent;
    float visible = visible_normal_density(out, h, bsdf->alpha) * jacobian;
    *density = possible ? passed * visible : 0.0f;
    // Radiance is compressed by 1 / eta^2 on the way in, and expands on the way out.
    float compression = straight ? 1.0f : 1.0f / (bsdf->eta * bsdf->eta);
    float value = passed * visible * smith_g1(in, bsdf->alpha) * compression;
    return scale3(possible ? value : 0.0f, bsdf->transmitted);
}

#endif

// f |cos| for light from `in`, without mirrors and windows; *density: of sample_bsdf for it, per solid angle.
INLINED Vec3 evaluate_bsdf(const Bsdf *bsdf, Vec3 out, Vec3 in, float *density)
{
#if !HAS_SPECULAR
    *density = fmax(in.z, 0.0f) * ONE_OVER_PI;
    return scale3(*density, bsdf->diffuse);
#else
    float chance = diffuse_chance(bsdf, out);
    bool rough = is_rough(bsdf), above = in.z > 0.0f;
    Vec3 h = normalize3(add3(out, in));
    float out_h = fmax(dot3(out, h), 0.0f);
    Vec3 f = fresnel(bsdf, out_h);
    Vec3 value = scale3(in.z * ONE_OVER_PI, mul3(sub3(all3(1.0f), f), bsdf->diffuse));
    float found = chance * in.z * ONE_OVER_PI;
    float d = ggx_density(h, bsdf->alpha);
    float lambda_out = smith_lambda(out, bsdf->alpha), lambda_in = smith_lambda(in, bsdf->alpha);
    float g = transmits(bsdf) ? 1.0f / ((1.0f + lambda_out) * (1.0f + lambda_in)) : 1.0f / (1.0f + lambda_out + lambda_in);
    float visible = (1.0f - chance) * reflection_chance(bsdf, f) * d / ((1.0f + lambda_out) * 4.0f * out.z);
    bool shines = rough && out_h > 0.0f;
    value = add3(value, either3(shines, scale3(d * g / (4.0f * out.z), f), all3(0.0f)));
    found += shines ? visible : 0.0f;
    value = either3(above, value, all3(0.0f));
    *density = above ? found : 0.0f;
#if HAS_TRANSMISSION
    float found_below;
    Vec3 value_below = evaluate_transmission(bsdf, out, in, &found_below);
    bool below = rough && transmits(bsdf) && in.z < 0.0f;
    value = either3(below, value_below, value);
    *density = below ? found_below * (1.0f - chance) : *density;
#endif
    return value;
#endif
}

// A direction that light comes from. `pick` chooses the part; weight 0: absorbed.
INLINED Scattered sample_bsdf(const Bsdf *bsdf, Vec3 out, float pick, float u1, float u2)
{
    Scattered scattered;
#if !HAS_SPECULAR
    scattered.direction = sample_cosine(u1, u2);
    scattered.density = scattered.direction.z * ONE_OVER_PI;
    scattered.weight = bsdf->diffuse;
#else
    float chance = diffuse_chance(bsdf, out);
    bool rough = is_rough(bsdf), is_diffuse = pick < chance;
    float rest = (pick - chance) / (1.0f - chance);
    Vec3 h = either3(rough, sample_visible_normal(out, bsdf->alpha, u1, u2), vec3(0.0f, 0.0f, 1.0f));
    Vec3 f = fresnel(bsdf, dot3(out, h));
    float reflected = reflection_chance(bsdf, f);
    bool reflects = rest < reflected;
    Vec3 mirror = reflect_about(out, h), direction = mirror;
    float taken = (1.0f - chance) * (reflects ? reflected : 1.0f - reflected);
    Vec3 passed = f;
#if HAS_TRANSMISSION
    Vec3 beyond = either3(bsdf->thin, vec3(mirror.x, mirror.y, -mirror.z), refract_about(out, h, bsdf->eta));
    direction = either3(reflects, mirror, beyond);
    float compression = bsdf->thin ? 1.0f : 1.0f / (bsdf->eta * bsdf->eta);
    passed = either3(reflects, f, scale3((1.0f - f.x) * compression, bsdf->transmitted));
#endif
    Vec3 smooth_weight = either3(taken > 0.0f, scale3(1.0f / taken, passed), all3(0.0f));
    direction = either3(is_diffuse, sample_cosine(u1, u2), direction);
    float density;
    Vec3 value = evaluate_bsdf(bsdf, out, direction, &density);
    density = is_diffuse || reflects == (direction.z > 0.0f) ? density : 0.0f;  // else lost on the wrong side
    Vec3 rough_weight = either3(density >= LEAST_DENSITY, scale3(1.0f / density, value), all3(0.0f));
    bool is_mirror = !is_diffuse && !rough;
    scattered.direction = direction;
    scattered.weight = either3(is_mirror, smooth_weight, rough_weight);
    scattered.density = is_mirror ? INFINITY : density;
#endif
    return scattered;
}
