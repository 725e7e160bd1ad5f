// Which random numbers of a pixel serve what, beside those of its path (pathtrace/dimensions.cl, which begin at 0).

#include "pathtrace/dimensions.cl"

#define DIMENSION_DENSITY 0x10000u  // whether to add or to purge a sample, and which one
#define DIMENSION_COIN 0x20000u     // + sample of the pixel / 4: whether it is shaded
#define DIMENSION_VOXEL 0x30000u    // which voxel a sample asks
