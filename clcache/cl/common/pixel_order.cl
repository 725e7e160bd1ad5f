// Which pixel a path belongs to. Sixteen paths in a row are a block of 4 x 4 pixels, whose rays go much the same way; blocks
// follow each other down the columns of bands, which are so many rows of blocks, so that paths near each other in number are
// near each other in the image, too. Even bands come first, then odd ones, so that either half of the paths has its share of
// sky and ground; last what is left below the last whole band. Blocks at the right and lower edge may reach beyond the image:
// paths there have no pixel.

#include "common/math.cl"

#define BLOCK 4u  // pixels
#define BAND 8u   // rows of blocks

inline uint blocks_along(uint size)
{
    return (size + BLOCK - 1) / BLOCK;
}

// x + y width, or NONE.
inline uint pixel_of_path(uint path, uint width, uint height)
{
    uint lane = path % (BLOCK * BLOCK), block = path / (BLOCK * BLOCK);
    uint columns = blocks_along(width), rows = blocks_along(height), bands = rows / BAND, even_bands = (bands + 1) / 2;
    uint turn = block / (BAND * columns), place = block % (BAND * columns);
    uint band = turn >= bands ? bands : turn < even_bands ? 2 * turn : 2 * (turn - even_bands) + 1;
    uint height_of_band = band < bands ? BAND : max(rows - bands * BAND, 1u);
    uint column = place / height_of_band, row = band * BAND + place % height_of_band;
    uint x = BLOCK * column + lane % BLOCK, y = BLOCK * row + lane / BLOCK;
    return x < width && y < height ? x + y * width : NONE;
}

inline uint path_of_pixel(uint x, uint y, uint width, uint height)
{
    uint columns = blocks_along(width), rows = blocks_along(height), bands = rows / BAND, even_bands = (bands + 1) / 2;
    uint column = x / BLOCK, row = y / BLOCK, band = row / BAND;
    uint turn = band >= bands ? bands : band % 2 == 0 ? band / 2 : even_bands + band / 2;
    uint height_of_band = band < bands ? BAND : rows - bands * BAND;
    uint block = BAND * columns * turn + column * height_of_band + row % BAND;
    return BLOCK * BLOCK * block + BLOCK * (y % BLOCK) + x % BLOCK;
}
