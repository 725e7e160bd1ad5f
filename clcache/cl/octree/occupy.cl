// Which cells of a part of the finest level, 1024^3 at most, the scene's triangles overlap (HashCache, section 3.1): a bit for
// each, in words of 4x4x2 cells, set by atomic_or. The words are in Morton order, so that the bits are in the order of the
// cells' keys.
//
// A triangle and a box overlap unless one of 13 axes separates them: the box's three, the triangle's normal, and the nine
// products of their edges (Akenine-Moeller 2001). Each axis bounds where the centres of overlapped cells can be by two parallel
// planes, so that along a row of cells those that overlap are an interval, found by division. A triangle's rows are shared out
// in strips, so that no triangle is one work-item's work alone.
//
// Corners are rounded to a grid of 2^20 steps along the cube's edge, and all that follows is done in whole numbers, without any
// rounding: a normal's components are below 2^41, its products with corners below 2^61. The cells are dilated by `margin`
// steps, the bound on how far a hit point can be from where its triangle is on the grid (clcache/octree/occupancy.py).

#include "common/transform.cl"
#include "octree/shape.cl"

#define GRID_BITS 20
#define PART_CELLS 1024   // along an edge of a part, at most
#define STRIP 16          // rows of cells
#define LONG 8            // cells, of a column in which only a needle can have so many
#define SEGMENT_BITS 10   // a segment is 1024 words: 32^3 cells

// The triangles of placed meshes, one mesh behind the other.
typedef struct Placement {
    __global const float *positions;
    __global const uint *triangles;
    __global const Instance *placed;
    __global const uint *first;  // the first triangle of each, and where the last ends
    uint meshes;
} Placement;

// The placed mesh that triangle i belongs to.
inline uint placed_of(const Placement *scene, uint i)
{
    uint low = 0, high = scene->meshes;
    while (high - low > 1) {
        uint middle = (low + high) / 2;
        if (scene->first[middle] <= i) low = middle;
        else high = middle;
    }
    return low;
}

// Corner k of triangle i in world space.
inline Vec3 world_corner(const Placement *scene, uint mesh, uint i, uint k)
{
    Instance instance = scene->placed[mesh];
    uint triangle = instance.first_triangle + i - scene->first[mesh];
    return transform_point(instance.to_world, row3(scene->positions, scene->triangles[3 * triangle + k]));
}

// One work-item per run of triangles: their bounds in world space.
__kernel void bound_triangles(
    __global const float *positions,  // (vertices, 3)
    __global const uint *triangles,   // (triangles, 3)
    __global const Instance *placed,  // (meshes)
    __global const uint *first,       // (ends)
    __global float *bounds,           // (runs, 6)
    uint meshes,
    uint n,
    uint runs)
{
    uint run = get_global_id(0), begin = run * RUN, end = min(begin + RUN, n);
    if (run >= runs) return;
    Placement scene = { positions, triangles, placed, first, meshes };
    Vec3 low = all3(INFINITY), high = all3(-INFINITY);
    for (uint i = begin; i < end; i++) {
        uint mesh = placed_of(&scene, i);
        for (uint k = 0; k < 3; k++) {
            Vec3 p = world_corner(&scene, mesh, i, k);
            low = vec3(fmin(low.x, p.x), fmin(low.y, p.y), fmin(low.z, p.z));
            high = vec3(fmax(high.x, p.x), fmax(high.y, p.y), fmax(high.z, p.z));
        }
    }
    store_row(bounds, 2 * run, low);
    store_row(bounds, 2 * run + 1, high);
}

inline int grid_step(float coordinate, float low, float per_size)
{
    return (int)floor((coordinate - low) * per_size * power_of_two(GRID_BITS) + 0.5f);
}

