"""The codec in Python and in C: they agree on every line, and lose no message but those that were damaged."""

import subprocess

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mckibben import serial_protocol as wire
from mckibben.codegen.native import compiler
from mckibben.errors import ParameterError, RigError
from mckibben.export.firmware import link_files

PROGRAM = r"""
#include "link.h"
#include <stdio.h>
int main(void) /* writes the messages of a line again, and the counters after them */
{
    static link_receiver receiver;
    static link_message message;
    uint8_t line[LINK_FRAME];
    int byte;
    while ((byte = getchar()) != EOF)
        if (link_receive(&receiver, (uint8_t)byte, &message))
            fwrite(line, 1, link_encode(&message, line), stdout);
    fprintf(stderr, "%u %u %u", receiver.corrupted, receiver.lost, receiver.repeated);
    return 0;
}
"""
MESSAGES = st.builds(
    wire.Message,
    st.integers(0, 255),
    st.integers(0, 0xFFFF),
    st.integers(0, 0xFFFFFFFF),
    st.binary(max_size=600)
    | st.integers(0, wire.LONGEST).map(bytes)
    | st.builds(lambda size, end: b"\1" * size + end, st.integers(230, wire.LONGEST - 4), st.binary(max_size=4)),
)


@pytest.fixture(scope="session")
def in_c(tmp_path_factory):
    """Messages and counters by the codec in C."""
    if compiler() is None:
        pytest.skip("there is no C compiler")
    folder = tmp_path_factory.mktemp("link")
    for name, text in {**link_files(), "main.c": PROGRAM}.items():
        (folder / name).write_text(text)
    strict = "-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Werror -fsanitize=address,undefined".split()
    subprocess.run([compiler(), *strict, "-o", "link", "link.c", "main.c"], cwd=folder, check=True)

    def received(line):
        done = subprocess.run([folder / "link"], input=line, capture_output=True, check=True)
        return done.stdout, tuple(map(int, done.stderr.split()))

    return received


def in_python(line, pieces=()):
    receiver, messages, start = wire.Receiver(), [], 0
    for end in sorted({*pieces, len(line)}):
        messages += receiver.feed(line[start:end])
        start = end
    return messages, (receiver.corrupted, receiver.lost & 0xFFFF, receiver.repeated)


@given(message=MESSAGES)
def test_a_message_comes_back(in_c, message):
    line = message.encode()
    assert line.index(0) == len(line) - 1
    assert in_python(line)[0] == [message]
    assert in_c(line) == (line, (0, 0, 0))


@given(
    messages=st.lists(MESSAGES, max_size=6),
    damage=st.lists(st.tuples(st.integers(0, 2), st.integers(0, 1000), st.integers(0, 255)), max_size=4),
)
def test_both_agree_on_a_damaged_line(in_c, messages, damage):
    line = bytearray(b"".join(message.encode() for message in messages))
    for kind, place, byte in damage:
        at = place % (len(line) + 1)
        line[at : at + (kind > 0)] = b"" if kind == 2 else bytes([byte])
    line = bytes(line)
    found, counters = in_python(line, [place for _, place, _ in damage if place < len(line)])
    assert in_c(line) == (b"".join(message.encode() for message in found), counters)
    assert set(found) <= set(messages)  # no damage of four bytes passed the CRC


@given(lost=st.sets(st.integers(1, 19)), doubled=st.sets(st.integers(0, 19)))
def test_losses_are_counted(in_c, lost, doubled):
    sent = [wire.Message(wire.MessageKind.SAMPLE, (65530 + i) & 0xFFFF, 1000 * i, bytes([i])) for i in range(20)] + [
        wire.Message(wire.MessageKind.SAMPLE, 14, 0)
    ]
    line = b"".join(x.encode() * (1 + (i in doubled)) for i, x in enumerate(sent) if i not in lost)
    counters = (0, len(lost), len(doubled - lost))
    found, counted = in_python(line)
    assert (len(found), counted) == (21 - len(lost), counters)
    assert in_c(line)[1] == counters


def test_a_board_that_starts_again_has_lost_nothing(in_c):
    line = b"".join(
        wire.Message(kind, n, n).encode()
        for kind, n in ((wire.MessageKind.SAMPLE, 900), (wire.MessageKind.HELLO, 0), (wire.MessageKind.SAMPLE, 1))
    )
    assert in_python(line)[1] == in_c(line)[1] == (0, 0, 0)


