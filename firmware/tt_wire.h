/* Bytes of the wire protocol: numbers, checksum and framing (docs/protocol.md, section 1). */
#ifndef TT_WIRE_H
#define TT_WIRE_H

#include <stddef.h>
#include <stdint.h>

/* Longest form on the line of a packet of `length` bytes, with the delimiter. */
#define TT_WIRE_SIZE(length) ((length) + (length) / 254u + 2u)

/* Write a number at `packet + at`, little endian; returns the place behind it. */
size_t tt_put_u8(uint8_t *packet, size_t at, uint8_t value);
size_t tt_put_u16(uint8_t *packet, size_t at, uint16_t value);
size_t tt_put_u32(uint8_t *packet, size_t at, uint32_t value);
size_t tt_put_u64(uint8_t *packet, size_t at, uint64_t value);
size_t tt_put_f32(uint8_t *packet, size_t at, float value);
size_t tt_put_string(uint8_t *packet, size_t at, const char *text);

uint16_t tt_get_u16(const uint8_t *data);
uint32_t tt_get_u32(const uint8_t *data);
float tt_get_f32(const uint8_t *data);

/* CRC-32 of Ethernet, zip and PNG. */
uint32_t tt_crc32(const uint8_t *data, size_t length);

/* `out` needs TT_WIRE_SIZE(length) bytes; returns how many were written, with the delimiter. */
size_t tt_cobs_encode(const uint8_t *data, size_t length, uint8_t *out);

/* In place, `data` without the delimiter; returns the decoded length, 0 if damaged. */
size_t tt_cobs_decode(uint8_t *data, size_t length);

#endif
