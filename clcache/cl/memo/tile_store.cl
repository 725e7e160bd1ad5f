// Where the texels of tiles are (MaterialMemo, section 5.4.1), of a tile that is entry `entry` of the table:
//
//   TEXELS_IN_ENTRY    in the entry's own record, behind what the table needs
//   TEXELS_IN_IMAGE2D  in a picture: tiles side by side, and within each its channels, four by four, side by side
//   TEXELS_IN_IMAGE3D  in a picture with layers, one for each four channels
//   none of them       in an array of their own: a tile's texels one after the other, each with all its channels
//
// Functions that get at texels have the parameter STORE_PARAMETER and are given STORE, since images cannot be in structs.
//
// Defines: those of values.cl; TILE_WIDTH, TILE_HEIGHT (stored texels); one of the above.

#include "memo/values.cl"

#define TEXELS ((uint)(TILE_WIDTH * TILE_HEIGHT))
#define TEXEL_WORDS (HALF ? (GRAPH_CHANNELS + 1u) / 2u : (uint)GRAPH_CHANNELS)
#define QUADS ((GRAPH_CHANNELS + 3) / 4)  // of channels

#if TEXELS_IN_IMAGE2D || TEXELS_IN_IMAGE3D

#if TEXELS_IN_IMAGE3D
#pragma OPENCL EXTENSION cl_khr_3d_image_writes : enable
#define STORE_PARAMETER read_only image3d_t tiles_read, write_only image3d_t tiles_written
typedef int4 TexelPlace;
#else
#define STORE_PARAMETER read_only image2d_t tiles_read, write_only image2d_t tiles_written
typedef int2 TexelPlace;
#endif
#define STORE tiles_read, tiles_written

// Where the first four channels of a texel are, in an image of this width and height.
inline TexelPlace texel_place(int width, int height, uint entry, uint texel)
{
    int tile = (int)entry, column = (int)texel % TILE_WIDTH, row = (int)texel / TILE_WIDTH;
#if TEXELS_IN_IMAGE3D
    int across = width / TILE_WIDTH, down = height / TILE_HEIGHT;
    column += tile % across * TILE_WIDTH;
    row += tile / across % down * TILE_HEIGHT;
    return (int4)(column, row, tile / across / down * QUADS, 0);
#else
    int across = width / (TILE_WIDTH * QUADS);
    return (int2)(column + tile % across * (TILE_WIDTH * QUADS), row + tile / across * TILE_HEIGHT);
#endif
}

// That of the next four.
inline TexelPlace next_quad(TexelPlace place)
{
#if TEXELS_IN_IMAGE3D
    place.z++;
#else
    place.x += TILE_WIDTH;
#endif
    return place;
}

inline void store_tile_texel(const Table *table, STORE_PARAMETER, uint entry, uint texel, const float *values)
{
    TexelPlace place = texel_place(get_image_width(tiles_written), get_image_height(tiles_written), entry, texel);
    mem_fence(CLK_GLOBAL_MEM_FENCE);  // images know no `volatile`
    for (uint quad = 0; quad < QUADS; quad++) {
        float four[4] = { 0.0f, 0.0f, 0.0f, 0.0f };
        for (uint c = 0; c < 4 && 4 * quad + c < GRAPH_CHANNELS; c++) four[c] = values[4 * quad + c];
        write_imagef(tiles_written, place, vload4(0, four));
        place = next_quad(place);
    }
    mem_fence(CLK_GLOBAL_MEM_FENCE);
}

inline void load_tile_texel(const Table *table, STORE_PARAMETER, uint entry, uint texel, float *values)
{
    TexelPlace place = texel_place(get_image_width(tiles_read), get_image_height(tiles_read), entry, texel);
    mem_fence(CLK_GLOBAL_MEM_FENCE);
    for (uint quad = 0; quad < QUADS; quad++) {
        float four[4];
        vstore4(read_imagef(tiles_read, place), 0, four);
        for (uint c = 0; c < 4 && 4 * quad + c < GRAPH_CHANNELS; c++) values[4 * quad + c] = four[c];
        place = next_quad(place);
    }
    mem_fence(CLK_GLOBAL_MEM_FENCE);
}

// Have the memory ready for an entry's record; where its texels are the driver alone knows.
inline void expect_texel(const Table *table, STORE_PARAMETER, uint entry, uint texel)
{
#if defined(__has_builtin) && !defined(NO_PREFETCH)
    __builtin_prefetch((__global const void *)record_of(table, entry));
#endif
}

#else

#define STORE_PARAMETER __global volatile uint *memo_tiles
#define STORE memo_tiles

inline __global volatile uint *texel_words(const Table *table, STORE_PARAMETER, uint entry, uint texel)
{
#if TEXELS_IN_ENTRY
    return value_words(table, entry) + texel * TEXEL_WORDS;
#else
    return memo_tiles + ((size_t)entry * TEXELS + texel) * TEXEL_WORDS;
#endif
}

// Have the memory ready for a texel of an entry, and for its record (as samplecache/moved.cl does).
inline void expect_texel(const Table *table, STORE_PARAMETER, uint entry, uint texel)
{
#if defined(__has_builtin) && !defined(NO_PREFETCH)
    __global volatile uint *words = texel_words(table, STORE, entry, texel);
    __builtin_prefetch((__global const void *)record_of(table, entry));
    __builtin_prefetch((__global const void *)words);
    __builtin_prefetch((__global const void *)(words + TEXEL_WORDS - 1));
#endif
}

inline void store_tile_texel(const Table *table, STORE_PARAMETER, uint entry, uint texel, const float *values)
{
    store_values(texel_words(table, STORE, entry, texel), values);
}

inline void load_tile_texel(const Table *table, STORE_PARAMETER, uint entry, uint texel, float *values)
{
    load_values(texel_words(table, STORE, entry, texel), values);
}

#endif
