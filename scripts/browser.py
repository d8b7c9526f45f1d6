"""Pictures of HTML pages by Chromium, over the pipe of its developer tools.

Needs no package: messages are JSON, each ended by a zero byte.
"""

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any

WINDOW = 1100, 1400
"""Width and height of the window, in pixels of the page."""
SCALE = 2
"""Pixels of a picture for one of the page."""
WAIT = 60.0
"""Seconds until a page must have answered."""


class MissingProgramError(RuntimeError):
    """No browser is there."""


PROGRAM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
"""Path of the browser; None without one."""


class Page:
    """A browser that nobody sees, with one HTML file at a time.

    Raises:
        MissingProgramError: without Chromium or Chrome.
    """

    def __init__(self) -> None:
        if PROGRAM is None:
            raise MissingProgramError("pictures of pages need Chromium, which is not there")
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        words = ["--headless", "--no-sandbox", "--no-first-run", "--hide-scrollbars"]
        words += ["--disable-background-networking", "--enable-unsafe-swiftshader"]
        words += ["--remote-debugging-pipe", f"--user-data-dir={self._profile.name}"]
        asked, self._write = os.pipe()
        self._read, told = os.pipe()

        def numbered() -> None:
            """The browser reads from descriptor 3 and writes to 4."""
            os.dup2(asked, 3)
            os.dup2(told, 4)

        self._run = subprocess.Popen(
            [PROGRAM, *words], pass_fds=(3, 4), preexec_fn=numbered, stderr=subprocess.DEVNULL
        )
        os.close(asked)
        os.close(told)
        self._number, self._rest, self._session = 0, b"", ""
        target = self._ask("Target.createTarget", url="about:blank")["targetId"]
        attached = self._ask("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        self._ask(
            "Emulation.setDeviceMetricsOverride",
            width=WINDOW[0],
            height=WINDOW[1],
            deviceScaleFactor=SCALE,
            mobile=False,
        )

    def open(self, file: Path, address: str = "") -> None:
        """Open a file, in the place of the one before.

        Args:
            file: the page.
            address: what follows ``#``.
        """
        self._ask("Page.navigate", url="about:blank")  # else only the address may change
        uri = file.resolve().as_uri() + (f"#{address}" if address else "")
        self._ask("Page.navigate", url=uri)
        self.wait_for(
            "location.protocol === 'file:' && document.readyState === 'complete' "
            "&& document.body !== null"
        )

    def __enter__(self) -> "Page":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._run.terminate()
        self._run.wait()
        os.close(self._read)
        os.close(self._write)
        self._profile.cleanup()

    def _ask(self, method: str, **arguments: Any) -> dict[str, Any]:
        """Result of one call; events in between are passed over."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": arguments}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]

    def _next(self) -> dict[str, Any]:
        """The next message of the browser."""
        while b"\0" not in self._rest:
            got = os.read(self._read, 1 << 20)
            if not got:
                raise RuntimeError("the browser has ended")
            self._rest += got
        text, _, self._rest = self._rest.partition(b"\0")
        return json.loads(text)

    def run(self, script: str) -> Any:
        """Value of an expression of JavaScript in the page; a promise is awaited."""
        found = self._ask(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in found:
            raise RuntimeError(f"{script}: {found['exceptionDetails']}")
        return found["result"].get("value")

    def wait_for(self, script: str) -> None:
        """Wait until an expression is true, and then until the page has drawn.

        Raises:
            TimeoutError: after :data:`WAIT` seconds.
        """
        end = time.monotonic() + WAIT
        while not self.run(script):
            if time.monotonic() > end:
                raise TimeoutError(f"the page never came to: {script}")
            time.sleep(0.1)
        self.run("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def picture(self, path: Path, part: str = "", height: float | None = None) -> Path:
        """Write the page, or one element of it, as a PNG.

        Args:
            path: file of the picture.
            part: selector of the element; the whole page without.
            height: of what is shown from its top, in pixels of the page; all of it without.
        """
        box = self.run(
            f"(() => {{ const part = document.querySelector({part or 'body'!r}); "
            "const b = part.getBoundingClientRect(); "
            "return [b.x + scrollX, b.y + scrollY, b.width, b.height]; })()"
        )
        if not part:
            box = [0, 0, self.run("innerWidth"), self.run("document.documentElement.scrollHeight")]
        if height is not None:
            box[3] = min(box[3], height)
        clip = dict(zip(("x", "y", "width", "height"), box, strict=True)) | {"scale": 1}
        shot = self._ask("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(shot["data"]))
        return path
