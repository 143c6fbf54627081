"""Resolves a device's address into one spelling, so that two spellings of it are not two devices."""

import os
import socket
from urllib.parse import urlsplit

_DEFAULT_CHANNEL, _DEFAULT_RATE, _DEFAULT_ADDRESS = "2", "2M", "E7E7E7E7E7"
_RATES = ("250K", "1M", "2M")


def resolved(device: str) -> str:
    """Return the address of a vehicle or the path of a port as the kernel or cflib resolves it.

    Anything else, and an address that cannot be resolved, is returned unchanged.
    """
    scheme, separator, rest = device.partition("://")
    try:
        if separator and scheme == "udp":
            return _udp(device)
        if separator and scheme == "radio":
            return _radio(device)
        if separator and scheme == "usb":
            return f"usb://{int(rest)}"
    except (OSError, ValueError):
        return device
    return os.path.realpath(device) if device.startswith("/") else device


def _udp(device: str) -> str:
    """Return the address that the kernel would connect to: `localhost`, `127.1` and `0.0.0.0` are all 127.0.0.1."""
    where = urlsplit(device)
    with socket.socket(type=socket.SOCK_DGRAM) as probe:
        probe.connect((where.hostname or "", where.port or 0))
        host, port = probe.getpeername()
    return f"udp://{host}:{port}"


def _radio(device: str) -> str:
    """Fill in cflib's defaults, channel 2, 2 Mbit/s, address E7E7E7E7E7, and drop the query, which locates nothing."""
    where = urlsplit(device)
    channel, rate, address, *_ = [*where.path.strip("/").split("/"), "", "", ""]
    dongle = str(int(where.netloc)) if where.netloc.isdigit() else where.netloc.upper()
    return (
        f"radio://{dongle}/{int(channel or _DEFAULT_CHANNEL)}/{rate if rate in _RATES else _DEFAULT_RATE}/"
        f"{(address or _DEFAULT_ADDRESS).upper():0>10}"
    )
