/* See tt_wire.h. Nothing here shifts an `int`: it may have 16 bits. */
#include "tt_wire.h"

#include <string.h>

/* f32 on the line is IEEE 754 binary32, as is `float` on every machine this is for. */
typedef char tt_float_has_32_bits[sizeof(float) == 4 ? 1 : -1];

size_t tt_put_u8(uint8_t *packet, size_t at, uint8_t value)
{
    packet[at] = value;
    return at + 1;
}

size_t tt_put_u16(uint8_t *packet, size_t at, uint16_t value)
{
    packet[at] = (uint8_t)(value & 0xFFu);
    packet[at + 1] = (uint8_t)(value >> 8);
    return at + 2;
}

size_t tt_put_u32(uint8_t *packet, size_t at, uint32_t value)
{
    at = tt_put_u16(packet, at, (uint16_t)(value & 0xFFFFu));
    return tt_put_u16(packet, at, (uint16_t)(value >> 16));
}

size_t tt_put_u64(uint8_t *packet, size_t at, uint64_t value)
{
    at = tt_put_u32(packet, at, (uint32_t)(value & 0xFFFFFFFFu));
    return tt_put_u32(packet, at, (uint32_t)(value >> 32));
}

size_t tt_put_f32(uint8_t *packet, size_t at, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return tt_put_u32(packet, at, bits);
}

size_t tt_put_string(uint8_t *packet, size_t at, const char *text)
{
    size_t length = strlen(text);
    if (length > 255)
        length = 255;
    packet[at++] = (uint8_t)length;
    memcpy(packet + at, text, length);
    return at + length;
}

uint16_t tt_get_u16(const uint8_t *data)
{
    return (uint16_t)(data[0] | ((uint16_t)data[1] * 256u));
}

uint32_t tt_get_u32(const uint8_t *data)
{
    return tt_get_u16(data) | ((uint32_t)tt_get_u16(data + 2) << 16);
}

float tt_get_f32(const uint8_t *data)
{
    uint32_t bits = tt_get_u32(data);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* Four bits at a time: a table of 64 bytes instead of 1024. */
uint32_t tt_crc32(const uint8_t *data, size_t length)
{
    static const uint32_t table[16] = {
        0x00000000u, 0x1DB71064u, 0x3B6E20C8u, 0x26D930ACu, 0x76DC4190u, 0x6B6B51F4u,
        0x4DB26158u, 0x5005713Cu, 0xEDB88320u, 0xF00F9344u, 0xD6D6A3E8u, 0xCB61B38Cu,
        0x9B64C2B0u, 0x86D3D2D4u, 0xA00AE278u, 0xBDBDF21Cu,
    };
    uint32_t crc = 0xFFFFFFFFu;
    while (length--) {
        crc ^= *data++;
        crc = (crc >> 4) ^ table[crc & 15u];
        crc = (crc >> 4) ^ table[crc & 15u];
    }
    return ~crc;
}

size_t tt_cobs_encode(const uint8_t *data, size_t length, uint8_t *out)
{
    size_t code_at = 0, at = 1, i;
    uint8_t code = 1;
    for (i = 0; i < length; i++) {
        if (data[i] != 0) {
            out[at++] = data[i];
            code++;
        }
        if (data[i] == 0 || code == 255) {
            out[code_at] = code;
            code_at = at++;
            code = 1;
        }
    }
    out[code_at] = code;
    out[at++] = 0;
    return at;
}

size_t tt_cobs_decode(uint8_t *data, size_t length)
{
    size_t in = 0, out = 0;
    while (in < length) {
        uint8_t code = data[in++], left;
        if (code == 0 || (size_t)(code - 1) > length - in)
            return 0;
        for (left = (uint8_t)(code - 1); left > 0; left--)
            data[out++] = data[in++];
        if (code < 255 && in < length)
            data[out++] = 0;
    }
    return out;
}
