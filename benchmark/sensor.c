/* A sensor for fault tests, written from docs/protocol.md alone; it shares no line with the rest.
 *
 *     cc -std=c99 -O2 -o sensor benchmark/sensor.c
 *     ./sensor --port pty:LINK|tcp:PORT [--electrodes 64] [--rate 250] [--buffer BYTES]
 *              [--throttle BYTES_PER_S] [--fault NAME] [--amount P] [--seed N]
 *     ./sensor --list
 *
 * Speaks version 1 of the protocol. Every reading is a hash of sequence, row and electrode (`reading`), so
 * that whoever knows the hash sees any wrong value. `--buffer` is what it keeps for a slow line before it
 * drops whole packets, `--throttle` how fast the line is. `--fault` is one of `--list`: what the line
 * does to the bytes, or what a broken device says in packets that are whole. `--amount` is its
 * probability for each packet (for `restart` the seconds in between).
 *
 * Prints the port, then `from SEQUENCE MICROSECONDS RATE` when frames begin (CLOCK_MONOTONIC), so that
 * the age of each can be told, and at its end, with SIGTERM, what it has made and dropped.
 */
#define _XOPEN_SOURCE 700
#define _DEFAULT_SOURCE
#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <signal.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#define FASTEST 4000.0f
#define SLOWEST 0.001f
#define LONGEST 4096 /* bytes of a packet before COBS */

/* ---- what is set from outside ---- */

static int electrodes = 64;
static float rate = 15.625f;
static size_t capacity = 1 << 19;
static double throttle; /* bytes/s, 0: as fast as it goes */
static const char *fault = "none";
static double amount = 1.0;

/* ---- the device ---- */

static int streaming, row;
static uint32_t sequence;
static uint64_t frame_time, power_up;
static double frame_due;             /* µs of the host */
static int announce;                 /* say when the frame begins, for whoever measures its age */
static float rate_now = 15.625f;     /* of the frame under way; `rate` holds from the next one on */
static unsigned long long rows_made, rows_dropped, frames_made;

static uint64_t micros(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000u + (uint64_t)(t.tv_nsec / 1000);
}

static uint64_t random_state = 88172645463325252ull;

static uint32_t random_bits(void)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)(random_state >> 16);
}

static int chance(double p)
{
    return random_bits() < p * 4294967296.0;
}

static int is_fault(const char *name)
{
    return strcmp(fault, name) == 0;
}

/* Counts of 12 bits, below 4000. */
static uint16_t reading(uint32_t frame, uint32_t line, uint32_t electrode)
{
    uint32_t h = frame * 0x9E3779B1u ^ (line + 1u) * 0x85EBCA77u ^ (electrode + 1u) * 0xC2B2AE3Du;
    h ^= h >> 15;
    h *= 0x2C1B3C6Du;
    h ^= h >> 12;
    h *= 0x297A2D39u;
    h ^= h >> 15;
    return (uint16_t)(h % 4000u);
}

/* ---- bytes ---- */

struct bytes {
    uint8_t at[LONGEST + 64];
    size_t length;
};

static void u8(struct bytes *b, unsigned v)
{
    b->at[b->length++] = (uint8_t)v;
}

static void u16(struct bytes *b, unsigned v)
{
    u8(b, v & 255u);
    u8(b, v >> 8 & 255u);
}

static void u32(struct bytes *b, uint32_t v)
{
    u16(b, v & 65535u);
    u16(b, v >> 16);
}

static void u64(struct bytes *b, uint64_t v)
{
    u32(b, (uint32_t)v);
    u32(b, (uint32_t)(v >> 32));
}

static void f32(struct bytes *b, float v)
{
    uint32_t bits;
    memcpy(&bits, &v, 4);
    u32(b, bits);
}

static void text(struct bytes *b, const char *words)
{
    u8(b, (unsigned)strlen(words));
    while (*words)
        u8(b, (uint8_t)*words++);
}

