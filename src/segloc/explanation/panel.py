"""What is added to the single page: a panel with each query, its reason, stages and confidence."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from string import Template

from ..pictures import DARK, GREEN, ORANGE, RED
from .results import Outcome, Shown

_COLOURS: dict[Outcome, str] = {"found": GREEN, "refused": ORANGE, "false": RED}

# The page's player shows each query for some seconds: its slider tells the time, and its field
# takes one.
_PANEL = Template("""
<style>
#segloc { position: fixed; top: 1em; right: 1em; z-index: 900; width: 19em; max-height: 78vh;
  overflow-y: auto; background: #fffffff2; color: $dark; border-radius: 6px; padding: .8em 1em;
  font: 13px/1.45 system-ui, sans-serif; box-shadow: 0 1px 8px #0003 }
#segloc select { width: 100%; font: inherit } #segloc ul { padding-left: 1.2em; margin: .4em 0 }
#segloc b { display: block; margin: .6em 0 .3em }
</style>
<div id="segloc"><select aria-label="query"></select><b></b><p></p><ul></ul></div>
<script>
(() => {
  const queries = $queries, seconds = $seconds;
  const [box, head, said, lines] =
    ["select", "b", "p", "ul"].map((name) => document.querySelector("#segloc " + name));
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
    lines.replaceChildren(...q.lines.map((text) => {
      const item = document.createElement("li");
      item.textContent = text;
      return item;
    }));
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
            "said": query.said if query.seen is None else query.seen.verdict,
            "lines": [] if query.seen is None else list(query.seen.lines),
        }
        for query in queries
    ]
    text = json.dumps(told).replace("<", "\\u003c")  # no name of a query ends the script
    panel = _PANEL.substitute(queries=text, seconds=seconds, dark=escape(DARK))
    head, end, tail = page.rpartition("</body>")
    return f"{head}{panel}{end}{tail}" if end else f"{page}{panel}"
