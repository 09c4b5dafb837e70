"""Reports in a browser: no console message, nothing asked of the network, readable on a phone, printed to PDF."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from errpipe.cli.app import main

BROWSER = next((found for n in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(n))), None)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.toolchain,
    pytest.mark.skipif(BROWSER is None, reason="no chromium (apt-get install chromium)"),
]
MEASURE = """<script>addEventListener('load', () => {
  let smallest = 1e9;
  for (const t of document.querySelectorAll('svg text')) {
    const s = t.ownerSVGElement, k = s.getBoundingClientRect().width / s.viewBox.baseVal.width;
    smallest = Math.min(smallest, parseFloat(getComputedStyle(t).fontSize) * k);
  }
  for (const t of document.querySelectorAll('p, td, th, figcaption, span, code, a'))
    smallest = Math.min(smallest, parseFloat(getComputedStyle(t).fontSize));
  document.body.dataset.smallest = smallest;
  document.body.dataset.over = document.documentElement.scrollWidth - window.innerWidth;
})</script>"""


def browse(page: Path, *options: str) -> subprocess.CompletedProcess[str]:
    line = [
        str(BROWSER),
        "--headless=new",
        "--no-sandbox",
        "--disable-gpu",
        "--hide-scrollbars",
        "--enable-logging=stderr",
        *options,
    ]
    return subprocess.run([*line, page.as_uri()], capture_output=True, text=True, timeout=120, check=True)


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    top = tmp_path_factory.mktemp("pages")
    for name in ("laser-iso230", "diagnose-log"):
        assert main(["init", "--template", name, str(top / name)]) == 0
        assert main(["run", str(top / name / "pipeline.yaml"), "--out", str(top / name / "out")]) == 0
    return sorted(top.rglob("report.html"))


def test_pages(pages: list[Path], tmp_path: Path) -> None:
    assert len(pages) == 2
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"""(src|href)=["']?(https?:)?//""", text), "something is asked of the network"
        copy = tmp_path / f"{page.parent.name}.html"
        copy.write_text(text.replace("</head>", MEASURE + "</head>"), encoding="utf-8")
        seen = browse(copy, "--window-size=390,2000", "--dump-dom")
        assert "CONSOLE" not in seen.stderr
        assert float(re.search(r'data-smallest="([\d.]+)"', seen.stdout)[1]) >= 9.0
        assert int(re.search(r'data-over="(-?\d+)"', seen.stdout)[1]) <= 0, "the page is wider than the phone"
        browse(page, f"--print-to-pdf={tmp_path / 'page.pdf'}")
        assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF")
