// An image that one kernel both writes and reads: every work-item's own texels. One work-item per texel of a row.

#pragma OPENCL EXTENSION cl_khr_3d_image_writes : enable

__kernel void probe(
    read_only image2d_t read2d,      // (2, n, 4)
    write_only image2d_t written2d,  // (2, n, 4)
    read_only image3d_t read3d,      // (2, 2, n, 4)
    write_only image3d_t written3d,  // (2, 2, n, 4)
    __global float4 *found,          // (2, n)
    uint n)
{
    uint i = get_global_id(0);
    float4 texel = (float4)(i, 1.0f, 2.0f, 3.0f);
    write_imagef(written2d, (int2)(i, 1), texel);
    write_imagef(written3d, (int4)(i, 1, 1, 0), -texel);
    mem_fence(CLK_GLOBAL_MEM_FENCE);
    found[i] = read_imagef(read2d, (int2)(i, 1));
    found[n + i] = read_imagef(read3d, (int4)(i, 1, 1, 0));
}
