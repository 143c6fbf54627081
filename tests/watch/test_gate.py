"""Which requests the server of the page answers, and from whom."""

import pytest

from cfid.watch.door import Gate

HOST = "127.0.0.1:5006"
OWN, OTHER = f"http://{HOST}", "http://evil.example"
TOKEN = "the gate's own"


@pytest.fixture
def gate() -> Gate:
    gate = Gate(5006)
    assert gate.token != Gate(5006).token
    gate.token = TOKEN
    return gate


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        ("/", {}),
        ("/", {"Host": "localhost:5006"}),
        ("/", {"Origin": "http://localhost:5006"}),
        ("/plots/ws", {"Origin": OWN}),
        *((path, {"Sec-Fetch-Site": site}) for path in ("/", "/facts", "/plots/x") for site in ("same-origin", "none")),
        ("/facts", {"X-Cfid-Token": TOKEN}),
    ],
)
def test_the_own_page_and_who_knows_its_token_are_let_in(gate: Gate, path: str, headers: dict[str, str]) -> None:
    assert gate.admits(path, {"Host": HOST, **headers})
    assert gate.refused == 0


@pytest.mark.parametrize(
    ("path", "headers"),
    [
        *(("/", {"Host": host}) for host in ("", "evil.example:5006", "127.0.0.1", "127.0.0.1:5007", f"{HOST}.evil")),
        *(("/", {"Origin": origin}) for origin in ("", "null", OTHER, "http://127.0.0.1:5007", f"https://{HOST}")),
        *((path, {"Sec-Fetch-Site": site}) for path in ("/", "/facts") for site in ("cross-site", "same-site", "")),
        *((path, {}) for path in ("/facts", "/page.js", "/plots/autoload.js")),
        *(("/facts", {"X-Cfid-Token": token}) for token in ("", "guessed", "\udcff", "ü")),
        ("/facts", {"X-Cfid-Token": TOKEN, "Origin": OTHER}),
        ("/facts", {"X-Cfid-Token": TOKEN, "Host": "evil.example:5006"}),
    ],
)
def test_all_others_are_refused_and_counted(gate: Gate, path: str, headers: dict[str, str]) -> None:
    assert not gate.admits(path, {"Host": HOST, **headers})
    assert gate.refused == 1


@pytest.mark.parametrize(
    "headers",
    [
        *({"Origin": origin} for origin in ("", "null", OTHER, "http://127.0.0.1:1")),
        *({"X-Cfid-Token": token} for token in ("", "guessed", "\udcff", "ü")),
        {"Host": "evil.example:5006"},
    ],
)
def test_a_stop_needs_host_origin_and_token_of_the_page(gate: Gate, headers: dict[str, str]) -> None:
    own = {"Host": HOST, "Origin": OWN, "X-Cfid-Token": TOKEN}
    assert gate.admits_stop(own)
    assert not gate.admits_stop({**own, **headers})
    assert gate.refused == 1