static uint32_t checksum(const uint8_t *data, size_t length)
{
    uint32_t crc = 0xFFFFFFFFu;
    int bit;
    for (; length; length--) {
        crc ^= *data++;
        for (bit = 0; bit < 8; bit++)
            crc = crc & 1u ? crc >> 1 ^ 0xEDB88320u : crc >> 1;
    }
    return crc ^ 0xFFFFFFFFu;
}

/* Blocks of non-zero bytes, each behind its length + 1; a block of 254 stands for no zero. */
static size_t stuffed(const struct bytes *b, uint8_t *out)
{
    size_t in = 0, at = 0;
    for (;;) {
        size_t n = 0;
        while (in + n < b->length && b->at[in + n] != 0 && n < 254)
            n++;
        out[at++] = (uint8_t)(n + 1);
        memcpy(out + at, b->at + in, n);
        at += n;
        in += n;
        if (in == b->length)
            break;
        if (n < 254)
            in++; /* the zero that follows from the code */
    }
    out[at++] = 0;
    return at;
}

/* ---- the line ---- */

static uint8_t *waiting; /* ring */
static size_t waiting_at, waiting_length;
static int line = -1, server = -1;

static void put(const uint8_t *data, size_t length)
{
    size_t i;
    for (i = 0; i < length && waiting_length < capacity; i++)
        waiting[(waiting_at + waiting_length++) % capacity] = data[i];
}

/* What a bad line does to one packet on its way; at most 20000 bytes come out. */
static size_t damage(uint8_t *wire, size_t length)
{
    static uint8_t kept[2 * LONGEST];
    static size_t kept_length;
    size_t i, n;
    if (kept_length > 0) {
        memcpy(wire + length, kept, kept_length);
        length += kept_length;
        kept_length = 0;
        return length;
    }
    if (!chance(amount))
        return length;
    if (is_fault("flip")) {
        wire[random_bits() % length] ^= (uint8_t)(1u << random_bits() % 8u);
    } else if (is_fault("burst")) {
        for (i = random_bits() % length, n = 1 + random_bits() % 16u; n && i < length; n--, i++)
            wire[i] = (uint8_t)random_bits();
    } else if (is_fault("zeros")) {
        for (i = random_bits() % length, n = 1 + random_bits() % 16u; n && i < length; n--, i++)
            wire[i] = 0;
    } else if (is_fault("drop-byte")) {
        i = random_bits() % length;
        memmove(wire + i, wire + i + 1, length - i - 1);
        length--;
    } else if (is_fault("insert-byte")) {
        i = random_bits() % length;
        memmove(wire + i + 1, wire + i, length - i);
        wire[i] = (uint8_t)random_bits();
        length++;
    } else if (is_fault("cut")) {
        length = random_bits() % length;
    } else if (is_fault("lose")) {
        length = 0;
    } else if (is_fault("double")) {
        memcpy(wire + length, wire, length);
        length *= 2;
    } else if (is_fault("noise")) {
        for (n = 1 + random_bits() % 9000u; n; n--)
            wire[length++] = (uint8_t)(random_bits() | (n % 2u ? 1u : 0u));
    } else if (is_fault("swap")) { /* comes behind the next one */
        memcpy(kept, wire, length);
        kept_length = length;
        length = 0;
    } else if (is_fault("merge")) {
        length--; /* two packets become one */
    }
    return length;
}

static int send_packet(struct bytes *b)
{
    static uint8_t wire[6 * LONGEST];
    size_t length;
    u32(b, checksum(b->at, b->length));
    length = damage(wire, stuffed(b, wire));
    if (waiting_length + length > capacity)
        return 0;
    put(wire, length);
    return 1;
}

