"""Records the datagrams of the rtps middleware's sockets as pcap, for tshark."""

import struct

from uros.middleware.rtps.udp import DomainSockets

LINKTYPE_RAW = 101
LOOPBACK = b"\x7f\0\0\1"
PORT = 7400


class RtpsCapture:
    """The datagrams that all participants of this process have sent and received.

    Args:
        monkeypatch: Undoes the recording at the end of the test.
        drop_every: One of so many datagrams that are sent is lost; 0: none.
    """

    def __init__(self, monkeypatch, drop_every=0):
        self.datagrams = []
        sent = 0
        send, receive = DomainSockets.send, DomainSockets.receive

        def recording_send(sockets, datagram, place):
            nonlocal sent
            self.datagrams.append(bytes(datagram))
            sent += 1
            if drop_every and sent % drop_every == 0:
                return True
            return send(sockets, datagram, place)

        def recording_receive(sockets, fileno):
            for datagram, source in receive(sockets, fileno):
                self.datagrams.append(bytes(datagram))
                yield datagram, source

        monkeypatch.setattr(DomainSockets, "send", recording_send)
        monkeypatch.setattr(DomainSockets, "receive", recording_receive)

    def write(self, path):
        """Write a file of UDP packets; they carry no times and no real addresses."""
        with open(path, "wb") as file:
            file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 0x40000, LINKTYPE_RAW))
            for datagram in self.datagrams:
                udp = struct.pack(">HHHH", PORT, PORT, 8 + len(datagram), 0) + datagram
                head = struct.pack(">BBHIBBH", 0x45, 0, 20 + len(udp), 0, 64, 17, 0)
                packet = head + LOOPBACK + LOOPBACK + udp
                file.write(struct.pack("<IIII", 0, 0, len(packet), len(packet)) + packet)
