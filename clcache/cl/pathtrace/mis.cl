// Weights for two ways to find the same light.

// Veach's power heuristic with exponent 2, for a sample of density `own` that another strategy finds with density `other`.
inline float power_heuristic(float own, float other)
{
    if (isinf(own)) return 1.0f;
    float ratio = other / own;
    return 1.0f / (1.0f + ratio * ratio);
}