static void flush_line(void)
{
    static double allowed;
    static uint64_t last;
    uint64_t now = micros();
    size_t n = capacity - waiting_at;
    ssize_t sent;
    if (line < 0) {
        waiting_length = 0;
        return;
    }
    if (n > waiting_length)
        n = waiting_length;
    if (throttle > 0) {
        allowed += throttle * 1e-6 * (double)(now - last);
        if (allowed > throttle * 0.01)
            allowed = throttle * 0.01;
        last = now;
        if (n > allowed)
            n = (size_t)allowed;
    }
    if (n == 0)
        return;
    sent = write(line, waiting + waiting_at, n);
    if (sent > 0) {
        waiting_at = (waiting_at + (size_t)sent) % capacity;
        waiting_length -= (size_t)sent;
        allowed -= throttle > 0 ? (double)sent : 0.0;
    } else if (sent < 0 && errno != EAGAIN && errno != EIO && server >= 0) {
        close(line);
        line = -1;
    }
}

/* ---- packets ---- */

static void begin(struct bytes *b, unsigned type, unsigned tag)
{
    b->length = 0;
    u8(b, type);
    u8(b, 1);
    u16(b, tag);
}

static void send_identity(unsigned tag)
{
    struct bytes b;
    begin(&b, 0x11, tag);
    u16(&b, is_fault("identity-no-electrodes") ? 0u : (unsigned)electrodes);
    u16(&b, is_fault("identity-more-rows") ? (unsigned)electrodes + 1u : (unsigned)electrodes);
    u8(&b, 12);
    u8(&b, 0);
    f32(&b, is_fault("identity-range") ? -3.3f : 3.3f);
    f32(&b, is_fault("identity-rate") ? NAN : rate);
    u32(&b, 0);
    f32(&b, FASTEST);
    text(&b, is_fault("identity-escape") ? "\033[2J\033]0;owned\007\n[INFO] all is well" : "hash");
    text(&b, "1.0");
    text(&b, "C0");
    if (is_fault("identity-short"))
        b.length -= 4;
    send_packet(&b);
}

static void send_ack(unsigned tag, unsigned command)
{
    struct bytes b;
    if (is_fault("ack-never") && command != 1)
        return;
    begin(&b, 0x12, is_fault("ack-tag") ? tag + 7u : tag);
    u8(&b, is_fault("ack-command") ? 0x10u + command : command);
    u8(&b, streaming ? 1u : 0u);
    f32(&b, is_fault("ack-rate") ? INFINITY : rate);
    send_packet(&b);
}

static void send_error(unsigned tag, unsigned command, unsigned code, const char *words)
{
    struct bytes b;
    begin(&b, 0x13, tag);
    u8(&b, command);
    u8(&b, code);
    while (*words)
        u8(&b, (uint8_t)*words++);
    send_packet(&b);
}

/* What a row says that it should not; values are those that a broken device could send. */
static void row_of_nonsense(struct bytes *b, uint32_t row_end)
{
    int mad = chance(amount), e;
    unsigned r = (unsigned)row, n = (unsigned)electrodes, grounded = r;
    uint32_t s = sequence;
    uint64_t t = frame_time;
    float scale = 3.3f / 4096.0f, drive = 3.3f;
#define MAD(name) (mad && is_fault(name))
    if (MAD("row-index"))
        r = n;
    if (MAD("sequence-jumps"))
        s += random_bits() % 1000u;
    if (MAD("sequence-falls"))
        s = ~s;
    if (MAD("sequence-stands"))
        s = 5u;
    if (MAD("time-falls"))
        t = 1000000000000u - t;
    if (MAD("time-stands"))
        t = 1000000u;
    if (MAD("time-jumps"))
        t += 3600000000u * (s % 2u);
    if (MAD("time-random"))
        t = (uint64_t)random_bits() << 32 | random_bits();
    if (MAD("row-end-huge"))
        row_end = 0xFFFFFFFFu;
    if (MAD("row-end-zero"))
        row_end = 0;
    if (MAD("scale-nan"))
        scale = NAN;
    if (MAD("scale-huge"))
        scale = 1e30f;
    if (MAD("scale-zero"))
        scale = 0.0f;
    if (MAD("scale-ten-times"))
        scale *= 10.0f;
    if (MAD("scale-negative"))
        scale = -scale;
    if (MAD("drive-nan"))
        drive = NAN;
    if (MAD("drive-negative"))
        drive = -3.3f;
    if (MAD("drive-zero"))
        drive = 0.0f;
    if (MAD("grounded-beyond"))
        grounded = n;
    if (MAD("grounded-other"))
        grounded = (r + 1u) % n;
    if (MAD("grounded-twice"))
        grounded = 0;
    if (MAD("grounded-changes"))
        grounded = (r + s) % n;
    begin(b, MAD("type-unknown") ? 0x5A : 0x10, MAD("count-less") ? n - 1u : n);
    u16(b, r);
    u16(b, MAD("rows-less") ? n - 1u : n);
    b->at[1] = (uint8_t)(MAD("version-nine") ? 9 : 1);
    u32(b, s);
    u32(b, row_end);
    u64(b, t);
    f32(b, scale);
    f32(b, drive);
    u16(b, grounded);
    for (e = 0; e < electrodes; e++) {
        unsigned v = reading(sequence, (unsigned)row, (unsigned)e);
        if (e == row || MAD("readings-none"))
            v = 0xFFFFu;
        if (MAD("readings-same"))
            v = 2000u;
        if (is_fault("dead-channel") && e == 3)
            v = 7u;
        u16(b, v ^ 0xFFFFu);
    }
    if (MAD("row-long"))
        u16(b, 0xFFFFu);
    if (MAD("row-short"))
        b->length -= 2;
#undef MAD
}

