"""clcache: cached, temporally stable, stereo ray tracing on OpenCL."""
