"""Frames per second of the viewer with 200,000 points while it is turned.

Run it by hand: ``python tests/viz/frame_rate.py``.

A page is served to a headless chromium, which turns the view for eight seconds with synthetic drags
and sends back how often it drew and with which share of the points. Software rendering (no GPU) is
the worst case.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from http.server import BaseHTTPRequestHandler, HTTPServer
from urllib.parse import parse_qs, urlparse

import numpy as np

from skipnet.viz import html
from skipnet.viz.viewer import ViewedPose, ViewedScan, viewer

_TURNING = """<script>
const canvas = document.querySelector("canvas"), times = [];
const send = (kind, x) => canvas.dispatchEvent(new PointerEvent(kind,
  { pointerId: 1, clientX: x, clientY: 300 }));
canvas.setPointerCapture = () => {};
let x = 300; send("pointerdown", x);
const start = performance.now();
(function step(now) {
  times.push(now); send("pointermove", x += 3);
  if (performance.now() - start < 8000) requestAnimationFrame(step);
  else {
    const steps = times.slice(1).map((t, k) => t - times[k]).slice(2).sort((a, b) => a - b);
    const at = (share) => steps[Math.floor(share * steps.length)];
    fetch(`/result?frames=${steps.length}&median_ms=${at(0.5)}&slow_ms=${at(0.9)}`
      + `&share=${canvas.dataset.share}`);
  }
})(start);
</script>"""


def measure() -> dict[str, float]:
    """Median and slow time of a frame in milliseconds, frames, and the share of points drawn."""
    points_m = np.random.default_rng(0).uniform(-10, 10, (400_000, 3)) * [1, 1, 0.2]
    scans = [
        ViewedScan(name, points_m, tint)
        for name, tint in zip("ab", ("#D55E00", "#0072B2"), strict=True)
    ]
    page = html.page("test", viewer(scans, [ViewedPose("one", "one", [np.eye(4)] * 2)]), _TURNING)
    found: dict[str, float] = {}

    class Handler(BaseHTTPRequestHandler):
        """Serves the page and takes its answer."""

        def do_GET(self) -> None:
            """One of both."""
            query = parse_qs(urlparse(self.path).query)
            if self.path.startswith("/result"):
                found.update({name: float(values[0]) for name, values in query.items()})
            self.send_response(200)
            self.end_headers()
            self.wfile.write(page.encode())

        def log_message(self, format: str, *arguments: object) -> None:
            """Nothing."""

    server = HTTPServer(("127.0.0.1", 0), Handler)
    with tempfile.TemporaryDirectory() as profile:
        command = [
            shutil.which("chromium") or "chromium",
            "--headless=new",
            "--no-sandbox",
            "--use-gl=angle",
        ]
        command += [
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            f"--user-data-dir={profile}",
        ]
        command += ["--window-size=1366,768", f"http://127.0.0.1:{server.server_port}/"]
        with subprocess.Popen(command, stderr=subprocess.DEVNULL) as browser:
            while not found:
                server.handle_request()
            browser.terminate()
    return found


if __name__ == "__main__":
    print(measure())
