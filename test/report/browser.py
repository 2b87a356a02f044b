"""A headless Chromium that opens a page from disk: what it draws, says and asks for."""

from __future__ import annotations

import base64
import io
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image
from selenium import webdriver
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service

Picture = npt.NDArray[np.uint8]  # rows, columns, red green blue

# Two frames later what a change has asked for is drawn.
TWO_FRAMES = "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => done()));"


@dataclass(frozen=True)
class Box:
    """Of an element, in pixels of the page."""

    x: float
    y: float
    width: float
    height: float

    def at(self, across: float, down: float) -> tuple[float, float]:
        return self.x + across * self.width, self.y + down * self.height


class Page:
    def __init__(self, driver: webdriver.Chrome) -> None:
        self.driver = driver

    def command(self, name: str, **parameters: Any) -> Any:
        """Of the DevTools protocol."""
        return self.driver.execute_cdp_cmd(name, parameters)

    def run(self, script: str, *arguments: Any) -> Any:
        return self.driver.execute_script(script, *arguments)

    def open(self, path: Path) -> None:
        self.logs()
        self.driver.get(path.resolve().as_uri())
        self.wait()

    def wait(self) -> None:
        self.driver.execute_async_script(TWO_FRAMES)

    def resize(self, width: int, height: int) -> None:
        self.command("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        self.wait()

    def emulate(self, media: str, scheme: str) -> None:
        """Media "print", "screen"; scheme "light", "dark"."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.command("Emulation.setEmulatedMedia", media=media, features=features)
        self.wait()

    def box(self, selector: str) -> Box:
        script = """const box = document.querySelector(arguments[0]).getBoundingClientRect();
                    return [box.x + scrollX, box.y + scrollY, box.width, box.height];"""
        return Box(*self.run(script, selector))

    def picture(self, selector: str) -> Picture:
        box = self.box(selector)
        clip = {"x": box.x, "y": box.y, "width": box.width, "height": box.height, "scale": 1}
        return self.screenshot(clip)

    def screenshot(self, clip: dict[str, float] | None = None) -> Picture:
        """Of all of the page, or of a part."""
        data = self.command("Page.captureScreenshot", captureBeyondViewport=True, **({"clip": clip} if clip else {}))
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(data["data"]))).convert("RGB"))

    def mouse(self, kind: str, place: tuple[float, float], draws: bool = True, **parameters: Any) -> None:
        """Kind "mouseMoved", "mouseWheel", ...; the place is one of the page and has to be in the window."""
        left, top = self.run("return [scrollX, scrollY];")
        self.command("Input.dispatchMouseEvent", type=kind, x=place[0] - left, y=place[1] - top, **parameters)
        if draws:
            self.wait()

    def click(self, selector: str) -> None:
        self.run("document.querySelector(arguments[0]).click();", selector)
        self.wait()

    def scroll_to(self, selector: str) -> None:
        self.run("document.querySelector(arguments[0]).scrollIntoView({block: 'center'});", selector)
        self.wait()

    def processor_seconds(self) -> dict[int, float]:
        """Of each process of the browser so far."""
        seconds, parents = {}, {}
        for path in Path("/proc").glob("[0-9]*/stat"):
            try:
                fields = path.read_text().rpartition(")")[2].split()
            except OSError:  # it has ended
                continue
            pid = int(path.parent.name)
            parents[pid] = int(fields[1])
            seconds[pid] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        own = {self.driver.service.process.pid}
        while more := {pid for pid, parent in parents.items() if parent in own} - own:
            own |= more
        return {pid: seconds[pid] for pid in own if pid in seconds}

    def logs(self) -> tuple[list[str], list[str]]:
        """Errors of the console and addresses that were asked for, since the last call."""
        errors = [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]
        events = [json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance")]
        sent = [event["params"] for event in events if event["method"] == "Network.requestWillBeSent"]
        return errors, [request["request"]["url"] for request in sent]


@contextmanager
def chromium(webgl: bool = True) -> Iterator[Page]:
    """Draws in software, so that it needs no graphics card and no display."""
    options = Options()
    options.binary_location = "/usr/bin/chromium"
    drawing = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    for argument in [
        "--headless=new",
        "--window-size=1280,900",
        "--hide-scrollbars",
        "--disable-dev-shm-usage",
        "--force-color-profile=srgb",
        *(drawing if webgl else ["--disable-gpu", "--disable-3d-apis"]),
        *(["--no-sandbox"] if os.geteuid() == 0 else []),
    ]:
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(service=Service("/usr/bin/chromedriver"), options=options)
    try:
        driver.set_script_timeout(60)
        yield Page(driver)
    finally:
        driver.quit()
