// Whose turn it is where a frame's lookups are made in several passes (MaterialMemo, section 6.7.2): neighbouring rectangles of pixels come
// in different ones, so that work-items that run at once do not build the same. In two passes those of one touch at corners only,
// in four not at all. Rectangles are so many places of the queue, which stand in the image as common/pixel_order.cl has them; so it is of
// first hits. Of others, whose places have no order, the passes are some part or other.

#define BLOCK_PLACES 16u  // of 4 x 4 pixels
#define BAND_BLOCKS 8u    // one upon the other

inline bool has_turn(uint place, uint size, uint turn, uint turns)
{
    uint rectangle = place / size, in_column = BAND_BLOCKS * BLOCK_PLACES / size;
    uint row = rectangle % in_column, column = rectangle / in_column;
    uint own = turns == 4 ? (row & 1u) + 2u * (column & 1u) : (row + column) & 1u;
    return turns == 1 || own == turn;
}
