"""The passes of which methods are made: one small class for each, beside the OpenCL file that it runs."""
