"""Which requests the server of the page answers, and from whom."""

import pytest

from cfid.watch.gate import Gate

OWN = {"Host": "127.0.0.1:5006"}


@pytest.fixture
def gate() -> Gate:
    return Gate(5006)


@pytest.mark.parametrize(
    "headers",
    [
        OWN,
        {"Host": "localhost:5006"},
        {**OWN, "Origin": "http://127.0.0.1:5006"},
        {**OWN, "Origin": "http://localhost:5006"},
    ],
)
def test_the_own_page_is_let_in(gate: Gate, headers: dict[str, str]) -> None:
    assert gate.admits("/", headers)
    assert gate.refused == 0


@pytest.mark.parametrize("origin", ["http://127.0.0.1:5006", "http://localhost:5006"])
def test_what_states_the_origin_of_the_page_is_let_in(gate: Gate, origin: str) -> None:
    assert gate.admits("/plots/ws", {**OWN, "Origin": origin})


@pytest.mark.parametrize("path", ["/", "/facts", "/plots/autoload.js"])
@pytest.mark.parametrize("site", ["same-origin", "none"])
def test_what_a_browser_loads_for_the_page_is_let_in(gate: Gate, path: str, site: str) -> None:
    assert gate.admits(path, {**OWN, "Sec-Fetch-Site": site})


@pytest.mark.parametrize("path", ["/", "/facts", "/plots/autoload.js"])
@pytest.mark.parametrize("site", ["cross-site", "same-site", ""])
def test_what_another_page_loads_is_refused(gate: Gate, path: str, site: str) -> None:
    assert not gate.admits(path, {**OWN, "Sec-Fetch-Site": site})
    assert gate.refused == 1


@pytest.mark.parametrize("path", ["/facts", "/page.js", "/plots/autoload.js"])
def test_a_program_needs_the_token_for_all_but_the_page(gate: Gate, path: str) -> None:
    assert not gate.admits(path, OWN)
    assert not gate.admits(path, {**OWN, "X-Cfid-Token": "guessed"})
    assert gate.admits(path, {**OWN, "X-Cfid-Token": gate.token})
    assert not gate.admits(path, {**OWN, "X-Cfid-Token": gate.token, "Origin": "http://evil.example"})


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Host": "evil.example:5006"},
        {"Host": "127.0.0.1"},
        {"Host": "127.0.0.1:5007"},
        {"Host": "127.0.0.1:5006.evil.example"},
        {**OWN, "Origin": "http://evil.example"},
        {**OWN, "Origin": "http://127.0.0.1:5007"},
        {**OWN, "Origin": "https://127.0.0.1:5006"},
        {**OWN, "Origin": "null"},
        {**OWN, "Origin": ""},
    ],
)
def test_other_names_and_other_pages_are_refused_and_counted(gate: Gate, headers: dict[str, str]) -> None:
    assert not gate.admits("/", headers)
    assert gate.refused == 1


@pytest.mark.parametrize("origin", ["", "null", "http://evil.example", "http://127.0.0.1:1"])
def test_a_stop_needs_the_origin_of_the_page(gate: Gate, origin: str) -> None:
    assert not gate.admits_stop({**OWN, "Origin": origin, "X-Cfid-Token": gate.token})
    assert gate.refused == 1


@pytest.mark.parametrize("token", ["", "guessed", "\udcff", "ü"])
def test_a_stop_needs_the_token_of_the_page(gate: Gate, token: str) -> None:
    headers = {**OWN, "Origin": "http://127.0.0.1:5006"}
    assert not gate.admits_stop({**headers, "X-Cfid-Token": token})
    assert gate.admits_stop({**headers, "X-Cfid-Token": gate.token})
    assert gate.refused == 1


def test_every_server_has_a_token_of_its_own() -> None:
    assert Gate(1).token != Gate(1).token
