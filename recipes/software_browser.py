"""Start a Chromium that renders WebGL in software, so that pictures and timings of the page need no GPU."""

import os
import shutil
from pathlib import Path

from playwright.sync_api import Browser, Playwright

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")


def launch(driver: Playwright) -> Browser:
    """Start the browser of BROWSER_PATH, else the system's, else that of `playwright install`.

    Raises:
        FileNotFoundError: there is no browser.
    """
    installed = os.environ.get("BROWSER_PATH") or next(filter(None, map(shutil.which, NAMES)), None)
    executable = installed or driver.chromium.executable_path
    if not Path(executable).is_file():
        raise FileNotFoundError(f"no browser: install Debian's chromium (of {', '.join(NAMES)}) or set BROWSER_PATH")
    flags = [*FLAGS, "--no-sandbox"] if os.getuid() == 0 else list(FLAGS)
    return driver.chromium.launch(executable_path=executable, args=flags)
