"""A page of the box that never ends is abandoned in time, whichever part of the page never ends."""

import socket
import threading
import time
from collections.abc import Iterator

import pytest

from cfid.errors import DeviceError
from cfid.records.rig_file import LoadCellBox
from cfid.rig.box import read_settings


@pytest.fixture
def dripping(request: pytest.FixtureRequest) -> Iterator[LoadCellBox]:
    """Serve the beginning of a page, and then a byte twice a second."""
    ended = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            client, _ = server.accept()
            with client:
                client.recv(4096)
                try:
                    client.sendall(request.param)
                    while not ended.wait(0.5):
                        client.sendall(b"a")
                except OSError:
                    return

        thread = threading.Thread(target=serve)
        thread.start()
        yield LoadCellBox(address="127.0.0.1", http_port=server.getsockname()[1])
        ended.set()
        thread.join()


@pytest.mark.parametrize(
    "dripping",
    [b"HTTP/1.1 200 OK\r\nX: ", b"HTTP/1.1 200 OK\r\n\r\n<a>", b"HTTP/1.1 200 OK\r\nContent-Length: 9999\r\n\r\n"],
    indirect=True,
    ids=["in its head", "without length", "with length"],
)
def test_a_page_that_drips_is_given_up_after_six_seconds(dripping: LoadCellBox) -> None:
    begun_s = time.monotonic()
    with pytest.raises(DeviceError, match="not complete after 6 s"):
        read_settings(dripping)

    assert time.monotonic() - begun_s < 9