// One work-item per run of triangles: their corners on the grid.
__kernel void place_corners(
    __global const float *positions,  // (vertices, 3)
    __global const uint *triangles,   // (triangles, 3)
    __global const Instance *placed,  // (meshes)
    __global const uint *first,       // (ends)
    __global int *corners,            // (9, n)
    OctreeShape shape,
    uint meshes,
    uint n)
{
    uint begin = get_global_id(0) * RUN, end = min(begin + RUN, n);
    if (begin >= n) return;
    Placement scene = { positions, triangles, placed, first, meshes };
    float per_size = 1.0f / shape.size;
    for (uint i = begin; i < end; i++) {
        uint mesh = placed_of(&scene, i);
        for (uint k = 0; k < 3; k++) {
            Vec3 p = world_corner(&scene, mesh, i, k);
            corners[(size_t)(3 * k) * n + i] = grid_step(p.x, shape.origin[0], per_size);
            corners[(size_t)(3 * k + 1) * n + i] = grid_step(p.y, shape.origin[1], per_size);
            corners[(size_t)(3 * k + 2) * n + i] = grid_step(p.z, shape.origin[2], per_size);
        }
    }
}

// A triangle's corners on the grid, and its normal, with the axes in the order in which its cells are walked: along u, of the
// rows along v, and w, in which the triangle is flattest.
typedef struct Flat {
    int corner[3][3];
    long normal[3];
    uint axis[3];
} Flat;

inline int extent_of(const int corner[3][3], uint axis)
{
    int a = corner[0][axis], b = corner[1][axis], c = corner[2][axis];
    return max(a, max(b, c)) - min(a, min(b, c));
}

// u x v of the edges e1 and e2.
inline long cross_of(const int corner[3][3], uint u, uint v)
{
    long u1 = corner[1][u] - corner[0][u], v1 = corner[1][v] - corner[0][v];
    long u2 = corner[2][u] - corner[0][u], v2 = corner[2][v] - corner[0][v];
    return u1 * v2 - v1 * u2;
}

inline ulong size_of(long v)
{
    return v < 0 ? -(ulong)v : (ulong)v;
}

inline Flat load_flat(__global const int *corners, uint n, uint i)
{
    int corner[3][3];
    for (uint k = 0; k < 9; k++) corner[k / 3][k % 3] = corners[(size_t)k * n + i];
    long normal[3] = { cross_of(corner, 1, 2), cross_of(corner, 2, 0), cross_of(corner, 0, 1) };
    int extent[3] = { extent_of(corner, 0), extent_of(corner, 1), extent_of(corner, 2) };
    bool has_area = normal[0] != 0 || normal[1] != 0 || normal[2] != 0;
    uint w = 0;
    for (uint k = 1; k < 3; k++)
        if (has_area ? size_of(normal[k]) > size_of(normal[w]) : extent[k] < extent[w]) w = k;
    uint u = w == 0 ? 1 : 0, v = 3 - w - u;
    if (extent[v] > extent[u]) {
        uint other = u;
        u = v;
        v = other;
    }
    Flat flat = { { { 0 } }, { normal[u], normal[v], normal[w] }, { u, v, w } };
    for (uint k = 0; k < 3; k++) {
        flat.corner[k][0] = corner[k][u];
        flat.corner[k][1] = corner[k][v];
        flat.corner[k][2] = corner[k][w];
    }
    return flat;
}

// The cells of a part, and how they lie on the grid.
typedef struct Cells {
    int shift;   // a cell's edge is 2^shift steps
    int margin;  // by which cells are dilated, in steps
    uint part;
    int last;    // cell of the part along an axis
} Cells;

typedef struct Range {
    int first, last;
} Range;

// The first cell of the part along an axis.
inline int part_begin(const Cells *cells, uint axis)
{
    uint place = cells->part >> axis;
    return (int)((place & 1) | (place >> 2 & 2)) * PART_CELLS;
}

// The cells, along an axis of a triangle's, whose dilated boxes the triangle's box meets.
inline Range box_range(const Cells *cells, const Flat *flat, uint k)
{
    int a = flat->corner[0][k], b = flat->corner[1][k], c = flat->corner[2][k], begin = part_begin(cells, flat->axis[k]);
    int low = (min(a, min(b, c)) - cells->margin - 1) >> cells->shift, high = (max(a, max(b, c)) + cells->margin) >> cells->shift;
    Range range = { max(low, begin), min(high, begin + cells->last) };
    return range;
}

// Whether a triangle's box meets the part's cells along an axis of the world.
inline bool meets_part(const Cells *cells, __global const int *corners, uint n, uint i, uint axis)
{
    int a = corners[(size_t)axis * n + i], b = corners[(size_t)(3 + axis) * n + i], c = corners[(size_t)(6 + axis) * n + i];
    int begin = part_begin(cells, axis) << cells->shift, end = begin + ((cells->last + 1) << cells->shift);
    return max(a, max(b, c)) + cells->margin >= begin && min(a, min(b, c)) - cells->margin <= end;
}

