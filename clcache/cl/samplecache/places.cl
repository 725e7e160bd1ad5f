// Where the entries of a batch go among the places of the queue: the list's chunks by turns to its first and its second half, so
// that either half, which is what drivers give to two threads, has as much to do, however short the list.

#include "pathtrace/queue.cl"

// n: places. What is left behind the last whole chunk stays there.
inline uint place_of_entry(uint entry, uint n)
{
    uint chunk = entry / CHUNK, chunks = n / CHUNK;
    uint turned = (chunk & 1) ? (chunks + 1) / 2 + chunk / 2 : chunk / 2;
    return chunk < chunks ? turned * CHUNK + entry % CHUNK : entry;
}

inline uint entry_of_place(uint place, uint n)
{
    uint chunk = place / CHUNK, chunks = n / CHUNK, evens = (chunks + 1) / 2;
    uint turned = chunk < evens ? 2 * chunk : 2 * (chunk - evens) + 1;
    return chunk < chunks ? turned * CHUNK + place % CHUNK : place;
}
