/* See tt_queue.h. */
#include "tt_queue.h"

#include "tt_board.h"

uint16_t tt_queue_length(const struct tt_queue *queue)
{
    return (uint16_t)(queue->in - queue->out);
}

uint16_t tt_queue_room(const struct tt_queue *queue)
{
    return (uint16_t)(queue->size - tt_queue_length(queue));
}

bool tt_queue_put(struct tt_queue *queue, const uint8_t *data, size_t length)
{
    uint16_t at = queue->in, mask = (uint16_t)(queue->size - 1u);
    if (length > tt_queue_room(queue))
        return false;
    while (length--) {
        queue->bytes[at & mask] = *data++;
        at++;
    }
    TT_BARRIER(); /* the bytes are there before they are announced */
    queue->in = at;
    return true;
}

bool tt_queue_get(struct tt_queue *queue, uint8_t *byte)
{
    const uint8_t *data;
    if (tt_queue_piece(queue, &data) == 0)
        return false;
    *byte = *data;
    tt_queue_drop(queue, 1);
    return true;
}

uint16_t tt_queue_piece(const struct tt_queue *queue, const uint8_t **data)
{
    uint16_t length = tt_queue_length(queue);
    uint16_t at = (uint16_t)(queue->out & (queue->size - 1u));
    uint16_t to_end = (uint16_t)(queue->size - at);
    *data = queue->bytes + at;
    TT_BARRIER();
    return length < to_end ? length : to_end;
}

void tt_queue_drop(struct tt_queue *queue, uint16_t length)
{
    TT_BARRIER(); /* the bytes have been read before their place is given away */
    queue->out = (uint16_t)(queue->out + length);
}
