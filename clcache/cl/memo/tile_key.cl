// The key of the tile that a hit lies in (MaterialMemo, section 5.4.2, Eq. 5.12-5.15), and the place within it.
//
// Defines: TILE_WIDTH, TILE_HEIGHT (stored texels), BILINEAR: tiles share their last column and row with the next, so that they cover one
// less.

#include "memo/key.cl"

#define TILE_COVERS_U (TILE_WIDTH - BILINEAR)
#define TILE_COVERS_V (TILE_HEIGHT - BILINEAR)

typedef struct TileKey {
    Key key;      // of two dimensions
    Pair within;  // in texels
} TileKey;

INLINED TileKey tile_key(const GraphHit *hit, uint graph, float bias, __global const int *coarsest)
{
    TileKey tile;
    find_levels(&tile.key, hit, bias, coarsest + 2 * graph);
    float density = power_of_two(tile.key.level.texels), aside = BILINEAR ? middle_of(tile.key.level) : 0.0f;
    float u = hit->uv.u * density - aside, v = hit->uv.v * density - aside;
    float column = floor(u), row = floor(v);  // of the texel; whole numbers from here on, which division by the tile's size would blur
    int texel_u = (int)fmin(fmax(column, -1.0e9f), 1.0e9f), texel_v = (int)fmin(fmax(row, -1.0e9f), 1.0e9f);
    int tile_u = texel_u / TILE_COVERS_U, tile_v = texel_v / TILE_COVERS_V;
    tile_u -= texel_u < tile_u * TILE_COVERS_U ? 1 : 0;
    tile_v -= texel_v < tile_v * TILE_COVERS_V ? 1 : 0;
    tile.key.u = tile_u;
    tile.key.v = tile_v;
    tile.within.u = (float)(texel_u - tile_u * TILE_COVERS_U) + (u - column);
    tile.within.v = (float)(texel_v - tile_v * TILE_COVERS_V) + (v - row);
    finish_key(&tile.key, graph, READS_UV);
    return tile;
}
