"""A Modbus TCP terminal of few lines, with faults: every byte of its replies can be changed."""

import contextlib
import socket
import struct
import threading
import time


class FaultyTerminal:
    """Registers of a terminal; `fault` may change, delay or drop the reply to a request.

    Parameters
    ----------
    fault
        Takes the function code, the address and the reply of the protocol [bytes]; returns the reply, or None for none.

    Attributes
    ----------
    registers
        Holding and input registers, at the same addresses; a refused write leaves them.
    heard
        Times of all requests [s].
    """

    def __init__(self, fault=lambda function, address, reply: reply):
        self.registers, self.fault, self.heard = [0] * 64, fault, []
        self.refused, self.unreadable = set(), set()  # addresses, or an address with the word that is refused there
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port, self.running = self.listener.getsockname()[1], True
        threading.Thread(target=self.serve, daemon=True).start()

    def serve(self):
        with contextlib.suppress(OSError):
            while self.running:
                line, _ = self.listener.accept()
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                threading.Thread(target=self.talk, args=(line,), daemon=True).start()

    def talk(self, line):
        received = b""
        with contextlib.suppress(OSError), line:
            while data := line.recv(4096):
                received += data
                while len(received) >= 6 and len(received) >= 6 + struct.unpack_from(">H", received, 4)[0]:
                    size = 6 + struct.unpack_from(">H", received, 4)[0]
                    request, received = received[:size], received[size:]
                    self.heard.append(time.monotonic())
                    function, address, reply = self.answered(request[7:])
                    reply = self.fault(function, address, reply)
                    if reply is not None:
                        line.sendall(request[:4] + struct.pack(">HB", len(reply) + 1, request[6]) + reply)

    def answered(self, request):
        function, address, count = struct.unpack_from(">BHH", request)
        words = struct.unpack_from(f">{count}H", request, 6) if function == 16 else ()
        if {address, (address, *words)} & (self.refused if function == 16 else self.unreadable):
            return function, address, bytes([function | 0x80, 4])
        if function == 16:
            self.registers[address : address + count] = words
            return function, address, request[:5]
        words = self.registers[address : address + count]
        return function, address, struct.pack(f">BB{count}H", function, 2 * count, *words)

    def close(self):
        self.running = False
        self.listener.close()
