"""What an independent reader finds in a pcapng file: tshark, of Wireshark."""

import json
import shutil
import subprocess


def packets(path):
    """Each packet as tshark's JSON has it, by protocol; checksums are verified."""
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
    complaints = [it for it in done.stderr.splitlines() if "Running as user" not in it]
    assert not complaints, done.stderr
    return [Packet(it["_source"]["layers"]) for it in json.loads(done.stdout)]


class Packet:
    """One packet, as far as it matters here."""

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
    """The first value of that name, however deep."""
    if isinstance(tree, dict):
        for key, value in tree.items():
            if key == name:
                return value
            found = find(value, name)
            if found is not None:
                return found
    elif isinstance(tree, list):
        for value in tree:
            found = find(value, name)
            if found is not None:
                return found
    return None