// How many strips of rows a triangle has in the part.
inline uint strips_of(const Cells *cells, __global const int *corners, uint n, uint i)
{
    for (uint axis = 0; axis < 3; axis++)
        if (!meets_part(cells, corners, n, i, axis)) return 0;
    Flat flat = load_flat(corners, n, i);
    Range rows = box_range(cells, &flat, 1);
    return (uint)(rows.last - rows.first) / STRIP + 1;
}

// One work-item per run of triangles: how many strips of rows they have in this part.
__kernel void count_strips(
    __global const int *corners,  // (9, n)
    __global uint *counts,        // (runs)
    uint n,
    uint runs,
    uint part,
    int shift,
    int margin,
    int last)
{
    uint run = get_global_id(0), begin = run * RUN, end = min(begin + RUN, n), count = 0;
    if (run >= runs) return;
    Cells cells = { shift, margin, part, last };
    for (uint i = begin; i < end; i++) count += strips_of(&cells, corners, n, i);
    counts[run] = count;
}

// One work-item per run of triangles: list their strips, (triangle, number of the strip), from where the run's begin on.
__kernel void list_strips(
    __global const int *corners,   // (9, n)
    __global const uint *offsets,  // (runs)
    __global uint *strips,         // (listed, 2)
    uint n,
    uint runs,
    uint part,
    int shift,
    int margin,
    int last,
    uint listed)
{
    uint run = get_global_id(0), begin = run * RUN, end = min(begin + RUN, n);
    if (run >= runs) return;
    Cells cells = { shift, margin, part, last };
    uint place = offsets[run];
    if (place == (run + 1 < runs ? offsets[run + 1] : listed)) return;
    for (uint i = begin; i < end; i++) {
        uint has = strips_of(&cells, corners, n, i);
        for (uint strip = 0; strip < has; strip++, place++) {
            strips[2 * (size_t)place] = i;
            strips[2 * (size_t)place + 1] = strip;
        }
    }
}

inline long divide_down(long a, long b)
{
    long q = a / b;
    return q * b > a ? q - 1 : q;
}

inline long centre_of(const Cells *cells, int cell)
{
    return ((long)cell << cells->shift) + (1l << (cells->shift - 1));
}

inline long half_box(const Cells *cells)
{
    return (1l << (cells->shift - 1)) + cells->margin;
}

// The cells of a range for whose centres c low <= slope c <= high.
inline Range clip(const Cells *cells, Range range, long slope, long low, long high)
{
    if (slope == 0) {
        if (low > 0 || high < 0) range.last = range.first - 1;
        return range;
    }
    long least = slope > 0 ? low : -high, most = slope > 0 ? high : -low;
    slope = slope > 0 ? slope : -slope;
    long middle = slope * (1l << (cells->shift - 1)), step = slope << cells->shift;
    long first = -divide_down(middle - least, step), last = divide_down(most - middle, step);
    range.first = (int)max((long)range.first, first);
    range.last = (int)min((long)range.last, last);
    return range;
}

// What an edge, seen along an axis, leaves of the centres of cells: low <= a c_a + b c_b <= high.
typedef struct Slab {
    long a, b, low, high;
} Slab;

inline Slab edge_slab(const Cells *cells, const Flat *flat, uint k, uint a, uint b)
{
    const int *from = flat->corner[k], *to = flat->corner[(k + 1) % 3], *across = flat->corner[(k + 2) % 3];
    long normal_a = (long)from[b] - to[b], normal_b = (long)to[a] - from[a];
    long edge = normal_a * from[a] + normal_b * from[b], corner = normal_a * across[a] + normal_b * across[b];
    long reach = half_box(cells) * (long)(size_of(normal_a) + size_of(normal_b));
    Slab slab = { normal_a, normal_b, min(edge, corner) - reach, max(edge, corner) + reach };
    return slab;
}

// The cells of a range along axis a that three edges leave, with their centres at `at` along axis b.
inline Range clip_edges(const Cells *cells, Range range, const Slab edges[3], long at)
{
    for (uint k = 0; k < 3; k++)
        range = clip(cells, range, edges[k].a, edges[k].low - edges[k].b * at, edges[k].high - edges[k].b * at);
    return range;
}

