"""The pictures of a run's page, view.png and view_phone.png, and the film demo.webp, taken of a demo in a browser.

`python docs/pictures.py FOLDER` writes them there; it needs Chromium, and what the tests need.
"""

import base64
import io
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import threading
from itertools import pairwise

from PIL import Image
from playwright.sync_api import Page, sync_playwright

SCREEN, PHONE, MOVING = {"width": 1200, "height": 1270}, {"width": 390, "height": 844}, {"width": 1200, "height": 1040}
"""Size of the pages [px]."""

PUSHES = 10
"""The pictures are taken after so many pushes."""

FILM, LONGEST_MS, END_MS = (720, 624), 600, 4000
"""Size of the film [px]; how long one of its images is shown at most, and the last one."""

END_LOOKS = 40
"""The film goes on for this many looks, each of 50 ms, when the result is there."""


def picture(page: Page, file: pathlib.Path) -> None:
    """Take a picture, with fewer colours."""
    page.screenshot(path=file)
    Image.open(file).convert("RGB").quantize(128, dither=Image.Dither.NONE).save(file, optimize=True)


def filmed(moving: Page, screen: Page, phone: Page, folder: pathlib.Path) -> list[tuple[float, bytes]]:
    """The images of the film with their times [s], until the run is over; meanwhile the pictures are taken."""
    frames: list[tuple[float, bytes]] = []
    unanswered: list[int] = []

    def keep(frame: dict) -> None:
        frames.append((frame["metadata"]["timestamp"], base64.b64decode(frame["data"])))
        unanswered.append(frame["sessionId"])

    moving.locator("#drawing .weight").first.wait_for(timeout=120e3)  # not while the nodes still start
    cast = moving.context.new_cdp_session(moving)
    cast.on("Page.screencastFrame", keep)
    cast.send("Page.startScreencast", {"format": "png", "maxWidth": FILM[0], "maxHeight": FILM[1]})
    waiting = [(screen, folder / "view.png"), (phone, folder / "view_phone.png")]
    left = END_LOOKS
    while left > 0:
        left -= moving.locator("#result_page:not([hidden]), #now.lost").count()
        while unanswered:  # the next image comes when this one is answered
            cast.send("Page.screencastFrameAck", {"sessionId": unanswered.pop()})
        if waiting and screen.locator("#rows tr").count() >= PUSHES:
            picture(*waiting.pop())
        moving.wait_for_timeout(50)
    cast.send("Page.stopScreencast")
    return sorted(frames)


def main(folder: pathlib.Path) -> None:
    command = [sys.executable, "-m", "pushfric_core", "demo", "--headless", "--bag", "runs/first", "--view", "0"]
    with (
        tempfile.TemporaryDirectory() as here,
        sync_playwright() as playwright,
        subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=here) as demo,
    ):
        assert demo.stderr is not None
        url = next(line.split()[1] for line in demo.stderr if line.startswith("view: http"))
        threading.Thread(target=demo.stderr.read).start()  # so that it is never full
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), chromium_sandbox=os.geteuid() != 0)
        moving, screen = (browser.new_page(viewport=size) for size in (MOVING, SCREEN))
        phone = browser.new_page(viewport=PHONE, is_mobile=True, color_scheme="dark")
        for page in (moving, screen, phone):
            page.goto(url)
        frames = filmed(moving, screen, phone, folder)
        browser.close()
    if demo.returncode:
        sys.exit(f"the demo ended with {demo.returncode}")
    first, *others = [Image.open(io.BytesIO(frame)).convert("RGB").resize(FILM) for _, frame in frames]
    shown = [min(LONGEST_MS, 20 + round(1e3 * (after - before))) for (before, _), (after, _) in pairwise(frames)] + [END_MS]
    first.save(folder / "demo.webp", save_all=True, append_images=others, duration=shown, loop=0, quality=60, method=3)


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]))
