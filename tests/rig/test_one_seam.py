"""Twisted's ports are opened at the seam to the hardware, and where simulated devices are served."""

import ast
from pathlib import Path

import cfid

PORTS = {"twisted.internet.serialport", "twisted.internet.udp", "twisted.internet.tcp", "twisted.internet.unix"}
OPENING = {"listenUDP", "listenTCP", "connectTCP", "addReader", "listenUNIX", "connectUNIX", "adoptStreamPort"}
SEAM = {"rig/hardware.py", "rig/ports.py"}
SERVING = {"sim/service.py"}


def opens_ports(source: str) -> bool:
    """Return whether a module imports Twisted's ports or has its loop open one."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module in PORTS:
            return True
        if isinstance(node, ast.Import) and any(name.name in PORTS for name in node.names):
            return True
        if isinstance(node, ast.Attribute) and node.attr in OPENING:
            return True
    return False


def test_no_other_module_opens_a_port() -> None:
    folder = Path(cfid.__file__).parent
    opening = {path.relative_to(folder).as_posix() for path in folder.rglob("*.py") if opens_ports(path.read_text())}

    assert opening == SEAM | SERVING
