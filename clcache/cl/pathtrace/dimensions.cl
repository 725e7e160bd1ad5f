// Which numbers of a sample serve what: the place in the pixel, then eight for each surface vertex.

#define DIMENSION_PIXEL 0u
#define DIMENSION_VERTEX 1u  // + 2 vertex: direction x, y; roulette; part of the BSDF. + 1: place on the light x, y; light
