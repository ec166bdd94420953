/* A complete device of the wire protocol, as a beginning for firmware.
 *
 * wire.c is the C code of protocol.md, section 1. The functions board_... are to be written for the
 * board; those at the end make a program of it that speaks on its standard input and output, which
 * the tests connect to the driver.
 */
#include <string.h>

#include "wire.c"

enum { ELECTRODES = 6, VERSION = 1 };
enum { IDENTIFY = 0x01, START, STOP, SET_RATE, ROW = 0x10, IDENTITY, ACK, ERROR };
enum { UNKNOWN_COMMAND = 1, BAD_VALUE, UNSUPPORTED_VERSION };

#define RANGE 3.3f
#define BITS 12
#define FASTEST 200.0f
#define SLOWEST 0.001f   /* row_end has 32 bits of microseconds */

void board_send(const uint8_t *data, size_t length);
uint64_t board_time(void);                                    /* µs since power-up */
uint16_t board_read(uint16_t grounded, uint16_t electrode);   /* counts */

static struct {
    int streaming;
    float rate, next_rate;
    uint32_t sequence;
    uint16_t row;
    uint64_t frame_time;
} scan = {0, 20.0f, 20.0f, 0, 0, 0};

static size_t put(uint8_t *packet, size_t at, uint64_t value, int bytes)
{
    while (bytes--) {
        packet[at++] = (uint8_t)value;
        value >>= 8;
    }
    return at;
}

static size_t put_f32(uint8_t *packet, size_t at, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, 4);
    return put(packet, at, bits, 4);
}

static size_t put_string(uint8_t *packet, size_t at, const char *text)
{
    at = put(packet, at, strlen(text), 1);
    memcpy(packet + at, text, strlen(text));
    return at + strlen(text);
}

static void send_packet(uint8_t *packet, size_t length)
{
    static uint8_t wire[4 * ELECTRODES + 128];
    length = put(packet, length, crc32(packet, length), 4);
    board_send(wire, cobs_encode(packet, length, wire));
}

static size_t begin_answer(uint8_t *packet, uint8_t type, uint16_t tag)
{
    packet[0] = type;
    packet[1] = VERSION;
    return put(packet, 2, tag, 2);
}

static void send_identity(uint16_t tag)
{
    uint8_t packet[64];
    size_t at = begin_answer(packet, IDENTITY, tag);
    at = put(packet, at, ELECTRODES, 2);
    at = put(packet, at, ELECTRODES, 2);
    at = put(packet, at, BITS, 1);
    at = put(packet, at, 0, 1);
    at = put_f32(packet, at, RANGE);
    at = put_f32(packet, at, scan.next_rate);
    at = put(packet, at, 0, 4);
    at = put_f32(packet, at, FASTEST);
    at = put_string(packet, at, "example");
    at = put_string(packet, at, "1.0.0");
    at = put_string(packet, at, "C1");
    send_packet(packet, at);
}

static void send_ack(uint16_t tag, uint8_t command)
{
    uint8_t packet[16];
    size_t at = begin_answer(packet, ACK, tag);
    at = put(packet, at, command, 1);
    at = put(packet, at, scan.streaming != 0, 1);
    send_packet(packet, put_f32(packet, at, scan.next_rate));
}

static void send_error(uint16_t tag, uint8_t command, uint8_t code)
{
    uint8_t packet[16];
    size_t at = begin_answer(packet, ERROR, tag);
    at = put(packet, at, command, 1);
    send_packet(packet, put(packet, at, code, 1));
}

static void begin_frame(uint64_t time)
{
    scan.rate = scan.next_rate;
    scan.frame_time = time;
    scan.row = 0;
}

static void start(void)
{
    if (scan.streaming)
        return;
    board_send((const uint8_t *)"", 1);   /* a delimiter, against noise on the line */
    scan.sequence += scan.row > 0;
    scan.streaming = 1;
    begin_frame(board_time());
}

