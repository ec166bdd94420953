/* Random bytes against the library, on a computer with sanitizers: `fuzz BYTES [SEED]`.
 *
 * Bytes are pure noise, damaged commands, and commands that are whole with any content. They come
 * in pieces of any size, the line takes answers in pieces of any size or not at all, and the timer
 * ticks in between. What the device sends is read again: only whole packets, of known types, with
 * values that a host accepts; rows of a frame in order; nothing behind STOP; every valid command
 * for this device is answered as long as the line is read.
 */
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tt_board.h"
#include "tt_device.h"

#define MOST_ROWS TT_MAX_ROWS

static struct tt_device device;
static uint64_t now, random_state;
static uint16_t grounded = TT_GROUND_NONE, selected;
static uint32_t rows_seen, answers_seen, errors_seen, commands_sent;
static bool streaming_told, told_to_all, reads;

static void fail(const char *what)
{
    fprintf(stderr, "fuzz: %s\n", what);
    abort();
}

static uint32_t dice(uint32_t sides)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)(random_state >> 20) % sides;
}

/* ---- the board ---- */

uint64_t tt_board_time(void)
{
    return now;
}

void tt_board_lock(void)
{
}

void tt_board_unlock(void)
{
}

void tt_board_ground(uint16_t electrode)
{
    if (electrode != TT_GROUND_NONE && electrode >= device.facts->electrodes)
        fail("an electrode that does not exist is grounded");
    if (electrode != TT_GROUND_NONE && grounded != TT_GROUND_NONE)
        fail("two electrodes are grounded");
    grounded = electrode;
}

void tt_board_select(uint16_t electrode)
{
    if (electrode >= device.facts->electrodes || grounded == TT_GROUND_NONE)
        fail("an electrode that does not exist is read, or none is grounded");
    selected = electrode;
}

uint32_t tt_board_convert(void)
{
    return 0xFFF0u + dice(64); /* the largest codes: must never look like none */
}

float tt_board_temperature(void)
{
    return 25.0f;
}

void tt_board_send(void)
{
}

/* ---- the host ---- */

static bool is_rate(const uint8_t *at)
{
    float rate = tt_get_f32(at);
    return rate > 0.0f && rate < 1e9f;
}

static void check_row(const uint8_t *packet, size_t length)
{
    static uint32_t last_sequence;
    static uint16_t last_row;
    static uint64_t last_time;
    bool first = packet[1] == 1;
    uint16_t count = tt_get_u16(packet + (first ? TT_V1_ROW_COUNT : TT_V2_ROW_COUNT));
    uint16_t row = tt_get_u16(packet + TT_V2_ROW_ROW);
    uint16_t rows = tt_get_u16(packet + (first ? TT_V1_ROW_ROWS : TT_V2_ROW_ROWS));
    uint16_t ground = tt_get_u16(packet + (first ? TT_V1_ROW_GROUNDED : TT_V2_ROW_GROUNDED));
    size_t head = first ? TT_V1_ROW_SIZE : TT_V2_ROW_SIZE, e;
    uint32_t sequence = tt_get_u32(packet + TT_V2_ROW_SEQUENCE);
    uint64_t time = tt_get_u32(packet + TT_V2_ROW_FRAME_TIME)
        + ((uint64_t)tt_get_u32(packet + TT_V2_ROW_FRAME_TIME + 4) << 32)
        + tt_get_u32(packet + TT_V2_ROW_ROW_END);
    if (first)
        row = tt_get_u16(packet + TT_V1_ROW_ROW);
    if (!streaming_told && !told_to_all)
        fail("a row behind the answer to STOP, or before that to START");
    if (count != device.facts->electrodes || length != head + 2u * count)
        fail("a row of another length");
    if (row >= rows || rows > MOST_ROWS || ground >= count)
        fail("a row that cannot be");
    if (first && (rows != count || ground != row))
        fail("version 1 in a commanded order");
    if (rows_seen > 0 && sequence == last_sequence && row <= last_row)
        fail("rows of a frame out of order");
    if (rows_seen > 0 && (sequence - last_sequence > 1u << 30 || time < last_time))
        fail("frames out of order");
    for (e = 0; e < count; e++) {
        bool none = packet[head + 2 * e] == 0 && packet[head + 2 * e + 1] == 0;
        if (none != (first && e == ground))
            fail("a reading that is none");
    }
    last_sequence = sequence;
    last_row = row;
    last_time = time;
    rows_seen++;
}

