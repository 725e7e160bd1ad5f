// Cells answer (HashCache, section 3.3). Jitter may lead to where nothing is known: then the vertex's own cell is asked. A cell
// that has too few samples sends on to the one around it, but not far. What finds none is listed, and traced by paths of its
// own (misses.cl).
//
// Defines: COUNT_LOOKUPS, COUNT_HITS, COUNT_TRACED (places in `counters`), HAS_TEXTURES.

#include "common/random.cl"
#include "octree/ask.cl"
#include "octree/cell.cl"
#include "octree/expect.cl"
#include "pathtrace/queue.cl"

#define RUN 64u     // places, or pixels, that one work-item goes through
#define COARSER 3u  // levels up, at most

typedef struct Answer {
    Side side;
    uint cell, level;
} Answer;

// A vertex's question, in words that loops over a run can keep.
typedef struct Question {
    ulong jittered, exact;  // keys at the finest level
    uint asked, finest;
} Question;

inline uint level_asked(const Question *q)
{
    return q->asked & 0xFF;
}

inline ulong key_at(ulong key, const Question *q, uint level)
{
    return key >> 3 * (q->finest - level);
}

// What the cell where jitter has led says, which is known already; where that knows nothing, the vertex's own on that level.
inline Answer ask_level(const CellTables *tables, __global const uint *cells, const Question *q, uint jittered, uint level,
                        Vec3 normal, uint wipe)
{
    Answer answer = { cell_side(cells, jittered, normal, wipe), jittered, level };
    if (answer.side.count == 0) {
        answer.cell = find_cell(tables, key_at(q->exact, q, level), level);
        answer.side = cell_side(cells, answer.cell, normal, wipe);
    }
    return answer;
}

// first: the cell where jitter has led, on the level that is asked. least: samples. The finest cell that has so many; where
// none has, the coarsest that has any.
inline Answer ask_cells(const CellTables *tables, __global const uint *cells, const Question *q, uint first, Vec3 normal,
                        uint least, uint wipe)
{
    uint level = level_asked(q), coarsest = max(q->asked >> 8, level > COARSER ? level - COARSER : 0u);
    Answer answer = ask_level(tables, cells, q, first, level, normal, wipe), found = answer;
    while (found.side.count < least && level > coarsest) {
        level--;
        found = ask_level(tables, cells, q, find_cell(tables, key_at(q->jittered, q, level), level), level, normal, wipe);
        if (found.side.count > 0) answer = found;
    }
    return answer;
}

