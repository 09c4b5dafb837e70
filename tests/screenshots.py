"""The README's pictures: templates run, their reports photographed by headless Chromium (`make screenshots`)."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from errpipe.cli.app import main

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# Picture -> template, width and height of the window in CSS pixels.
PICTURES = {"report": ("laser-iso230", 900, 980)}
SETTINGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--enable-logging=stderr")


def browser() -> str | None:
    """The first Chromium on the path, or None."""
    return next((match for name in BROWSERS if (match := shutil.which(name))), None)


def browse(page: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """One visit of a page. Raises CalledProcessError where the browser fails, TimeoutExpired after two minutes."""
    line = [str(browser()), *SETTINGS, *options, page.as_uri()]
    return subprocess.run(line, capture_output=True, text=True, timeout=120, check=True)


def take(folder: Path) -> None:
    """Write every picture into a folder. Raises SystemExit where there is no browser or a template does not run."""
    if browser() is None:
        raise SystemExit("no chromium (apt-get install chromium)")
    with tempfile.TemporaryDirectory() as top:
        for name, (template, width, height) in PICTURES.items():
            work = Path(top) / name
            for line in (["init", "--template", template, str(work)], ["run", str(work / "pipeline.yaml")]):
                if main([*line, *(["--out", str(work / "out")] if line[0] == "run" else [])]):
                    raise SystemExit(f"{template} does not run")
            picture = folder / f"{name}.png"
            browse(work / "out/report/report.html", f"--window-size={width},{height}", f"--screenshot={picture}")


if __name__ == "__main__":
    take(Path(sys.argv[1]))
