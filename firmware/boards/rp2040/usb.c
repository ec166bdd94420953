/* See usb.h. The controller: RP2040 datasheet, 4.1. What is said: USB 2.0, chapter 9, and CDC 1.2
 * with its subclass PSTN 1.2 (abstract control model).
 *
 * All of it runs in one interrupt, so that nothing needs a lock; `usb_wake` asks for that interrupt.
 */
#include "usb.h"

#include <stdbool.h>

#include "registers.h"

/* Of pid.codes, for trials within one's own four walls; whoever sells a device needs his own. */
#define VENDOR 0x1209
#define PRODUCT 0x0001

#define PACKET 64u
#define LINE_CODING_SIZE 7u
#define WORD(value) (uint8_t)((value) & 0xFF), (uint8_t)((value) >> 8)

/* Endpoints, and the places of their buffers in the controller's memory. A buffer's number is that
 * of its bit in BUFF_STATUS. */
enum { CONTROL, NOTICE, DATA };
enum { CONTROL_IN, CONTROL_OUT, NOTICE_IN, NOTICE_OUT, DATA_IN, DATA_OUT, BUFFERS };
enum { AT_CONTROL = 0x100, AT_NOTICE = 0x180, AT_DATA_IN = 0x1C0, AT_DATA_OUT = 0x200 };
#define MEMORY(place) ((volatile uint8_t *)(USB_MEMORY + (place)))
#define ENDPOINT(buffer) REGISTER(USB_MEMORY + 4u * (buffer))
#define BUFFER(buffer) REGISTER(USB_MEMORY + 0x80u + 4u * (buffer))
#define ENDPOINT_ON (1u << 31 | 1u << 29)
#define BULK (2u << 26)
#define INTERRUPT (3u << 26)
#define FULL (1u << 15)
#define DATA1 (1u << 13)
#define STALL (1u << 11)
#define AVAILABLE (1u << 10)
#define LENGTH 0x3FFu

enum { GET_STATUS = 0, CLEAR_FEATURE = 1, SET_ADDRESS = 5, GET_DESCRIPTOR = 6, GET_CONFIGURATION = 8,
       SET_CONFIGURATION = 9, GET_INTERFACE = 10, SET_INTERFACE = 11 };
enum { SET_LINE_CODING = 0x20, GET_LINE_CODING = 0x21, SET_LINE_STATE = 0x22, SEND_BREAK = 0x23 };
enum { DESCRIBE_DEVICE = 1, DESCRIBE_CONFIGURATION = 2, DESCRIBE_STRING = 3 };
enum { STRING_LANGUAGE, STRING_MAKER, STRING_PRODUCT, STRING_SERIAL };
#define TO_HOST 0x80u
#define KIND 0x60u
#define CLASS 0x20u
#define DTR 1u

static const uint8_t device_descriptor[] = {
    18, DESCRIBE_DEVICE, WORD(0x0200), 0xEF, 2, 1, /* interfaces that belong together */
    PACKET, WORD(VENDOR), WORD(PRODUCT), WORD(0x0200), STRING_MAKER, STRING_PRODUCT, STRING_SERIAL, 1,
};

#define CONFIGURATION_SIZE 75
static const uint8_t configuration_descriptor[CONFIGURATION_SIZE] = {
    9, DESCRIBE_CONFIGURATION, WORD(CONFIGURATION_SIZE), 2, 1, 0, 0x80, 250, /* 500 mA of the bus */
    8, 11, 0, 2, 2, 2, 0, 0,           /* two interfaces are one CDC ACM */
    9, 4, 0, 0, 1, 2, 2, 0, 0,         /* interface 0: control */
    5, 0x24, 0, WORD(0x0110),          /* CDC 1.1 */
    5, 0x24, 1, 0, 1,                  /* no calls */
    4, 0x24, 2, 2,                     /* line coding and state */
    5, 0x24, 6, 0, 1,                  /* interface 1 belongs to 0 */
    7, 5, 0x80 | NOTICE, 3, WORD(8), 255,
    9, 4, 1, 0, 2, 10, 0, 0, 0,        /* interface 1: data */
    7, 5, 0x80 | DATA, 2, WORD(PACKET), 0,
    7, 5, DATA, 2, WORD(PACKET), 0,
};

static struct tt_queue *from_host, *to_host;
static const char *strings[4] = {"", "tomotactile_ros", "", ""};
static uint8_t string_descriptor[2u + 2u * 32u];
static uint8_t line_coding[LINE_CODING_SIZE] = {0x80, 0x84, 0x1E, 0, 0, 0, 8}; /* 2 Mbit/s, 8N1 */
static uint8_t configuration, zeros[2];

/* The control transfer under way */
static const uint8_t *answer;
static uint32_t answer_left, answer_pid;
static bool answering, answer_ends_short, coding_comes;
static uint8_t new_address;