inline bool is_left(const Slab edges[3], long at_a, long at_b)
{
    bool is = true;
    for (uint k = 0; k < 3; k++) {
        long across = edges[k].a * at_a + edges[k].b * at_b;
        is = is & (across >= edges[k].low) & (across <= edges[k].high);
    }
    return is;
}

// The cells of a column that the triangle's plane meets.
inline Range clip_plane(const Cells *cells, const Flat *flat, Range range, long u, long v)
{
    const long *n = flat->normal;
    const int *p = flat->corner[0];
    long reach = half_box(cells) * (long)(size_of(n[0]) + size_of(n[1]) + size_of(n[2]));
    long plane = n[0] * (p[0] - u) + n[1] * (p[1] - v) + n[2] * p[2];
    return clip(cells, range, n[2], plane - reach, plane + reach);
}

// A word of bits in the making: cells in a row are mostly in the same.
typedef struct Marks {
    __global volatile uint *bits;     // (words)
    __global volatile uint *touched;  // (segments)
    uint word, mask;
} Marks;

inline void flush_marks(Marks *marks)
{
    if (marks->mask == 0) return;
    atomic_or(marks->bits + marks->word, marks->mask);
    __global volatile uint *touched = marks->touched + (marks->word >> SEGMENT_BITS);
    if (*touched == 0) atomic_or(touched, 1);
    marks->mask = 0;
}

inline void mark(Marks *marks, uint key)
{
    uint word = key >> 5;
    if (word != marks->word) flush_marks(marks);
    marks->word = word;
    marks->mask |= 1u << (key & 31);
}

// The bits of a cell's key, within its part, that are of one axis of a triangle's.
inline uint key_bits(const Flat *flat, uint k, int cell)
{
    return spread_bits((uint)cell & (PART_CELLS - 1)) << flat->axis[k];
}

// Mark what the triangle overlaps of some rows.
inline void mark_rows(Marks *marks, const Cells *cells, const Flat *flat, int first, int last)
{
    Range along = box_range(cells, flat, 0), across = box_range(cells, flat, 2);
    Slab uv[3], wv[3], wu[3];
    for (uint k = 0; k < 3; k++) {
        uv[k] = edge_slab(cells, flat, k, 0, 1);
        wv[k] = edge_slab(cells, flat, k, 2, 1);
        wu[k] = edge_slab(cells, flat, k, 2, 0);
    }
    for (int v = first; v <= last; v++) {
        long at_v = centre_of(cells, v);
        Range row = clip_edges(cells, along, uv, at_v), columns = clip_edges(cells, across, wv, at_v);
        uint key_v = key_bits(flat, 1, v);
        for (int u = row.first; u <= row.last; u++) {
            long at_u = centre_of(cells, u);
            Range column = clip_plane(cells, flat, columns, at_u, at_v);
            if (column.last - column.first >= LONG) column = clip_edges(cells, column, wu, at_u);
            uint key_uv = key_v | key_bits(flat, 0, u);
            for (int w = column.first; w <= column.last; w++)
                if (is_left(wu, centre_of(cells, w), at_u)) mark(marks, key_uv | key_bits(flat, 2, w));
        }
    }
}

// One work-item per run of strips: set the bits of the cells that their triangles overlap.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void mark_cells(
    __global const int *corners,        // (9, n)
    __global const uint *strips,        // (listed, 2)
    __global volatile uint *bits,       // (words)
    __global volatile uint *touched,    // (segments)
    uint n,
    uint part,
    int shift,
    int margin,
    int last,
    uint listed)
{
    uint begin = get_global_id(0) * STRIPS, end = min(begin + STRIPS, listed);
    if (begin >= listed) return;
    Cells cells = { shift, margin, part, last };
    Marks marks = { bits, touched, 0, 0 };
    for (uint i = begin; i < end; i++) {
        Flat flat = load_flat(corners, n, strips[2 * (size_t)i]);
        Range rows = box_range(&cells, &flat, 1);
        int row = rows.first + STRIP * (int)strips[2 * (size_t)i + 1];
        mark_rows(&marks, &cells, &flat, row, min(row + STRIP - 1, rows.last));
    }
    flush_marks(&marks);
}
