"""The page around the plots: it has no inline script, so that its policy can forbid all of them."""

from html import escape

from cfid.watch.gate import Gate

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>cfid watch</title>
<style>
:root { color-scheme: light dark; --page: #fbfbf9; --text: #1f2328; }
@media (prefers-color-scheme: dark) { :root { --page: #14171b; --text: #d8dce1; } }
body { margin: 0; background: var(--page); color: var(--text); font: 14px system-ui, sans-serif; }
header { position: sticky; top: 0; z-index: 9; display: flex; flex-wrap: wrap; gap: 8px 16px; align-items: center;
  padding: 8px 12px; background: var(--page); border-bottom: 1px solid currentColor; }
h1 { font-size: 16px; margin: 0; }
#stop { font: 700 16px system-ui, sans-serif; padding: 10px 22px; border: 0; border-radius: 6px;
  background: #b3161b; color: #fff; cursor: pointer; }
#answered { white-space: pre-wrap; overflow-wrap: anywhere; }
main { padding: 8px 12px; }
table { border-collapse: collapse; font-size: 13px; width: 100%; margin-bottom: 6px; }
th { text-align: left; font-weight: 600; padding: 1px 12px 1px 0; vertical-align: top; white-space: nowrap; }
td { padding: 1px 0; width: 100%; overflow-wrap: anywhere; }
.warning { font-weight: 700; text-decoration: underline; }
</style>
</head>
<body>
<header><h1>cfid watch</h1><button id="stop" data-token="TOKEN">Stop all motors</button>
<span id="answered" role="status"></span></header>
<main><div id="facts"></div><div id="plots"></div></main>
<script src="/page.js"></script>
</body>
</html>
"""

SCRIPT = """"use strict";
const dark = matchMedia("(prefers-color-scheme: dark)");
const plots = document.createElement("script");
plots.id = "plots-script";
plots.src = "/plots/autoload.js?bokeh-autoload-element=plots-script&bokeh-app-path=/plots&dark=" + Number(dark.matches);
document.getElementById("plots").append(plots);
dark.addEventListener("change", () => location.reload());

// Answers each picture once it is drawn, so that the next ones are sent.
const waiting = setInterval(() => {
  const time = window.Bokeh?.documents[0]?.get_model_by_name("time");
  if (!time) return;
  clearInterval(waiting);
  const answer = () => {
    const [word, count] = time.tags;
    if (word === "sent") requestAnimationFrame(() => setTimeout(() => { time.tags = ["drawn", count]; }));
  };
  time.properties.tags.change.connect(answer);
  answer();
}, 50);

const facts = document.getElementById("facts");
const look = async () => {
  try {
    const text = await (await fetch("/facts")).text();
    if (facts.innerHTML !== text) facts.innerHTML = text;
  } catch {
    facts.textContent = "cfid watch has ended: start it again and reload this page.";
  }
  setTimeout(look, 500);
};
look();

const answered = document.getElementById("answered");
const stop = document.getElementById("stop");
stop.addEventListener("click", async () => {
  answered.textContent = "stopping ...";
  try {
    const answer = await fetch("/stop", { method: "POST", headers: { "X-Cfid-Token": stop.dataset.token } });
    answered.textContent = answer.ok ? (await answer.json()).text
      : "NOT STOPPED: this page is of an earlier cfid watch. Reload it, or pull the battery.";
  } catch {
    answered.textContent = "NOT STOPPED: cfid watch has ended. Run cfid motors stop, or pull the battery.";
  }
});
"""

# Nothing is loaded from elsewhere, no text becomes a script, and no other page shows this one in a frame.
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


def page_html(gate: Gate) -> str:
    """Return the page, with a button that stops motors."""
    return _PAGE.replace("TOKEN", escape(gate.token))