/* The data: what is under way, and the parity of the next packet */
static bool sending, listening, last_was_full;
static uint32_t in_pid, out_pid;

/* Hand a buffer to the controller; `AVAILABLE` has to come some cycles behind the rest (4.1.2.5.1). */
static void give(uint32_t buffer, uint32_t state)
{
    BUFFER(buffer) = state;
    __asm__ volatile("nop\n\tnop\n\tnop\n\tnop\n\tnop\n\tnop\n\t"
                     "nop\n\tnop\n\tnop\n\tnop\n\tnop\n\tnop");
    BUFFER(buffer) = state | AVAILABLE;
}

static void copy_in(uint32_t place, const uint8_t *data, uint32_t length)
{
    volatile uint8_t *to = MEMORY(place);
    while (length--)
        *to++ = *data++;
}

/* ---- data ---- */

static void send(void)
{
    const uint8_t *data;
    uint32_t length = 0;
    if (configuration == 0 || sending)
        return;
    while (length < PACKET) {
        uint32_t piece = tt_queue_piece(to_host, &data);
        if (piece == 0)
            break;
        if (piece > PACKET - length)
            piece = PACKET - length;
        copy_in(AT_DATA_IN + length, data, piece);
        tt_queue_drop(to_host, (uint16_t)piece);
        length += piece;
    }
    if (length == 0 && !last_was_full) /* a full packet at the end wants an empty one behind it */
        return;
    last_was_full = length == PACKET;
    sending = true;
    give(DATA_IN, FULL | in_pid | length);
    in_pid ^= DATA1;
}

static void listen(void)
{
    if (configuration == 0 || listening || tt_queue_room(from_host) < PACKET)
        return;
    listening = true;
    give(DATA_OUT, out_pid | PACKET);
    out_pid ^= DATA1;
}

static void take(void)
{
    uint8_t data[PACKET];
    uint32_t length = BUFFER(DATA_OUT) & LENGTH, k;
    for (k = 0; k < length && k < PACKET; k++)
        data[k] = MEMORY(AT_DATA_OUT)[k];
    (void)tt_queue_put(from_host, data, k);
    listening = false;
}

/* What waits for a host that is not there any more is old. */
static void discard(void)
{
    const uint8_t *data;
    uint16_t length;
    while ((length = tt_queue_piece(to_host, &data)) > 0)
        tt_queue_drop(to_host, length);
}

static void restart_data(void)
{
    BUFFER(DATA_IN) = 0;
    BUFFER(DATA_OUT) = 0;
    sending = listening = last_was_full = false;
    in_pid = out_pid = 0;
    discard();
}

/* ---- control ---- */

static void answer_more(void)
{
    uint32_t length = answer_left < PACKET ? answer_left : PACKET;
    copy_in(AT_CONTROL, answer, length);
    answer += length;
    answer_left -= length;
    if (length < PACKET)
        answer_ends_short = false; /* it does */
    give(CONTROL_IN, FULL | answer_pid | length);
    answer_pid ^= DATA1;
}

static void answer_with(const uint8_t *data, uint32_t length, uint32_t wanted)
{
    answer = data;
    answer_left = length < wanted ? length : wanted;
    answer_ends_short = length < wanted;
    answering = true;
    answer_more();
}

static void acknowledge(void)
{
    answering = false;
    give(CONTROL_IN, FULL | DATA1);
}

static void refuse(void)
{
    USB_STALL_ARM = 3u;
    BUFFER(CONTROL_IN) = STALL;
    BUFFER(CONTROL_OUT) = STALL;
}

static void describe_string(uint32_t number, uint32_t wanted)
{
    uint32_t length = 2;
    const char *text;
    if (number > STRING_SERIAL) {
        refuse();
        return;
    }
    if (number == STRING_LANGUAGE) {
        string_descriptor[length++] = 0x09; /* English, US */
        string_descriptor[length++] = 0x04;
    }
    for (text = strings[number]; *text && length < sizeof string_descriptor; text++) {
        string_descriptor[length++] = (uint8_t)*text;
        string_descriptor[length++] = 0;
    }
    string_descriptor[0] = (uint8_t)length;
    string_descriptor[1] = DESCRIBE_STRING;
    answer_with(string_descriptor, length, wanted);
}

static void describe(uint32_t kind, uint32_t number, uint32_t wanted)
{
    if (kind == DESCRIBE_DEVICE)
        answer_with(device_descriptor, sizeof device_descriptor, wanted);
    else if (kind == DESCRIBE_CONFIGURATION)
        answer_with(configuration_descriptor, sizeof configuration_descriptor, wanted);
    else if (kind == DESCRIBE_STRING)
        describe_string(number, wanted);
    else
        refuse();
}