static void send_row(uint32_t row_end)
{
    struct bytes b;
    b.length = 0;
    row_of_nonsense(&b, row_end);
    rows_made++;
    if (!send_packet(&b)) {
        rows_dropped++;
        return;
    }
    if (is_fault("error-unasked") && chance(amount))
        send_error(0, 0, 4, "sheet torn");
    if (is_fault("ack-unasked") && chance(amount))
        send_ack(random_bits() & 65535u, 3);
    if (is_fault("stop-unasked") && chance(amount))
        streaming = 0;
}

/* ---- what happens ---- */

static double haste(void)
{
    return is_fault("haste") ? 3.0 : 1.0;
}

static void begin_frame(void)
{
    if (rate_now != rate || announce)
        printf("from %u %.0f %.9g\n", sequence, frame_due, rate * haste());
    announce = 0;
    rate_now = rate;
    frame_time = (uint64_t)frame_due - power_up;
    row = 0;
}

static double row_end_of(int r)
{
    return 1e6 * (r + 1) / (rate_now * haste() * electrodes);
}

/* Rows whose time has come; a computer that was away for more than a second leaves some out. */
static void scan(void)
{
    double now = (double)micros();
    while (streaming && now >= frame_due + row_end_of(row)) {
        send_row((uint32_t)(row_end_of(row) * haste()));
        if (++row < electrodes)
            continue;
        frame_due += row_end_of(electrodes - 1);
        sequence++;
        frames_made++;
        if (now - frame_due > 1e6) {
            double behind = floor((now - frame_due) * 1e-6 * rate_now * haste());
            sequence += (uint32_t)behind;
            frame_due += behind * row_end_of(electrodes - 1);
            announce = 1;
        }
        begin_frame();
    }
}

static unsigned word(const uint8_t *p)
{
    return p[0] | (unsigned)p[1] << 8;
}

static void start_stream(void)
{
    uint8_t delimiter = 0;
    put(&delimiter, 1);
    sequence += row > 0;
    streaming = 1;
    announce = 1;
    frame_due = (double)micros();
    begin_frame();
}

static float number(const uint8_t *p)
{
    uint32_t bits = word(p) | (uint32_t)word(p + 2) << 16;
    float value;
    memcpy(&value, &bits, 4);
    return value;
}

