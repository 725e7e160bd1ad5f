/* Embree's triangles and rays behind three functions, for rays_beside_embree.py, which compiles this file and calls it with
   ctypes. The library is the one inside the wheel of embreex; the wheel has no headers, so that what is needed of Embree 4's
   interface is declared here.

   Rays and hits are planes, one for each component; Embree takes them in packets of `width` rays in the same form: planes of
   `width` numbers, 4 bytes each. A packet of one is a single ray. */

#include <immintrin.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <time.h>

typedef struct RTCDeviceTy *RTCDevice;
typedef struct RTCSceneTy *RTCScene;
typedef struct RTCGeometryTy *RTCGeometry;

enum { GEOMETRY_TRIANGLE = 0, BUFFER_INDEX = 0, BUFFER_VERTEX = 1, FORMAT_UINT3 = 0x5003, FORMAT_FLOAT3 = 0x9003 };
enum { QUERY_COHERENT = 1 << 16 };

/* RTCIntersectArguments and RTCOccludedArguments, which begin alike; the rest stays zero. */
typedef struct {
    uint32_t flags, features;
    void *context, *filter, *function;
    float minimum_width_distance;
    char reserved[64];
} Arguments;

RTCDevice rtcNewDevice(const char *config);
void rtcReleaseDevice(RTCDevice device);
int rtcGetDeviceError(RTCDevice device);
RTCScene rtcNewScene(RTCDevice device);
void rtcReleaseScene(RTCScene scene);
void rtcSetSceneBuildQuality(RTCScene scene, int quality);
void rtcCommitScene(RTCScene scene);
RTCGeometry rtcNewGeometry(RTCDevice device, int type);
void *rtcSetNewGeometryBuffer(RTCGeometry geometry, int type, unsigned slot, int format, size_t stride, size_t count);
void rtcCommitGeometry(RTCGeometry geometry);
unsigned rtcAttachGeometry(RTCScene scene, RTCGeometry geometry);
void rtcReleaseGeometry(RTCGeometry geometry);
void rtcIntersect1(RTCScene scene, void *packet, Arguments *arguments);
void rtcIntersect4(const int *valid, RTCScene scene, void *packet, Arguments *arguments);
void rtcIntersect8(const int *valid, RTCScene scene, void *packet, Arguments *arguments);
void rtcIntersect16(const int *valid, RTCScene scene, void *packet, Arguments *arguments);
void rtcOccluded1(RTCScene scene, void *packet, Arguments *arguments);
void rtcOccluded4(const int *valid, RTCScene scene, void *packet, Arguments *arguments);
void rtcOccluded8(const int *valid, RTCScene scene, void *packet, Arguments *arguments);
void rtcOccluded16(const int *valid, RTCScene scene, void *packet, Arguments *arguments);

/* The planes of RTCRayHit, in order. */
enum { ORIGIN, NEAR = 3, DIRECTION, TIME = 7, FAR, MASK, ID, FLAGS, NORMAL, U = 15, V, PRIMITIVE, GEOMETRY, INSTANCE, INSTANCE_PRIMITIVE, PLANES };

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* A device for one thread; config as for rtcNewDevice. */
RTCDevice open_device(const char *config)
{
    return rtcNewDevice(config);
}

void close_device(RTCDevice device)
{
    rtcReleaseDevice(device);
}

void close_scene(RTCScene scene)
{
    rtcReleaseScene(scene);
}

/* Build a tree. positions: n x 3; triangles: m x 3. quality: 0 low, 1 medium (the default), 2 high. seconds: how long the
   build took, without copying the mesh. Null where Embree reports an error. */