static int set_rate(const uint8_t *f32)
{
    uint32_t bits = f32[0] | f32[1] << 8 | f32[2] << 16 | (uint32_t)f32[3] << 24;
    float rate;
    memcpy(&rate, &bits, 4);
    if (!(rate > 0.0f && rate <= FASTEST))
        return 0;
    scan.next_rate = rate < SLOWEST ? SLOWEST : rate;
    return 1;
}

static void obey(const uint8_t *packet, size_t length)
{
    uint16_t tag = (uint16_t)(packet[2] | packet[3] << 8);
    uint8_t command = packet[0];

    if (packet[1] != VERSION) {
        send_error(tag, command, UNSUPPORTED_VERSION);
    } else if (command == IDENTIFY) {
        send_identity(tag);
    } else if (command == SET_RATE && (length != 8 || !set_rate(packet + 4))) {
        send_error(tag, command, BAD_VALUE);
    } else if (command >= START && command <= SET_RATE) {
        if (command == START)
            start();
        if (command == STOP)
            scan.streaming = 0;
        send_ack(tag, command);
    } else {
        send_error(tag, command, UNKNOWN_COMMAND);
    }
}

/* To be called with every byte from the host. */
void device_receive(uint8_t byte)
{
    static uint8_t line[32];
    static size_t length;
    if (byte != 0) {
        if (length < sizeof line)
            line[length] = byte;
        length++;
        return;
    }
    size_t whole = length > 0 && length <= sizeof line ? cobs_decode(line, length) : 0;
    length = 0;
    uint8_t crc[4];
    if (whole < 8)
        return;
    put(crc, 0, crc32(line, whole - 4), 4);
    if (memcmp(line + whole - 4, crc, 4) == 0)
        obey(line, whole - 4);
}

static void send_row(uint32_t row_end)
{
    uint8_t packet[34 + 2 * ELECTRODES + 4];
    size_t at = put(packet, 0, ROW, 1);
    at = put(packet, at, VERSION, 1);
    at = put(packet, at, ELECTRODES, 2);
    at = put(packet, at, scan.row, 2);
    at = put(packet, at, ELECTRODES, 2);
    at = put(packet, at, scan.sequence, 4);
    at = put(packet, at, row_end, 4);
    at = put(packet, at, scan.frame_time, 8);
    at = put_f32(packet, at, RANGE / (1 << BITS));
    at = put_f32(packet, at, RANGE);
    at = put(packet, at, scan.row, 2);
    for (uint16_t e = 0; e < ELECTRODES; e++) {
        uint16_t reading = e == scan.row ? 0xFFFF : board_read(scan.row, e);
        at = put(packet, at, (uint16_t)~reading, 2);
    }
    send_packet(packet, at);
}

/* To be called often; sends the row whose time has come. */
void device_scan(void)
{
    uint32_t row_end = (uint32_t)(1e6f * (scan.row + 1) / (scan.rate * ELECTRODES));
    if (!scan.streaming || board_time() < scan.frame_time + row_end)
        return;
    send_row(row_end);
    if (++scan.row == ELECTRODES) {
        scan.sequence++;
        begin_frame(scan.frame_time + row_end);
    }
}

#ifdef ON_A_COMPUTER
#include <poll.h>
#include <time.h>
#include <unistd.h>

void board_send(const uint8_t *data, size_t length)
{
    while (length > 0) {
        ssize_t sent = write(1, data, length);
        if (sent <= 0)
            _exit(1);
        data += sent;
        length -= (size_t)sent;
    }
}

uint64_t board_time(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

uint16_t board_read(uint16_t grounded, uint16_t electrode)
{
    return (uint16_t)(100 * grounded + electrode);
}

int main(void)
{
    struct pollfd input = {0, POLLIN, 0};
    uint8_t byte;
    for (;;) {
        if (poll(&input, 1, 1) > 0) {
            if (read(0, &byte, 1) != 1)
                return 0;
            device_receive(byte);
        }
        device_scan();
    }
}
#endif