static void obey(const uint8_t *p, size_t length)
{
    unsigned type = p[0], tag = word(p + 2);
    if (p[1] != 1) {
        send_error(tag, type, 3, "version 1 only");
    } else if (type == 1 && length == 4) {
        send_identity(tag);
    } else if (type == 2 && length == 4) {
        if (!streaming)
            start_stream();
        send_ack(tag, type);
    } else if (type == 3 && length == 4) {
        streaming = is_fault("stop-deaf");
        send_ack(tag, type);
    } else if (type == 4 && length == 8) {
        float wish = number(p + 4);
        if (wish > 0 && wish <= FASTEST) {
            rate = wish < SLOWEST ? SLOWEST : wish;
            send_ack(tag, type);
        } else {
            send_error(tag, type, 2, "rate");
        }
    } else {
        send_error(tag, type, type >= 1 && type <= 4 ? 2 : 1, "what?");
    }
}

static void hear(const uint8_t *data, size_t length)
{
    static uint8_t run[64], packet[64];
    static size_t n;
    for (; length; length--, data++) {
        size_t in = 0, out = 0;
        if (*data) {
            if (n < sizeof run)
                run[n] = *data;
            n += n <= sizeof run;
            continue;
        }
        if (n > sizeof run)
            n = 0;
        while (in < n && in + run[in] <= n) {
            size_t code = run[in], i;
            for (i = 1; i < code; i++)
                packet[out++] = run[in + i];
            in += code;
            if (in < n && code < 255)
                packet[out++] = 0;
        }
        if (in == n && out >= 8) {
            uint32_t crc = packet[out - 4] | (uint32_t)packet[out - 3] << 8
                | (uint32_t)packet[out - 2] << 16 | (uint32_t)packet[out - 1] << 24;
            if (checksum(packet, out - 4) == crc)
                obey(packet, out - 4);
        }
        n = 0;
    }
}

static void restart_now(void)
{
    power_up = micros();
    sequence = 0;
    row = 0;
    streaming = is_fault("restart-streaming") && streaming;
    frame_due = (double)power_up;
    waiting_length = 0;
    begin_frame();
    printf("restarted\n");
}