static void obey_standard(uint32_t request, uint32_t value, uint32_t length)
{
    switch (request) {
    case GET_STATUS:
        answer_with(zeros, 2, length);
        break;
    case GET_DESCRIPTOR:
        describe(value >> 8, value & 0xFFu, length);
        break;
    case GET_CONFIGURATION:
        answer_with(&configuration, 1, length);
        break;
    case GET_INTERFACE:
        answer_with(zeros, 1, length);
        break;
    case SET_ADDRESS:
        new_address = (uint8_t)(value & 0x7Fu); /* holds behind the answer */
        acknowledge();
        break;
    case SET_CONFIGURATION:
        configuration = (uint8_t)value;
        restart_data();
        acknowledge();
        break;
    case CLEAR_FEATURE: /* the halt of an endpoint: its packets count from 0 again */
    case SET_INTERFACE:
        restart_data();
        acknowledge();
        break;
    default:
        refuse();
    }
}

static void obey_class(uint32_t request, uint32_t value, uint32_t length)
{
    if (request == GET_LINE_CODING) {
        answer_with(line_coding, LINE_CODING_SIZE, length);
    } else if (request == SET_LINE_CODING && length == LINE_CODING_SIZE) {
        coding_comes = true;
        give(CONTROL_OUT, DATA1 | PACKET);
    } else if (request == SET_LINE_STATE) {
        if (!(value & DTR))
            discard();
        acknowledge();
    } else if (request == SEND_BREAK) {
        acknowledge();
    } else {
        refuse();
    }
}

static void obey(void)
{
    uint32_t low = REGISTER(USB_MEMORY), high = REGISTER(USB_MEMORY + 4u);
    uint32_t request = low >> 8 & 0xFFu, value = low >> 16, length = high >> 16;
    answering = coding_comes = false;
    answer_pid = DATA1;
    if ((low & KIND) == 0u)
        obey_standard(request, value, length);
    else if ((low & KIND) == CLASS)
        obey_class(request, value, length);
    else
        refuse();
}

static void control_sent(void)
{
    if (new_address != 0) {
        USB_ADDRESS = new_address;
        new_address = 0;
    }
    if (!answering)
        return;
    if (answer_left > 0 || answer_ends_short)
        answer_more();
    else
        give(CONTROL_OUT, DATA1 | PACKET); /* the host acknowledges */
}

static void control_came(void)
{
    uint32_t k;
    if (!coding_comes)
        return;
    coding_comes = false;
    for (k = 0; k < LINE_CODING_SIZE; k++)
        line_coding[k] = MEMORY(AT_CONTROL)[k];
    acknowledge();
}

/* ---- the interrupt ---- */

static void begin_anew(void)
{
    uint32_t buffer;
    for (buffer = 0; buffer < BUFFERS; buffer++)
        BUFFER(buffer) = 0;
    USB_ADDRESS = 0;
    configuration = new_address = 0;
    restart_data();
}

void usb_interrupt(void)
{
    uint32_t status = USB_SIE_STATUS, done = USB_BUFF_STATUS;
    USB_BUFF_STATUS = done;
    if (status & USB_SIE_BUS_RESET) {
        USB_SIE_STATUS = USB_SIE_BUS_RESET;
        begin_anew();
    }
    if (done & 1u << CONTROL_IN)
        control_sent();
    if (done & 1u << CONTROL_OUT)
        control_came();
    if (status & USB_SIE_SETUP) {
        USB_SIE_STATUS = USB_SIE_SETUP;
        obey();
    }
    if (done & 1u << DATA_IN)
        sending = false;
    if (done & 1u << DATA_OUT)
        take();
    send();
    listen();
}

void usb_wake(void)
{
    NVIC_PEND(IRQ_USB);
}

void usb_start(struct tt_queue *received, struct tt_queue *sent, const char *product,
               const char *serial)
{
    uint32_t place;
    from_host = received;
    to_host = sent;
    strings[STRING_PRODUCT] = product;
    strings[STRING_SERIAL] = serial;
    for (place = 0; place < AT_CONTROL; place += 4u)
        REGISTER(USB_MEMORY + place) = 0;
    USB_MUXING = USB_MUXING_PHY;
    USB_POWER = USB_POWER_VBUS;
    USB_MAIN_CTRL = USB_MAIN_ENABLE;
    ENDPOINT(NOTICE_IN) = ENDPOINT_ON | INTERRUPT | AT_NOTICE;
    ENDPOINT(DATA_IN) = ENDPOINT_ON | BULK | AT_DATA_IN;
    ENDPOINT(DATA_OUT) = ENDPOINT_ON | BULK | AT_DATA_OUT;
    USB_INTE = USB_INTE_BUFFER | USB_INTE_BUS_RESET | USB_INTE_SETUP;
    NVIC_ENABLE(IRQ_USB);
    USB_SIE_CTRL = USB_SIE_EP0_INTERRUPTS | USB_SIE_PULLUP;
}