RTCScene build(RTCDevice device, const float *positions, size_t n, const uint32_t *triangles, size_t m, int quality, double *seconds)
{
    RTCScene scene = rtcNewScene(device);
    rtcSetSceneBuildQuality(scene, quality);
    RTCGeometry geometry = rtcNewGeometry(device, GEOMETRY_TRIANGLE);
    memcpy(rtcSetNewGeometryBuffer(geometry, BUFFER_VERTEX, 0, FORMAT_FLOAT3, 12, n), positions, 12 * n);
    memcpy(rtcSetNewGeometryBuffer(geometry, BUFFER_INDEX, 0, FORMAT_UINT3, 12, m), triangles, 12 * m);
    double start = now();
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene, geometry);
    rtcCommitScene(scene);
    *seconds = now() - start;
    rtcReleaseGeometry(geometry);
    return rtcGetDeviceError(device) ? NULL : scene;
}

typedef struct {
    const float *origins, *directions, *lengths; /* planes of n rays */
    size_t n;
    float *t;            /* n; an occluded ray has -inf, one that hits nothing its length */
    uint32_t *primitive; /* n; of hits */
} Rays;

static inline __attribute__((always_inline)) void trace_packets(RTCScene scene, const Rays *rays, Arguments *arguments, int any_hit, size_t width)
{
    union { float f; uint32_t u; } packet[PLANES * 16] __attribute__((aligned(64)));
    int valid[16] __attribute__((aligned(64)));
    for (size_t first = 0; first < rays->n; first += width) {
        for (size_t lane = 0; lane < width; lane++) {
            size_t ray = first + lane < rays->n ? first + lane : rays->n - 1;
            valid[lane] = first + lane < rays->n ? -1 : 0;
            for (size_t axis = 0; axis < 3; axis++) {
                packet[(ORIGIN + axis) * width + lane].f = rays->origins[axis * rays->n + ray];
                packet[(DIRECTION + axis) * width + lane].f = rays->directions[axis * rays->n + ray];
            }
            packet[NEAR * width + lane].f = 0.0f;
            packet[TIME * width + lane].f = 0.0f;
            packet[FAR * width + lane].f = rays->lengths[ray];
            packet[MASK * width + lane].u = UINT32_MAX;
            packet[ID * width + lane].u = packet[FLAGS * width + lane].u = 0;
            for (size_t plane = PRIMITIVE; plane < PLANES; plane++) packet[plane * width + lane].u = UINT32_MAX;
        }
        if (any_hit) {
            if (width == 1) rtcOccluded1(scene, packet, arguments);
            if (width == 4) rtcOccluded4(valid, scene, packet, arguments);
            if (width == 8) rtcOccluded8(valid, scene, packet, arguments);
            if (width == 16) rtcOccluded16(valid, scene, packet, arguments);
        } else {
            if (width == 1) rtcIntersect1(scene, packet, arguments);
            if (width == 4) rtcIntersect4(valid, scene, packet, arguments);
            if (width == 8) rtcIntersect8(valid, scene, packet, arguments);
            if (width == 16) rtcIntersect16(valid, scene, packet, arguments);
        }
        for (size_t lane = 0; lane < width && first + lane < rays->n; lane++) {
            rays->t[first + lane] = packet[FAR * width + lane].f;
            if (!any_hit) rays->primitive[first + lane] = packet[PRIMITIVE * width + lane].u;
        }
    }
}

/* Trace all rays in the calling thread; returns seconds. width: 1, 4, 8 or 16. */
double trace(RTCScene scene, const float *origins, const float *directions, const float *lengths, size_t n, int any_hit, int width, int coherent,
             float *t, uint32_t *primitive)
{
    Rays rays = { origins, directions, lengths, n, t, primitive };
    Arguments arguments = { .flags = coherent ? QUERY_COHERENT : 0, .features = UINT32_MAX };
    unsigned mode = _mm_getcsr();
    _mm_setcsr(mode | 0x8040); /* denormal numbers count as 0, as Embree advises */
    double start = now();
    if (width == 1) trace_packets(scene, &rays, &arguments, any_hit, 1);
    if (width == 4) trace_packets(scene, &rays, &arguments, any_hit, 4);
    if (width == 8) trace_packets(scene, &rays, &arguments, any_hit, 8);
    if (width == 16) trace_packets(scene, &rays, &arguments, any_hit, 16);
    double seconds = now() - start;
    _mm_setcsr(mode);
    return seconds;
}