// One work-item per run of places in the queue.
__kernel __attribute__((reqd_work_group_size(1, 1, 1))) void look_up(
    __global const ulong *octree_table,       // (entries)
    __global const uint *octree_tables,       // (tables, 4)
    __global const uint *octree_cells,        // (cells, 6)
    __global const uint *octree_wipe,         // (4)
    __global const uint *alive,               // (chunks)
    __global const uint *path,                // (n)
    __global const uint *pixel,               // (n)
    __global const ulong *asked_key,          // (2, n)
    __global const uint *asked_level,         // (n)
    __global const uint *asked_normal,        // (n)
    __global const float *asked_direction,    // (3, n)
    __global const float *asked_cone,         // (2, n) or null
    __global const float *hit_t,              // (n)
    __global const float *hit_uv,             // (2, n)
    __global const uint *hit_primitive,       // (n)
    __global const uint *hit_instance,        // (n)
    __global float *layer_light,              // (3, pixels)
    __global float *layer_count,              // (pixels)
    __global uint *answer_cell,               // (pixels)
    __global uint *answer_level,              // (pixels)
    __global float *miss_uv,                  // (2, capacity)
    __global uint *miss_primitive,            // (capacity)
    __global uint *miss_instance,             // (capacity)
    __global float *miss_t,                   // (capacity)
    __global float *miss_direction,           // (3, capacity)
    __global float *miss_cone,                // (2, capacity) or null
    __global uint *miss_target,               // (capacity)
    __global volatile uint *misses,           // (1)
    __global volatile uint *counters,         // (counters)
    OctreeShape shape,
    uint n,
    uint pixels,
    uint layer,
    uint least,
    uint capacity)
{
    uint begin = get_global_id(0) * RUN;
    if (begin >= n || begin % CHUNK >= alive[begin / CHUNK]) return;
    uint end = min(begin + RUN, begin / CHUNK * CHUNK + alive[begin / CHUNK]);
    CellTables tables = { octree_table, octree_tables };
    uint wipe = octree_wipe[WIPE_STAMP], lookups = 0, missing = 0;
    uint missed[RUN], first[RUN];
    for (uint i = begin; i < end; i++) {
        Question q = { asked_key[i], asked_key[n + i], asked_level[i], shape.finest };
        if (q.asked < NO_LEVEL) expect_cell(&tables, key_at(q.jittered, &q, level_asked(&q)), level_asked(&q));
    }
    for (uint i = begin; i < end; i++) {
        Question q = { asked_key[i], asked_key[n + i], asked_level[i], shape.finest };
        uint cell = q.asked < NO_LEVEL ? find_cell(&tables, key_at(q.jittered, &q, level_asked(&q)), level_asked(&q)) : NONE;
        first[i - begin] = cell;
        if (cell != NONE) expect(octree_cells + words_of_cell(cell));
    }
    for (uint i = begin; i < end; i++) {
        Question q = { asked_key[i], asked_key[n + i], asked_level[i], shape.finest };
        if (q.asked == NONE) continue;
        lookups++;
        Answer answer;
        answer.side.count = 0;
        uint place = pixel[path[i]];
        if (q.asked != NO_LEVEL)
            answer = ask_cells(&tables, octree_cells, &q, first[i - begin], unpack_normal(asked_normal[i]), least, wipe);
        if (answer.side.count > 0) {
            store_planes(layer_light, pixels, place, answer.side.light);
            layer_count[place] = (float)(int)answer.side.count;
        } else {
            missed[missing++] = i;
        }
        answer_cell[place] = answer.side.count > 0 ? answer.cell : NONE;
        answer_level[place] = answer.side.count > 0 ? answer.level : NONE;
    }
    if (lookups > 0) atomic_add(counters + COUNT_LOOKUPS, lookups);
    if (lookups > missing) atomic_add(counters + COUNT_HITS, lookups - missing);
    if (missing == 0) return;
    atomic_add(counters + COUNT_TRACED, missing);
    uint place = atomic_add(misses, missing);
    for (uint k = 0; k < missing; k++) {
        uint i = missed[k], at = place + k;
        miss_uv[at] = hit_uv[i];
        miss_uv[capacity + at] = hit_uv[n + i];
        miss_primitive[at] = hit_primitive[i];
        miss_instance[at] = hit_instance[i];
        miss_t[at] = hit_t[i];
        store_planes(miss_direction, capacity, at, load_vec3(asked_direction, n, i));
#if HAS_TEXTURES
        miss_cone[at] = asked_cone[i];
        miss_cone[capacity + at] = asked_cone[n + i];
#endif
        miss_target[at] = layer * pixels + pixel[path[i]];
    }
}

// The cells that answered, for AOVs. One work-item per pixel.
__kernel void describe_cells(
    __global const float *layer_depth,  // (pixels)
    __global const float *layer_count,  // (pixels)
    __global const uint *answer_cell,   // (pixels)
    __global const uint *answer_level,  // (pixels)
    __global float *aov_voxel,          // (pixels, 3)
    __global float *aov_level,          // (pixels)
    __global float *aov_count,          // (pixels)
    uint pixels)
{
    uint i = get_global_id(0);
    if (i >= pixels) return;
    bool is_there = layer_depth[i] > 0.0f && layer_depth[i] < INFINITY && layer_count[i] > 0.0f && answer_level[i] != NONE;
    uint level = is_there ? answer_level[i] : 0;
    Words hue = pcg4d(answer_cell[i], 1, 2, 3);
    store_row(aov_voxel, i, either3(is_there, vec3(to_unit(hue.x), to_unit(hue.y), to_unit(hue.z)), all3(0.0f)));
    aov_level[i] = is_there ? (float)(int)level : INFINITY;
    aov_count[i] = is_there ? layer_count[i] : 0.0f;
}
