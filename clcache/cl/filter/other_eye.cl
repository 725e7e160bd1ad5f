// Which pixels of the other eye show the surface that a pixel of this eye shows. What is compared are depths along the cameras'
// axes, as reciprocals: those of a plane are linear across an image, and the background is at 0.

// How far a pixel's reciprocal depth may be from the point's, as a part of it; that of a plane is linear across the image, so
// that no slope beyond that of the surface itself need be allowed for.
#define DEPTH_TOLERANCE 0.01f
// Pixels along each axis from the point to a first hit: to the centre of the farthest pixel that has weight, and half a pixel
// for where in its pixel either hit lies.
#define REACH 2.5f

// The smaller of the steps to both sides, none where they go different ways, or at the image's edge, where what lies past it is taken
// to be as here: with one step alone, every silhouette would pass for a slope.
inline float least_step(float before, float here, float after)
{
    float down = here - before, up = after - here;
    return down * up > 0.0f ? fmin(fabs(down), fabs(up)) : 0.0f;
}

// How far a reciprocal depth may be from the expected one. slope: of reciprocal depths there, from pixel to pixel, both axes'.
inline float allowed_step(float expected, float slope)
{
    return DEPTH_TOLERANCE * expected + REACH * slope;
}

inline bool shows(float near, float expected, float allowed)
{
    return (near > 0.0f) == (expected > 0.0f) && fabs(near - expected) <= allowed;
}
