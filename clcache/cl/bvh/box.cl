// Axis-aligned boxes, as rows of 6 numbers (low x, y, z, high x, y, z) or as 6 planes.

#include "common/math.cl"

typedef struct Box {
    float3 low, high;
} Box;

inline Box load_box(__global const float *boxes, uint i)
{
    Box box = { load_row(boxes, 2 * i), load_row(boxes, 2 * i + 1) };
    return box;
}

inline void store_box(__global float *boxes, uint i, Box box)
{
    __global float *row = boxes + 6 * (size_t)i;
    row[0] = box.low.x, row[1] = box.low.y, row[2] = box.low.z;
    row[3] = box.high.x, row[4] = box.high.y, row[5] = box.high.z;
}

inline Box load_box_planes(__global const float *planes, uint n, uint i)
{
    Box box = { load_planes(planes, n, i), load_planes(planes + 3 * (size_t)n, n, i) };
    return box;
}

inline void store_box_planes(__global float *planes, uint n, uint i, Box box)
{
    store_planes(planes, n, i, box.low);
    store_planes(planes + 3 * (size_t)n, n, i, box.high);
}

inline Box join(Box a, Box b)
{
    Box box = { a.low < b.low ? a.low : b.low, a.high > b.high ? a.high : b.high };
    return box;
}

// Half the surface of a box. Infinite where float32 has no number for it.
inline float half_area(Box box)
{
    float3 size = box.high - box.low;
    float area = size.x * size.y + size.y * size.z + size.z * size.x;
    return area < INFINITY ? area : INFINITY;
}
