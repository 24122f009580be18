"""What is added to the single page: a panel with each query, its reason, stages and confidence, or
with the states of a robot."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from html import escape
from string import Template

from .pictures import DARK, GREEN, ORANGE, RED
from .results import Outcome, Shown

_COLOURS: dict[Outcome, str] = {"found": GREEN, "refused": ORANGE, "false": RED}

LEGEND = (
    "Dots: queries found (green), refused (orange), false (red). Cloud: on the map (green), not on "
    "it (red). Upright green lines: matches that agree."
)
ROBOT_LEGEND = (
    "Its path: localized (green), candidate or degraded (orange); the large dot is its end."
)
_STYLE = Template("""
<style>
#segloc { position: fixed; top: 1em; right: 1em; z-index: 900; width: 23em; max-width: 40vw;
  max-height: 80vh; overflow-y: auto; background: #fffffff2; color: $dark;
  border-radius: 6px; padding: .8em 1em;
  font: 13px/1.4 system-ui, sans-serif; box-shadow: 0 1px 8px #0003 }
#segloc select { width: 100%; font: inherit } #segloc > b { display: block; margin: .6em 0 .3em }
#segloc p { margin: .3em 0 .6em } #segloc td { padding: .1em 0; vertical-align: top }
#segloc table { border-collapse: collapse; border-top: 1px solid #0002; width: 100% }
#segloc td:first-child { padding-right: .7em; white-space: nowrap; opacity: .75 }
#segloc .parts td:first-child { text-align: right; font-variant-numeric: tabular-nums }
#segloc small { display: block; border-top: 1px solid #0002; margin-top: .5em; padding-top: .4em }
</style>
""").substitute(dark=DARK)
# The page's player shows each query for some seconds: its slider tells the time, and its field
# takes one.
_PANEL = Template("""
<div id="segloc"><select aria-label="query"></select><b></b><p></p><table></table>
<b>confidence, in log-odds</b><table class="parts"></table><small>$legend</small></div>
<script>
(() => {
  const queries = $queries, seconds = $seconds;
  const [box, head, said, stages, title, parts] =
    ["select", "b", "p", "table", "p ~ b", ".parts"].map((name) =>
      document.querySelector("#segloc > " + name));
  const fill = (table, rows) => table.replaceChildren(...rows.map((row) => {
    const line = document.createElement("tr");
    row.forEach((text) => line.insertCell().textContent = text);
    return line;
  }));
  queries.forEach((q, k) => box.add(new Option(q.index + ": " + q.outcome, k)));
  let shown = -1;
  const show = (k) => {
    if (k === shown || !queries[k]) return;
    shown = k;
    const q = queries[k];
    box.value = k;
    head.textContent = q.index + ": " + q.outcome;
    head.style.color = q.colour;
    said.textContent = q.said;
    fill(stages, q.stages);
    fill(parts, q.parts);
    title.hidden = parts.hidden = !q.parts.length;
  };
  const time = () => document.querySelector("[role=slider]")?.getAttribute("aria-valuenow");
  setInterval(() => {
    const now = time();
    if (now != null) show(Math.min(queries.length - 1, Math.floor(Number(now) / seconds + 1e-6)));
  }, 150);
  box.addEventListener("change", () => {
    const field = document.querySelector("input[type=text], input[inputmode]");
    if (!field) return show(Number(box.value));
    const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, "value").set;
    field.focus();
    set.call(field, String(seconds * (Number(box.value) + 0.5)));
    field.dispatchEvent(new Event("input", { bubbles: true }));
    field.dispatchEvent(new Event("change", { bubbles: true }));
    field.blur();
  });
  show(0);
})();
</script>
""")


def with_panel(page: str, queries: Sequence[Shown], seconds: float) -> str:
    """A page of viser's player with a panel, for queries that are shown so many seconds each."""
    told = [
        {
            "index": query.index,
            "outcome": query.outcome,
            "colour": _COLOURS[query.outcome],
            "said": query.said if seen is None else seen.verdict,
            "stages": [] if seen is None else [line.split(": ", 1) for line in seen.stages],
            "parts": [] if seen is None else [line.split(" ", 1) for line in seen.parts],
        }
        for query in queries
        for seen in (query.seen,)
    ]
    text = json.dumps(told).replace("<", "\\u003c")  # no name of a query ends the script
    panel = _PANEL.substitute(queries=text, seconds=seconds, legend=LEGEND)
    return _with(page, panel)


def with_states(page: str, states: Sequence[str]) -> str:
    """A page of where a robot was, with how often it was in which state."""
    rows = "".join(
        f"<tr><td>{escape(state)}</td><td>{count}</td></tr>"
        for state, count in Counter(states).most_common()
    )
    told = f"<b>{len(states)} scans</b><table>{rows}</table><small>{ROBOT_LEGEND}</small>"
    return _with(page, f'<div id="segloc">{told}</div>')


def _with(page: str, panel: str) -> str:
    head, end, tail = page.rpartition("</body>")
    return f"{head}{_STYLE}{panel}{end}{tail}" if end else f"{page}{_STYLE}{panel}"
