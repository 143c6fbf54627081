"""Reads and sets the configuration of the load cell's box over HTTP, and takes single readings over TCP."""

import contextlib
import http.client
import socket
import threading
import time

from cfid.errors import DeviceError
from cfid.records.rig_file import LoadCellBox
from cfid.wire import netft, rdt

_TIME_OUT_S = 3.0  # without a byte
_LONGEST_S = 6.0  # for a page: one that trickles in would block a recording forever
_LONGEST_PAGE = 1 << 18
_BIAS_TRIES, _BIAS_TAKES_S = 3, 0.1
_BUFFERED_S = 0.02  # how long a box may keep records back to fill a datagram


def resolved(box: LoadCellBox) -> LoadCellBox:
    """Return the box with its numeric address, which is the source of its datagrams.

    Raises DeviceError when the address does not exist.
    """
    try:
        number = socket.gethostbyname(box.address) if box.address else ""
    except (OSError, UnicodeError):  # UnicodeError: not a name at all
        number = ""
    if not number:
        raise DeviceError(
            f"'{box.address}' is no address in this network: set devices.loadcell.address in rig.toml to the box' own, "
            f"{netft.DEFAULT_ADDRESS} as delivered."
        )
    return box.model_copy(update={"address": number})


def read_settings(box: LoadCellBox) -> netft.Settings:
    """Return the box' active configuration.

    Raises DeviceError when the box does not answer, or its page is invalid.
    """
    try:
        index = netft.active_configuration(_page(box, netft.configuration_query(0)))
        return netft.read_settings(_page(box, netft.configuration_query(index)))
    except ValueError as error:
        raise DeviceError(
            f"http://{box.address}:{box.http_port}{netft.CONFIGURATION_PATH}: {error}. Is {box.address} a Net F/T? "
            "Open its web page to see."
        ) from None


def set_rate(box: LoadCellBox, *, buffered: bool) -> netft.Settings:
    """Set the box' rate and its records per datagram; return its settings as read back.

    Raises DeviceError when the box keeps other settings.
    """
    size = buffer_size(box.rate_hz) if buffered else 1
    before = read_settings(box)
    if before.rate_hz == box.rate_hz and before.rdt_enabled and before.buffer_size == size:
        return before
    _page(box, netft.rate_query(rate_hz=box.rate_hz, buffer_size=size))
    after = read_settings(box)
    if not after.rdt_enabled:
        raise DeviceError(f"{box.address}: RDT is off and stays off: enable it on the box' web page, Communications.")
    if after.rate_hz != box.rate_hz or after.buffer_size != size:
        raise DeviceError(
            f"{box.address}: set to {box.rate_hz} Hz and {size} records a datagram, the box keeps "
            f"{after.rate_hz} Hz and {after.buffer_size}. Its rates are {netft.FASTEST_HZ}/n Hz: set "
            f"devices.loadcell.rate_hz in rig.toml to such a rate, {after.rate_hz} for instance."
        )
    return after


def take_bias(box: LoadCellBox) -> bool:
    """Bias the box to the present load; return whether its settings then show another bias than before.

    The box does not answer this request, which ends the stream: only the holder of the box may send it. Raises
    DeviceError when the box is out of reach.
    """
    before = read_settings(box).bias
    request = rdt.encode_request(rdt.Request(rdt.Command.BIAS))
    for _ in range(_BIAS_TRIES):
        try:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                sender.sendto(request, (box.address, box.rdt_port))
        except OSError as error:
            raise DeviceError(f"{box.address} UDP {box.rdt_port}: {_reason(error)}.") from None
        time.sleep(_BIAS_TAKES_S)
        if read_settings(box).bias != before:
            return True
    return False


def buffer_size(rate_hz: float) -> int:
    """Return how many records a datagram should hold, so that none waits long in the box."""
    return max(1, min(40, round(rate_hz * _BUFFERED_S)))


def read_once(box: LoadCellBox) -> netft.LoadReading:
    """Return a single reading over TCP. Raises DeviceError."""
    where = f"{box.address} TCP {box.tcp_port}"
    try:
        with socket.create_connection((box.address, box.tcp_port), timeout=_TIME_OUT_S) as connection:
            connection.sendall(netft.READ_FORCES)
            answer = b""
            while len(answer) < netft.READING_BYTES and (part := connection.recv(netft.READING_BYTES - len(answer))):
                answer += part
    except OSError as error:
        raise DeviceError(f"{where}: {_reason(error)}.") from None
    try:
        return netft.read_reading(answer)
    except ValueError as error:
        raise DeviceError(f"{where}: {error}.") from None


def _page(box: LoadCellBox, path: str) -> str:
    where = f"http://{box.address}:{box.http_port}"
    connection = http.client.HTTPConnection(box.address, box.http_port, timeout=_TIME_OUT_S)
    late = threading.Event()
    try:
        connection.connect()
        ending = threading.Timer(_LONGEST_S, _hang_up, (connection.sock, late))
        ending.start()
        try:
            connection.request("GET", path)
            answer = connection.getresponse()
            content = answer.read(_LONGEST_PAGE)
        finally:
            ending.cancel()
            ending.join()
    except (OSError, http.client.HTTPException) as error:
        if not late.is_set():
            raise DeviceError(
                f"{where}: {_reason(error)}. Is the box powered, and this computer in its network? "
                "See `cfid rig check`."
            ) from None
    finally:
        connection.close()
    if late.is_set():
        raise DeviceError(f"{where}: its page was not complete after {_LONGEST_S:g} s. See `cfid rig check`.")
    if answer.status != http.client.OK:
        raise DeviceError(
            f"{where}{path}: answers {answer.status} {answer.reason[:40]}, where a Net F/T has its settings: another "
            "device."
        )
    return content.decode("utf-8", "replace")


def _hang_up(connection: socket.socket, late: threading.Event) -> None:
    """End a connection on which bytes keep arriving, each before its time-out."""
    late.set()
    with contextlib.suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


def _reason(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return f"no answer within {_TIME_OUT_S:g} s"
    if isinstance(error, ConnectionRefusedError):
        return "no program listens there (connection refused)"
    if isinstance(error, http.client.HTTPException) and not isinstance(error, OSError):
        return "the device that answers there does not speak HTTP: it is another one"
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
