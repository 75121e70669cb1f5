"""The picture of the README: `python docs/report.py` writes docs/report.png, with playwright and chromium.

The report of `pymc-features init --example building`: its verdict, and below it the draws and the response.
"""

import io
import os
import shutil
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from pymc_features import cli

WIDTH = 1200  # px


def screenshots(page: Path) -> list[bytes]:
    """What is above the warnings, and the section of draws and response."""
    with sync_playwright() as started:
        chromium = os.environ.get("CHROMIUM") or shutil.which("chromium")
        browser = started.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        opened = browser.new_page(viewport={"width": WIDTH, "height": 900})
        opened.goto(page.as_uri())
        opened.wait_for_selector("body[data-ready]")
        opened.wait_for_timeout(2000)  # until figures are drawn
        places = {
            words: opened.get_by_role("heading", name=words, exact=True).bounding_box()["y"]
            for words in ("Warnings", "Draws and response")
        }
        begins = (0, places["Draws and response"] - 24)
        heights = (places["Warnings"] - 24, 820)
        clips = [{"x": 0, "y": y, "width": WIDTH, "height": h} for y, h in zip(begins, heights, strict=True)]
        return [opened.screenshot(full_page=True, clip=clip) for clip in clips]


def write(path: Path) -> None:
    """Run the example and write the picture, in few colours."""
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        cli.main(["init", "--example", "building"])
        cli.main(["update", "update.toml"])
        shots = screenshots(Path("update-output/report.html").resolve())
        parts = [Image.open(io.BytesIO(shot)).convert("RGB") for shot in shots]
        os.chdir(path.parent)
    picture = Image.new("RGB", (WIDTH, sum(part.height for part in parts)))
    for i, part in enumerate(parts):
        picture.paste(part, (0, sum(one.height for one in parts[:i])))
    picture.quantize(128, dither=Image.Dither.NONE).save(path, optimize=True)


if __name__ == "__main__":
    write(Path(__file__).resolve().with_name("report.png"))
