"""Reads pcapng files with an independent reader: tshark, of Wireshark."""

import json
import shutil
import subprocess


def packets(path):
    """The packets of a file, from tshark's JSON; tshark verifies the checksums."""
    if shutil.which("tshark") is None:
        raise AssertionError("there is no tshark: apt-get install tshark")
    done = subprocess.run(
        [
            "tshark", "-r", str(path), "-T", "json",
            "-o", "ip.check_checksum:TRUE", "-o", "udp.check_checksum:TRUE",
        ],
        capture_output=True, text=True, timeout=50,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    complaints = [line for line in done.stderr.splitlines() if "Running as user" not in line]
    assert not complaints, done.stderr
    return [Packet(packet["_source"]["layers"]) for packet in json.loads(done.stdout)]


class Packet:
    """The fields of a packet that the tests use."""

    def __init__(self, layers):
        frame, udp = layers["frame"], layers["udp"]
        ip = layers.get("ip") or layers["ipv6"]
        prefix = "ip" if "ip" in layers else "ipv6"
        self.source = ip[f"{prefix}.src"], int(udp["udp.srcport"])
        self.destination = ip[f"{prefix}.dst"], int(udp["udp.dstport"])
        self.payload = bytes.fromhex(layers["udp"]["udp.payload"].replace(":", ""))
        self.checksums_good = udp["udp.checksum.status"] == "1" and (
            prefix == "ipv6" or ip["ip.checksum.status"] == "1"
        )
        self.time = frame["frame.time_epoch"]
        self.interface = frame["frame.interface_id_tree"]["frame.interface_name"]
        self.comment = find(layers, "frame.comment")
        self.outbound = find(layers, "frame.packet_flags_direction") in ("2", "0x00000002")


def find(tree, name):
    """The first value of that name, at any depth."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            if key == name:
                return value
            result = find(value, name)
            if result is not None:
                return result
    elif isinstance(tree, list):
        for value in tree:
            result = find(value, name)
            if result is not None:
                return result
    return None


def matching(path, display_filter):
    """The lines of the packets that a display filter selects."""
    if shutil.which("tshark") is None:
        raise AssertionError("there is no tshark: apt-get install tshark")
    done = subprocess.run(
        ["tshark", "-r", str(path), "-Y", display_filter],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()
