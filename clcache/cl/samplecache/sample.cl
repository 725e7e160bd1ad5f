// What passes tell each other. A sample's number is slot * pixels + pixel; in lists, its highest bit is a mark.

#define NEW_SAMPLE 0x80000000u  // of a list of what is traced

// What is planned for a pixel: bits.
#define IS_EDGE 1u
#define ADD 2u
#define PURGE 4u
