// What stands in memo_place besides places.

#define ASKS_NOTHING 0xFFFFFFFFu  // there is no graph
#define IS_EVALUATED 0xFFFFFFFEu  // the graph is evaluated right there
