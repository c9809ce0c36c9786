#include "link.h"

#include <string.h>

enum { HEADER = 7, FULL = 255 };

static uint16_t crc(const uint8_t *data, size_t size) /* CRC-16/CCITT-FALSE */
{
    uint16_t sum = 0xFFFF;
    size_t i;
    int bit;
    for (i = 0; i < size; ++i) {
        sum = (uint16_t)(sum ^ (uint16_t)(data[i] << 8));
        for (bit = 0; bit < 8; ++bit)
            sum = (uint16_t)(sum & 0x8000 ? (sum << 1) ^ 0x1021 : sum << 1);
    }
    return sum;
}

static uint32_t get(const uint8_t *from, int bytes)
{
    uint32_t number = 0;
    while (bytes-- > 0)
        number = number << 8 | from[bytes];
    return number;
}

static void put(uint8_t *to, uint32_t number, int bytes)
{
    int i;
    for (i = 0; i < bytes; ++i, number >>= 8)
        to[i] = (uint8_t)(number & 0xFF);
}

void link_put16(uint8_t *to, uint16_t number) { put(to, number, 2); }

void link_put_float(uint8_t *to, float number)
{
    uint32_t bits;
    memcpy(&bits, &number, sizeof bits);
    put(to, bits, 4);
}

float link_float(const uint8_t *from)
{
    const uint32_t bits = get(from, 4);
    float number;
    memcpy(&number, &bits, sizeof number);
    return number;
}

double link_double(const uint8_t *from)
{
    const uint64_t bits = (uint64_t)get(from + 4, 4) << 32 | get(from, 4);
    double number;
    memcpy(&number, &bits, sizeof number);
    return number;
}

size_t link_encode(const link_message *message, uint8_t *to)
{
    uint8_t data[HEADER + LINK_LONGEST + 2];
    const size_t body = message->size <= LINK_LONGEST ? message->size : LINK_LONGEST, size = HEADER + body;
    size_t i, start = 0, end = 1;
    data[0] = message->kind;
    put(data + 1, message->sequence, 2);
    put(data + 3, message->time, 4);
    memcpy(data + HEADER, message->body, body);
    put(data + size, crc(data, size), 2);
    for (i = 0; i < size + 2; ++i) {
        if (data[i])
            to[end++] = data[i];
        if (!data[i] || end - start == FULL) { /* a full block ends without a zero */
            to[start] = (uint8_t)(end - start);
            start = end++;
        }
    }
    to[start] = (uint8_t)(end - start);
    to[end] = 0;
    return end + 1;
}

static bool complete(link_receiver *self, link_message *message) /* the frame in `data` */
{
    const size_t size = self->size - 2; /* of header and body */
    uint16_t ahead;
    bool anew;
    if (self->bad || self->left || self->size < HEADER + 2 || size > HEADER + LINK_LONGEST ||
        crc(self->data, size) != get(self->data + size, 2)) {
        ++self->corrupted;
        return false;
    }
    message->kind = self->data[0];
    message->sequence = (uint16_t)get(self->data + 1, 2);
    message->time = get(self->data + 3, 4);
    message->size = (uint16_t)(size - HEADER);
    memcpy(message->body, self->data + HEADER, message->size);
    ahead = (uint16_t)(message->sequence - self->last);
    anew = message->kind == KIND_HELLO || message->kind == KIND_VENT; /* with any number: a vent is never too late */
    if (self->begun && ((ahead == 0 && message->time == self->last_time) || (!anew && (ahead == 0 || ahead > 0x7FFF)))) {
        ++self->repeated;
        return false;
    }
    if (self->begun && !anew)
        self->lost = (uint16_t)(self->lost + ahead - 1);
    self->begun = true;
    self->last = message->sequence;
    self->last_time = message->time;
    return true;
}

static void append(link_receiver *self, uint8_t byte)
{
    if (self->size < sizeof self->data)
        self->data[self->size++] = byte;
    else
        self->bad = true;
}

bool link_receive(link_receiver *self, uint8_t byte, link_message *message)
{
    bool valid = false;
    if (!byte) {
        if (self->code)
            valid = complete(self, message);
        self->size = self->left = self->code = 0;
        self->bad = false;
    } else if (self->left) {
        append(self, byte);
        --self->left;
    } else {
        if (self->code && self->code != FULL)
            append(self, 0);
        self->code = byte;
        self->left = (uint8_t)(byte - 1);
    }
    return valid;
}