static void check_packet(uint8_t *bytes, size_t length)
{
    size_t whole = tt_cobs_decode(bytes, length);
    if (whole < 8 || tt_crc32(bytes, whole - 4) != tt_get_u32(bytes + whole - 4))
        fail("a damaged packet");
    length = whole - 4;
    if (bytes[1] != 1 && bytes[1] != 2)
        fail("another version");
    if (bytes[1] == 2 && bytes[6] != device.facts->address)
        fail("another address");
    if (bytes[0] != TT_ROW)
        answers_seen++;
    switch (bytes[0]) {
    case TT_ROW:
        check_row(bytes, length);
        break;
    case TT_IDENTITY:
        if (!is_rate(bytes + (bytes[1] == 1 ? TT_V1_IDENTITY_RATE : TT_V2_IDENTITY_RATE)))
            fail("an identity without rate");
        break;
    case TT_ACK:
        if (length != (bytes[1] == 1 ? TT_V1_ACK_SIZE : TT_V2_ACK_SIZE))
            fail("an ACK of another length");
        if (!is_rate(bytes + (bytes[1] == 1 ? TT_V1_ACK_RATE : TT_V2_ACK_RATE)))
            fail("an ACK without rate");
        if (bytes[TT_V1_ACK_COMMAND] == TT_START)
            streaming_told = true;
        if (bytes[TT_V1_ACK_COMMAND] == TT_STOP)
            streaming_told = false;
        break;
    case TT_ERROR:
        errors_seen++;
        break;
    case TT_STATUS:
        if (length != TT_V2_STATUS_SIZE)
            fail("a STATUS of another length");
        break;
    default:
        fail("a packet of unknown type");
    }
}

/* Take what the line takes now; where it is not read it takes nothing. */
static void line_takes(uint32_t most)
{
    static uint8_t packet[TT_WIRE_SIZE(TT_LONGEST_PACKET)];
    static size_t length;
    uint8_t byte;
    while (most-- && tt_queue_get(&device.sending, &byte)) {
        if (byte != 0) {
            if (length == sizeof packet)
                fail("a packet that is too long");
            packet[length++] = byte;
        } else {
            if (length > 0)
                check_packet(packet, length);
            length = 0;
        }
    }
}

/* ---- what is sent ---- */

static size_t wrapped(uint8_t *packet, size_t length, uint8_t *wire)
{
    length = tt_put_u32(packet, length, tt_crc32(packet, length));
    return tt_cobs_encode(packet, length, wire);
}

/* A command with a right checksum; its content mostly makes sense. */
static size_t command(uint8_t *wire)
{
    static const uint8_t sizes_1[] = {0, 4, 4, 4, 8, 4, 4}, sizes_2[] = {0, 8, 12, 8, 12, 8, 8};
    uint8_t packet[128];
    uint8_t type = (uint8_t)(1u + dice(6)), version = (uint8_t)(1u + dice(2));
    size_t length = version == 1 ? sizes_1[type] : sizes_2[type], i;
    static const float rates[] = {1.0f, 50.0f, 300.0f, 1e-6f, 1e9f, -1.0f, 0.0f};
    for (i = 0; i < sizeof packet; i++)
        packet[i] = (uint8_t)dice(256);
    packet[0] = type;
    packet[1] = version;
    if (version == 2) {
        packet[6] = dice(8) ? device.facts->address : (uint8_t)dice(256);
        packet[7] = 0;
        if (type == TT_START) {
            (void)tt_put_u16(packet, TT_V2_START_TIMEOUT, (uint16_t)(dice(2) * dice(2000)));
            (void)tt_put_u32(packet, TT_V2_START_FRAMES, dice(3) * dice(4));
        }
        if (type == TT_SET_SCAN) {
            uint16_t count = (uint16_t)dice(MOST_ROWS + 2);
            (void)tt_put_u16(packet, TT_V2_SET_SCAN_COUNT, count);
            for (i = 0; i < count; i++)
                (void)tt_put_u16(packet, 8 + 2 * i, (uint16_t)dice(8u + (dice(20) == 0)));
            length = 8 + 2u * count;
        }
    }
    if (type == TT_SET_RATE && dice(4))
        (void)tt_put_f32(packet, version == 1 ? 4 : 8, rates[dice(7)]);
    if (dice(10) == 0)
        packet[dice(8)] = (uint8_t)dice(256);
    if (dice(10) == 0)
        length += dice(20);
    if (dice(20) == 0)
        length = dice((uint32_t)length);
    if (length < 4)
        length = 4;
    if (packet[1] == 2 && packet[6] == TT_ALL_ADDRESSES)
        told_to_all = true; /* nobody answers that */
    commands_sent++;
    return wrapped(packet, length, wire);
}

