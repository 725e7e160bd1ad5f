// Which random numbers of a sample serve what: the place in the pixel, then four for each surface vertex.

#define DIMENSION_PIXEL 0u
#define DIMENSION_VERTEX 1u  // + number of the vertex: direction x, y; roulette; light
