"""The page of cheap instruments: its tables are valid, and its sketch sends the lines that they describe."""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from cfid.records.rig_file import Devices
from tests.lab import ROOT

TEXT = (ROOT / "docs" / "how-to" / "cheap-instruments.md").read_text(encoding="utf-8")
TABLES = re.findall(r"```toml\n(.*?)```", TEXT, re.DOTALL)
SKETCH = re.findall(r"```cpp\n(.*?)```", TEXT, re.DOTALL)

# A board whose encoder reads 0x0ABC and whose amplifier reads -2; `micros` advances by 1 ms per call.
BOARD = """
#include <cstdio>
typedef unsigned char byte;
enum { LOW, HIGH, INPUT, OUTPUT };
static unsigned long now_us = 4294000000UL;
static int pulses = 0;
static unsigned long micros() { return (now_us += 1000) & 0xFFFFFFFFUL; }
static void noInterrupts() { pulses = 0; }
static void interrupts() {}
static void delayMicroseconds(int) {}
static void pinMode(int, int) {}
static void digitalWrite(int, int level) { pulses += level == HIGH; }
static int digitalRead(int) { return pulses == 0 ? LOW : pulses <= 24 ? (0xFFFFFE >> (24 - pulses) & 1) : LOW; }
struct {
  void begin(long) {}
  void print(const char *s) { printf("%s", s); }
  void println(const char *s) { printf("%s\\r\\n", s); }
} Serial;
struct {
  int place = 0;
  void begin() {} void setClock(long) {} void beginTransmission(int) {} void write(int) {}
  int endTransmission(bool) { return 0; }
  int requestFrom(int, int count) { place = 0; return count; }
  int read() { return place++ ? 0xBC : 0xFA; }
} Wire;
"""


@pytest.mark.parametrize("text", TABLES)
def test_its_tables_of_rig_toml_are_valid(text: str) -> None:
    devices = Devices.model_validate(tomllib.loads(text)["devices"])

    instruments = (devices.encoder, devices.loadcell, devices.tachometer, devices.scales)
    assert "lines" in {one.kind for one in instruments if one}


def test_its_pattern_reads_what_its_scales_send() -> None:
    (text,) = (text for text in TABLES if "pattern" in text and "devices.loadcell" in text)
    (sent,) = re.findall(r"scales that send `(.*?)`", TEXT)
    device = Devices.model_validate(tomllib.loads(text)["devices"]).loadcell
    assert device.kind == "lines"

    assert device.reader().feed(b"\n" + sent.encode() + b"\r\n") == [(123.4,)]


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
def test_its_sketch_sends_lines_that_its_table_describes(tmp_path: Path) -> None:
    (sketch,) = SKETCH
    (tmp_path / "Wire.h").write_text("")
    (tmp_path / "board.cpp").write_text(
        f"{BOARD}{sketch}\nint main() {{ setup(); while (now_us < 4295500000UL) loop(); }}"
    )
    program = tmp_path / "board"
    subprocess.run(["g++", "-Wall", "-I", tmp_path, tmp_path / "board.cpp", "-o", program], check=True)
    sent = subprocess.run([program], capture_output=True, check=True).stdout
    table = next(text for text in TABLES if "counts_per_turn" in text)
    device = Devices.model_validate(tomllib.loads(table)["devices"]).encoder
    assert device.kind == "lines"
    reader = device.reader()
    readings = reader.feed(b"\n" + sent)

    assert len(readings) > 100
    assert reader.rejected == 0
    assert {angle for _, angle in readings} == {0xABC}
    assert b",2748,-2*" in sent