static size_t piece(uint8_t *bytes)
{
    size_t length = command(bytes), i;
    switch (dice(8)) {
    case 0: /* noise, at times without a delimiter for long */
        length = dice(256);
        for (i = 0; i < length; i++)
            bytes[i] = (uint8_t)(dice(256) | (length % 2u));
        break;
    case 1:
        bytes[dice((uint32_t)length)] ^= (uint8_t)(1u << dice(8));
        break;
    case 2:
        length = dice((uint32_t)length) + 1;
        break;
    default:
        break;
    }
    return length;
}

/* Behind everything, a device that is read answers within the time of a row. */
static void must_answer(void)
{
    uint8_t packet[16] = {TT_STOP, 1, 7, 0}, wire[32];
    size_t length = 4, i;
    uint32_t before;
    if (device.facts->address != 0) {
        packet[1] = 2;
        (void)tt_put_u32(packet, 4, 0);
        packet[6] = device.facts->address;
        length = 8;
    }
    length = wrapped(packet, length, wire);
    for (i = 0; i < 400; i++) { /* what was under way before */
        now += 100;
        (void)tt_scan_tick(&device.scan);
        (void)tt_device_poll(&device);
        line_takes(10000);
    }
    before = answers_seen;
    (void)tt_queue_put(&device.received, (const uint8_t *)"", 1);
    if (!tt_queue_put(&device.received, wire, length))
        fail("no room for a command");
    for (i = 0; i < 40; i++) {
        now += 100;
        (void)tt_scan_tick(&device.scan);
        (void)tt_device_poll(&device);
        line_takes(10000);
    }
    if (answers_seen == before)
        fail("STOP is not answered");
}

int main(int argc, char **argv)
{
    static struct tt_facts facts = {
        8, 2, 1, 1e-4f, 16, 0, 5e-5f, 3.3f, 20.0f, 0, 0, 1, "fuzzed", "1", "0",
    };
    double total = argc > 1 ? atof(argv[1]) : 1e7, sent = 0.0;
    uint32_t rounds = 0;
    random_state = 88172645463325252ull + (argc > 2 ? (uint64_t)atoll(argv[2]) : 0u) * 7919u;
    while (sent < total) {
        uint8_t bytes[512];
        size_t length, at = 0;
        if (rounds++ % 5000u == 0) { /* power-up, now and then with an address or another zero */
            if (rounds > 1)
                line_takes(TT_SEND_BYTES);
            facts.address = (uint8_t)(dice(3) ? 0u : 1u + dice(254));
            facts.zero = (uint16_t)(dice(2) ? 0u : dice(60000));
            grounded = TT_GROUND_NONE;
            streaming_told = told_to_all = false;
            rows_seen = 0;
            now += 1000000;
            tt_device_init(&device, &facts);
            reads = true;
        }
        if (dice(100) == 0)
            reads = !reads;
        length = piece(bytes);
        while (at < length) {
            size_t n = 1u + dice(64), ticks = dice(12);
            n = n < length - at ? n : length - at;
            if (tt_queue_put(&device.received, bytes + at, n))
                sent += (double)n;
            at += n;
            while (ticks--) {
                now += 100;
                (void)tt_scan_tick(&device.scan);
            }
            (void)tt_device_poll(&device);
            line_takes(reads ? dice(400) : 0);
        }
        if (rounds % 500u == 0 && reads)
            must_answer();
    }
    printf("%.0f bytes, %lu commands, %lu answers, %lu of them errors\n", sent,
           (unsigned long)commands_sent, (unsigned long)answers_seen, (unsigned long)errors_seen);
    return 0;
}
