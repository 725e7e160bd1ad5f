// Which numbers of a sample serve what, beside those of pathtrace/dimensions.cl, which are of the paths that fill the cache.
// Where a ray goes through its pixel is the same for both, so that an image finds in the cache what was put there for it.

#include "pathtrace/dimensions.cl"

#define DIMENSION_LAYER 256u   // + 2 layer, +1: as of a vertex, of the paths that read the cache
#define DIMENSION_ASK 512u     // + layer: place about a point, x, y
#define DIMENSION_PLACE 1024u  // place of a path's beginning: triangle; place in it x, y. + 1: direction x, y; side
