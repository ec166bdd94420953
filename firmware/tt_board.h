/* What the library asks of a board. None of these functions may wait for the host.
 *
 * "Interrupt" is the timer interrupt that calls `tt_scan_tick`.
 */
#ifndef TT_BOARD_H
#define TT_BOARD_H

#include <stdint.h>

/* Keeps the compiler from moving memory accesses; enough where interrupts run on the same core. */
#if defined(__GNUC__)
#define TT_BARRIER() __asm__ volatile("" ::: "memory")
#else
#error "define TT_BARRIER for this compiler"
#endif

/* Device time in µs since power-up. Never stops, jumps or wraps. Interrupt and main loop. */
uint64_t tt_board_time(void);

/* Keep the interrupt out for some instructions, and let it in again. Main loop. */
void tt_board_lock(void);
void tt_board_unlock(void);

/* Ground this electrode and no other, or none (TT_GROUND_NONE). Interrupt and main loop. */
#define TT_GROUND_NONE 0xFFFFu
void tt_board_ground(uint16_t electrode);

/* Connect this electrode to the converter. It has one tick at least to settle. Interrupt. */
void tt_board_select(uint16_t electrode);

/* Convert now and return the counts, TT_NONE where the converter fails; takes some µs at most. The
 * largest counts that are sent are 0xFFFE. Interrupt. */
#define TT_NONE 0xFFFFFFFFu
uint32_t tt_board_convert(void);

/* Temperature of the sheet in °C, NaN where it is not measured. Main loop. */
float tt_board_temperature(void);

/* Bytes have come into the queue of what is to be sent: wake whatever sends. Main loop. */
void tt_board_send(void);

#endif