def test_what_was_overtaken_or_replayed_is_dropped_but_for_a_vent(in_c):
    sent = [wire.Message(wire.MessageKind.COMMAND, n & 0xFFFF, n) for n in (65535, 65537, 65536, 65538, 65530)]
    sent.append(wire.Message(wire.MessageKind.VENT, 65531, 65531))
    line = b"".join(message.encode() for message in sent)
    messages, counters = in_python(line)
    assert [message.sequence for message in messages] == [65535, 1, 2, 65531]
    assert counters == (0, 1, 2)
    assert in_c(line) == (b"".join(message.encode() for message in messages), counters)


def test_a_line_without_end_takes_no_memory(in_c):
    receiver = wire.Receiver()
    for _ in range(1000):
        assert receiver.feed(b"\1" * 1000) == []
    assert len(receiver._rest) < wire.LONGEST + 100
    good = wire.Message(wire.MessageKind.VENT, 3, 4)
    assert receiver.feed(b"\0" + good.encode()) == [good]
    assert in_c(b"\1" * 1000 + b"\0" + good.encode()) == (good.encode(), (1, 0, 0))


def test_the_crc_is_that_of_the_standard():
    """CRC-16/CCITT-FALSE of 123456789 is 0x29B1, in any catalogue of CRCs."""
    kind, sequence, time = 0x31, 0x3332, 0x37363534
    assert b"\xb1\x29" in wire.Message(kind, sequence, time, b"89").encode()


def test_bodies_come_back():
    hello = wire.Hello(
        "knee 1.0", 1000, bytes(range(32)), [("angle", "rad"), ("p", "Pa")], [("u", "Pa")], [("K", "N*m/rad")]
    )
    assert wire.Hello.unpack(hello.pack()[0]) == hello
    sample = wire.Sample(wire.FirmwareState.HOLDING, wire.FaultCode.FROZEN, 3, 2, 1, 9, (0.5, 2.0**18))
    assert wire.Sample.unpack(sample.pack()) == sample
    assert wire.FaultReport.unpack(wire.FaultReport(wire.FaultCode.OUT_OF_RANGE, 2, -0.5).pack()) == (
        wire.FaultCode.OUT_OF_RANGE,
        2,
        -0.5,
    )
    assert wire.unpack_numbers(wire.pack_numbers((0.1, 15.0))) == (0.1, 15.0)


@pytest.mark.parametrize(
    ("unpack", "body", "field"),
    [
        (wire.Hello.unpack, b"", "version"),
        (wire.Hello.unpack, bytes([wire.VERSION + 1]) + bytes(50), "version"),
        (wire.Hello.unpack, bytes([2]) + bytes(50), "version"),  # a board of mckibben before frames of several blocks
        (wire.Hello.unpack, bytes([wire.VERSION]) + bytes(10), "body"),
        (wire.Hello.unpack, bytes([wire.VERSION, 2]) + bytes(38) + b"knee\nangle rad", "body"),
        (wire.Sample.unpack, b"\0", "body"),
        (wire.Sample.unpack, bytes(11), "body"),
        (wire.FaultReport.unpack, b"\0", "body"),
    ],
)
def test_a_malformed_body_is_an_error(unpack, body, field):
    with pytest.raises(RigError) as caught:
        unpack(body)
    assert caught.value.field == field


def test_a_body_that_is_too_long_is_refused():
    with pytest.raises(ParameterError) as caught:
        wire.Message(wire.MessageKind.HELLO, 0, 0, bytes(wire.LONGEST + 1)).encode()
    assert (caught.value.field, caught.value.value) == ("body", wire.LONGEST + 1)


def test_a_description_and_a_sample_have_as_many_channels_as_can_be_counted():
    channels = [(f"channel {number}", "Pa") for number in range(wire.MOST_CHANNELS)]
    hello = wire.Hello("board", 2000, bytes(32), channels, channels, channels)
    assert wire.Hello.unpack(*hello.pack()) == hello
    sample = wire.Sample(0, 0, 0, 0, 0, 0, (1.0,) * 2 * wire.MOST_CHANNELS)
    (message,), _ = in_python(wire.Message(wire.MessageKind.SAMPLE, 1, 0, sample.pack()).encode())
    assert wire.Sample.unpack(message.body) == sample
    with pytest.raises(ParameterError) as caught:
        hello._replace(commands=[*channels, ("one more", "Pa")]).pack()
    assert (caught.value.field, caught.value.value, caught.value.upper) == ("channels", 256, 255)
