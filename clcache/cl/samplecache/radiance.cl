// What a sample remembers of the light that reaches it: 128 bits.
//
//   x, y, z: radiance, linear RGB, as the bits of floats; with DEMODULATE without the first hit's albedo
//   w: how many radiance samples it is the mean of (16 bits) | for how many updates the sample has lived (16 bits); both saturate
//
// A mean of 65,534 values moves by a 65,535th of the difference of a new one from it: for float32 still something, as long as that
// difference is above 1/256 of the mean. Where new values get a fixed or a least part, the count stops at the reciprocal of that,
// since no more of them matter.
//
// The background is known exactly, from when the sample is made (so the environment must not change), and is not shaded: it has
// OF_BACKGROUND in place of a count. In its pixel it weighs as much as the other samples do on average, since by number is how they
// cover the pixel.

#include "common/math.cl"

#define MOST_COUNTED 0xFFFEu
#define OF_BACKGROUND 0xFFFFu

// A sample's weight in its pixel is count / (count + HALF_WEIGHT): all the same once they have settled, as a box filter would have
// it, while those that are still noisy count by the number of values that they are the mean of.
#define HALF_WEIGHT 16.0f

inline uint count_of(__global const uint *shading, uint sample)
{
    return shading[words_of(sample) + 3] & 0xFFFFu;
}

inline uint age_of(__global const uint *shading, uint sample)
{
    return shading[words_of(sample) + 3] >> 16;
}

inline Vec3 radiance_of(__global const uint *shading, uint sample)
{
    __global const uint *words = shading + words_of(sample);
    return vec3(as_float(words[0]), as_float(words[1]), as_float(words[2]));
}

inline float weight_of(uint count)
{
    return (float)(int)count / ((float)(int)count + HALF_WEIGHT);
}

// In place of a weight: the background.
#define FAR -1.0f
