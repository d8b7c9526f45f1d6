"""Chromium without a window: pages as they were written, moved by their sliders."""

import json
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "scripts"))
from browser import PROGRAM as CHROMIUM  # noqa: F401
from browser import Page

READY = """new Promise((done) => {
  const ask = () => {
    if (window.page || document.getElementById("wrong").textContent) done(null);
    else setTimeout(ask, 5);
  };
  document.readyState === "complete" ? ask() : addEventListener("load", ask);
})"""
"""Waits for a page that has its kernel."""
PLAY = """(async (points) => {
  const { model, marching, tree } = window.page, runs = [[]];
  const frame = () =>
    new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
  const keep = (answer) => {
    const rows = Object.entries(answer).map(([name, value]) =>
      [name, ArrayBuffer.isView(value) ? [...value] : value]);
    runs.at(-1).push({ ...Object.fromEntries(rows), outputs: model.outputs(answer) });
  };
  let inside = 0; // one method calls the other
  const watch = (of, name, kept) => {
    const own = of[name].bind(of);
    of[name] = (...asked) => {
      inside += 1;
      const given = own(...asked);
      inside -= 1;
      if (!inside) kept(given);
      return given;
    };
  };
  if (marching) {
    watch(marching, "begun", (states) => { runs.push([]); states.forEach(keep); });
    watch(marching, "went", (states) => states.forEach(keep));
  } else watch(model, "solve", keep);
  const address = new URLSearchParams(tree.names.map((name, k) => [name, points[0][k]]));
  const there = new Promise((done) => addEventListener("hashchange", done, { once: true }));
  location.hash = `#${address}`;
  await there;
  await frame();
  const sliders = [...document.querySelectorAll("#sliders input[type=range]")];
  for (const point of points.slice(1)) {
    sliders.forEach((slider, k) => {
      slider.value = point[k];
      slider.dispatchEvent(new Event("input", { bubbles: true }));
    });
    await frame();
  }
  const cells = (row) => [...row.children].map((cell) => cell.textContent);
  return { runs: runs.filter((run) => run.length), missing: tree.missing,
    names: tree.outputs.map(({ name }) => name),
    wrong: document.getElementById("wrong").textContent,
    numbers: [...document.querySelectorAll("#numbers tr")].map(cells) };
})"""
"""Watches what a page computes while its sliders are moved; numbers have all digits."""


class Browser(Page):
    """A page that is moved by its sliders."""

    def played(self, target, points):
        """What a page computes from the address of the first point on, by its sliders.

        Runs of answers: one, or with a history one for each of its beginnings, from rest on.
        """
        self.open(target)
        self.run(READY)
        assert not self.run('document.getElementById("wrong").textContent')
        return self.run(f"{PLAY}({json.dumps([list(map(float, point)) for point in points])})")