static void meet(void)
{
    int host = accept(server, NULL, NULL), one = 1;
    if (host < 0)
        return;
    if (line >= 0) {
        close(host);
        return;
    }
    fcntl(host, F_SETFL, O_NONBLOCK);
    setsockopt(host, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
    line = host;
}

/* ---- the program ---- */

static volatile sig_atomic_t over;

static void end(int signal_number)
{
    (void)signal_number;
    over = 1;
}

static void fail(const char *what)
{
    perror(what);
    exit(2);
}

static void open_pty(const char *link)
{
    struct termios raw;
    int slave;
    line = posix_openpt(O_RDWR | O_NOCTTY);
    if (line < 0 || grantpt(line) || unlockpt(line))
        fail("pty");
    slave = open(ptsname(line), O_RDWR | O_NOCTTY); /* stays open: hosts come and go */
    tcgetattr(slave, &raw);
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    fcntl(line, F_SETFL, O_NONBLOCK);
    if (*link) {
        unlink(link);
        if (symlink(ptsname(line), link))
            fail(link);
    }
    printf("%s\n", *link ? link : ptsname(line));
}

static void open_tcp(int port)
{
    struct sockaddr_in address;
    socklen_t size = sizeof address;
    int one = 1;
    server = socket(AF_INET, SOCK_STREAM, 0);
    memset(&address, 0, sizeof address);
    address.sin_family = AF_INET;
    address.sin_port = htons((uint16_t)port);
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    setsockopt(server, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
    if (bind(server, (struct sockaddr *)&address, size) || listen(server, 4))
        fail("tcp");
    getsockname(server, (struct sockaddr *)&address, &size);
    printf("socket://127.0.0.1:%d\n", ntohs(address.sin_port));
}

static const char *faults[] = {
    /* the line */
    "none", "flip", "burst", "zeros", "drop-byte", "insert-byte", "cut", "lose", "double", "noise",
    "swap", "merge",
    /* valid nonsense */
    "row-index", "sequence-jumps", "sequence-falls", "sequence-stands", "time-falls",
    "time-stands", "time-jumps", "time-random", "row-end-huge", "row-end-zero", "scale-nan",
    "scale-huge", "scale-zero", "scale-ten-times", "scale-negative", "drive-nan", "drive-negative",
    "drive-zero", "grounded-beyond", "grounded-other", "grounded-twice", "grounded-changes", "type-unknown",
    "count-less", "version-nine", "rows-less", "readings-none", "readings-same", "dead-channel",
    "row-long", "row-short", "error-unasked", "ack-unasked", "stop-unasked", "haste", "stop-deaf",
    "identity-no-electrodes", "identity-more-rows", "identity-range", "identity-rate",
    "identity-escape", "identity-short", "ack-never", "ack-tag", "ack-command", "ack-rate",
    /* the device */
    "restart", "restart-streaming",
};

int main(int argc, char **argv)
{
    const char *port = "pty:";
    uint64_t restarted;
    size_t k;
    int i;
    for (i = 1; i < argc; i += 2) {
        const char *value = i + 1 < argc ? argv[i + 1] : "";
        if (!strcmp(argv[i], "--list")) {
            for (k = 0; k < sizeof faults / sizeof *faults; k++)
                puts(faults[k]);
            return 0;
        }
        if (!strcmp(argv[i], "--port")) port = value;
        else if (!strcmp(argv[i], "--electrodes")) electrodes = atoi(value);
        else if (!strcmp(argv[i], "--rate")) rate = (float)atof(value);
        else if (!strcmp(argv[i], "--buffer")) capacity = (size_t)atof(value);
        else if (!strcmp(argv[i], "--throttle")) throttle = atof(value);
        else if (!strcmp(argv[i], "--fault")) fault = value;
        else if (!strcmp(argv[i], "--amount")) amount = atof(value);
        else if (!strcmp(argv[i], "--seed")) random_state += (uint64_t)atoll(value) * 0x9E3779B97F4A7C15ull;
        else {
            fprintf(stderr, "sensor: %s?\n", argv[i]);
            return 2;
        }
    }
    if (electrodes < 2 || electrodes > 2029 || capacity < 2 * LONGEST) {
        fprintf(stderr, "sensor: 2 to 2029 electrodes, a buffer of 8192 bytes or more\n");
        return 2;
    }
    for (k = 0; k < sizeof faults / sizeof *faults && strcmp(fault, faults[k]); k++)
        ;
    if (k == sizeof faults / sizeof *faults) {
        fprintf(stderr, "sensor: no fault %s; see --list\n", fault);
        return 2;
    }
    setvbuf(stdout, NULL, _IOLBF, 0);
    waiting = malloc(capacity);
    if (waiting == NULL)
        fail("buffer");
    rate_now = rate;
    signal(SIGTERM, end);
    signal(SIGINT, end);
    signal(SIGPIPE, SIG_IGN);
    power_up = restarted = micros();
    if (!strncmp(port, "tcp:", 4))
        open_tcp(atoi(port + 4));
    else
        open_pty(!strncmp(port, "pty:", 4) ? port + 4 : port);
    while (!over) {
        struct pollfd fds[2];
        uint8_t data[4096];
        fds[0].fd = line;
        fds[0].events = (short)(POLLIN | (waiting_length && throttle == 0 ? POLLOUT : 0));
        fds[0].revents = 0;
        fds[1].fd = server;
        fds[1].events = POLLIN;
        fds[1].revents = 0;
        poll(fds, 2, streaming || waiting_length ? 1 : 50);
        if (server >= 0 && fds[1].revents)
            meet();
        if (line >= 0 && fds[0].revents & (POLLIN | POLLHUP | POLLERR)) {
            ssize_t n = read(line, data, sizeof data);
            if (n > 0) {
                hear(data, (size_t)n);
            } else if (server >= 0 && (n == 0 || errno != EAGAIN)) {
                close(line);
                line = -1;
                waiting_length = 0;
            }
        }
        if (!strncmp(fault, "restart", 7) && (double)(micros() - restarted) > amount * 1e6) {
            restarted = micros();
            restart_now();
        }
        scan();
        flush_line();
    }
    printf("frames %llu, rows %llu, dropped %llu\n", frames_made, rows_made, rows_dropped);
    free(waiting);
    return 0;
}
