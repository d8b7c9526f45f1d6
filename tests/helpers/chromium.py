"""Chromium without a window: pages as they were written, moved by their sliders."""

import json
import os
import shutil
import signal
import subprocess

from processes import WAIT

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
OPTIONS = (
    "--headless --no-sandbox --disable-gpu --disable-background-networking --no-first-run "
    "--enable-unsafe-swiftshader --remote-debugging-pipe"
).split()
SHELL = 'exec 3<&"$1" 4>&"$2"; shift 2; exec "$@"'
"""Chromium reads orders from the file 3 and writes answers to the file 4."""
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


class Browser:
    """A process of Chromium, with one page at a time.

    Args:
        folder: folder of its profile.
    """

    def __init__(self, folder):
        asked, orders = os.pipe()
        answers, told = os.pipe()
        words = ["bash", "-c", SHELL, "bash", str(asked), str(told), CHROMIUM, *OPTIONS]
        words += [f"--user-data-dir={folder}", "about:blank"]
        self.process = subprocess.Popen(
            words,
            pass_fds=(asked, told),
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        os.close(asked), os.close(told)
        self.orders, self.answers = os.fdopen(orders, "wb", 0), os.fdopen(answers, "rb", 0)
        self.rest, self.number, self.session = b"", 0, None
        (target,) = [
            item["targetId"]
            for item in self.ask("Target.getTargets")["targetInfos"]
            if item["type"] == "page"
        ]
        asked = {"targetId": target, "flatten": True}
        self.session = self.ask("Target.attachToTarget", **asked)["sessionId"]
        self.ask("Page.enable")

    def ask(self, method, **given):
        """The result of an order of the DevTools."""
        self.number += 1
        order = {"id": self.number, "method": method, "params": given}
        order |= {"sessionId": self.session} if self.session else {}
        self.orders.write(json.dumps(order).encode() + b"\0")
        while True:
            message = self._next()
            if message.get("id") == self.number:
                assert "error" not in message, message
                return message["result"]

    def _next(self):
        while b"\0" not in self.rest:
            got = self.answers.read(1 << 20)
            assert got, "chromium has ended"
            self.rest += got
        message, _, self.rest = self.rest.partition(b"\0")
        return json.loads(message)

    def value(self, program):
        """The value of an expression on the page, or of its promise."""
        given = {"awaitPromise": True, "returnByValue": True, "timeout": 1000 * WAIT}
        told = self.ask("Runtime.evaluate", expression=program, **given)
        assert "exceptionDetails" not in told, told["exceptionDetails"]
        return told["result"].get("value")

    def open(self, target):
        """Open a file, and wait until its page has its kernel."""
        self.ask("Page.navigate", url="about:blank")
        self.ask("Page.navigate", url=target.as_uri())
        self.value(READY)
        assert not self.value('document.getElementById("wrong").textContent')

    def played(self, target, points):
        """What a page computes from the address of the first point on, by its sliders.

        Runs of answers: one, or with a history one for each of its beginnings, from rest on.
        """
        self.open(target)
        return self.value(f"{PLAY}({json.dumps([list(map(float, point)) for point in points])})")

    def close(self):
        """End the process, and those that it started."""
        os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self.orders.close(), self.answers.close()
