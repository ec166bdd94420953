/* Bytes between an interrupt and the main loop: one puts in, the other takes out, neither waits.
 *
 * For one core. Indices are read and written at once (16 bits), so that no lock is needed; on a
 * machine of 8 bits `tt_board_lock` must guard every call outside an interrupt.
 */
#ifndef TT_QUEUE_H
#define TT_QUEUE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct tt_queue {
    uint8_t *bytes;
    uint16_t size; /* a power of two */
    volatile uint16_t in, out; /* count on and wrap around by themselves */
};

/* Bytes that wait, and that still fit. */
uint16_t tt_queue_length(const struct tt_queue *queue);
uint16_t tt_queue_room(const struct tt_queue *queue);

/* Put in all of `data` or nothing; false where it does not fit. */
bool tt_queue_put(struct tt_queue *queue, const uint8_t *data, size_t length);

/* Take one byte; false where there is none. */
bool tt_queue_get(struct tt_queue *queue, uint8_t *byte);

/* The waiting bytes that lie in one piece, for DMA; `tt_queue_drop` takes them out afterwards. */
uint16_t tt_queue_piece(const struct tt_queue *queue, const uint8_t **data);
void tt_queue_drop(struct tt_queue *queue, uint16_t length);

#endif
