/* The circuit before the converter that both boards for a laboratory have: 64 electrodes, 3.3 V.
 *
 * Addresses of 6 bits: the lower four select a channel of four 16-channel multiplexers (such as
 * 74HC4067), the upper two, through a decoder, one of the four; one such set reads and one grounds.
 * The address that is read begins at a port's pin 0, the one that is grounded at GROUND_SHIFT;
 * while GROUND_OFF is high none is.
 */
#ifndef MULTIPLEXERS_H
#define MULTIPLEXERS_H

#include "tt_config.h"

#ifndef ELECTRODES
#define ELECTRODES 64u
#endif
#ifndef TICK_US
#define TICK_US 14u /* settling of one reading, with its conversion of 2 µs */
#endif

#define ADDRESS 0x3Fu
#define GROUND_SHIFT 6u
#define GROUND_OFF (1u << 12)

#ifndef SERIAL_NUMBER
#define SERIAL_NUMBER "0"
#endif

typedef char all_electrodes_have_memory[ELECTRODES <= TT_MAX_ELECTRODES ? 1 : -1];

/* What is the same in the `struct tt_facts` of each such board. */
#define MULTIPLEXER_FACTS                                                     \
    .electrodes = ELECTRODES, .settle_ground = 3, .settle_read = 1,           \
    .tick = 1e-6f * TICK_US, .bits = 12, .zero = 0, .scale = 3.3f / 4096.0f,  \
    .drive_voltage = 3.3f, .rate = 10.0f, .firmware = "2.0.0", .serial = SERIAL_NUMBER

#endif
