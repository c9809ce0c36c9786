/* Messages on a serial line (docs/serial-protocol.md), written by mckibben ${version}. No allocation, no recursion. */
#ifndef LINK_H
#define LINK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { LINK_VERSION = ${protocol}, LINK_LONGEST = ${longest}, LINK_FRAME = LINK_LONGEST + LINK_LONGEST / 254 + 12 };
<% for enum in enums %>
enum {
<% for member in enum.members %>
    ${enum.prefix}_${member.name} = ${member.value},
<% endfor %>
};
<% endfor %>

typedef struct {
    uint8_t kind;
    uint16_t size, sequence; /* size of the body */
    uint32_t time; /* us, of the sender */
    uint8_t body[LINK_LONGEST];
} link_message;

typedef struct {
    uint8_t data[LINK_FRAME]; /* of the frame so far, unstuffed */
    size_t size;
    uint8_t left, code; /* bytes left in this block, and its length */
    bool bad, begun;
    uint16_t last, corrupted, lost, repeated;
    uint32_t last_time;
} link_receiver;

/* Bytes of a message on the line in `to`, which has LINK_FRAME bytes; returns their number. */
size_t link_encode(const link_message *message, uint8_t *to);

/* One byte from the line; true if it ends a valid message, which is then in `message`. */
bool link_receive(link_receiver *self, uint8_t byte, link_message *message);

/* Numbers in a body: 16-bit, 32-bit and 64-bit, little-endian. */
void link_put16(uint8_t *to, uint16_t number);
void link_put_float(uint8_t *to, float number);
float link_float(const uint8_t *from);
double link_double(const uint8_t *from);

#ifdef __cplusplus
}
#endif

#endif
