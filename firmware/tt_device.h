/* A device of the wire protocol, versions 1 and 2: commands in, answers and rows out.
 *
 * The board's interrupts put received bytes into `received` and take bytes out of `sending`;
 * `tt_device_poll` in the main loop does everything between. Memory is this struct, whole.
 */
#ifndef TT_DEVICE_H
#define TT_DEVICE_H

#include <stdbool.h>
#include <stdint.h>

#include "tt_config.h"
#include "tt_messages.h"
#include "tt_queue.h"
#include "tt_scan.h"
#include "tt_wire.h"

/* What a board is. Strings have at most TT_MAX_STRING bytes of printable UTF-8. */
#define TT_MAX_STRING 32u
struct tt_facts {
    uint16_t electrodes;                 /* 1 to TT_MAX_ELECTRODES */
    uint16_t settle_ground, settle_read; /* ticks, 1 or more */
    float tick;                          /* s, of the timer that calls tt_scan_tick */
    uint8_t bits;
    uint16_t zero;       /* counts that mean 0 V */
    float scale;         /* V per count */
    float drive_voltage; /* V */
    float rate;          /* frames/s at power-up */
    uint32_t line_rate;  /* bit/s; 0: no UART on the way */
    uint8_t address;     /* 0: alone on its line */
    uint32_t boot;       /* another one after every power-up and reset */
    const char *name, *firmware, *serial;
};

/* Eight rows more than an order may have: one that is a little too long is refused, and not lost. */
#define TT_LONGEST_COMMAND (TT_V2_SET_SCAN_SIZE + 2u * (TT_MAX_ROWS + 8u) + TT_CRC_SIZE)
#define TT_LONGEST_ROW (TT_V2_ROW_SIZE + 2u * TT_MAX_ELECTRODES + TT_CRC_SIZE)
#define TT_LONGEST_ANSWER (TT_V2_IDENTITY_SIZE + 3u * (1u + TT_MAX_STRING) + 3u + TT_CRC_SIZE)
#define TT_LONGEST_PACKET \
    (TT_LONGEST_ROW > TT_LONGEST_ANSWER ? TT_LONGEST_ROW : TT_LONGEST_ANSWER)

struct tt_device {
    const struct tt_facts *facts;
    struct tt_scan scan;
    struct tt_queue received, sending;
    float fastest_row_rate; /* rows/s */
    uint8_t stream_version; /* of the START that began the stream */
    uint32_t timeout;       /* µs, 0: none */
    uint64_t heard;         /* µs, last valid packet for this device */
    uint32_t dropped;       /* rows for which the line had no room */
    bool dropping;          /* the rest of the frame `dropping_sequence` */
    uint32_t dropping_sequence;
    bool obeying; /* a command waits for the end of a row */
    uint16_t line_length, command_length;
    uint8_t line[TT_WIRE_SIZE(TT_LONGEST_COMMAND)];
    uint8_t packet[TT_LONGEST_PACKET];
    uint8_t wire[TT_WIRE_SIZE(TT_LONGEST_PACKET)];
    uint8_t received_bytes[TT_RECEIVE_BYTES];
    uint8_t sending_bytes[TT_SEND_BYTES];
};

/* Before interrupts are let in. `facts` must stay. */
void tt_device_init(struct tt_device *device, const struct tt_facts *facts);

/* Main loop, often: obey what has come, send what is finished. Returns whether it did anything. */
bool tt_device_poll(struct tt_device *device);

/* Main loop: a fault that no command caused; `message` is for people. */
void tt_device_fault(struct tt_device *device, const char *message);

#endif
