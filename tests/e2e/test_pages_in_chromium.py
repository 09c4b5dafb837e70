"""Reports in a browser: quiet, nothing asked of the network, readable on a phone, in the dark and on paper."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import pytest

from errpipe.cli.app import main
from tests import screenshots

pytestmark = [
    pytest.mark.slow,
    pytest.mark.toolchain,
    pytest.mark.skipif(screenshots.browser() is None, reason="no chromium (apt-get install chromium)"),
]
MEASURE = """<script>addEventListener('load', () => {
  let smallest = 1e9;
  let cut = 0;
  for (const f of document.querySelectorAll('figure')) {
    cut = Math.max(cut, f.scrollWidth - f.clientWidth);
    f.focus();
    for (const t of f.querySelectorAll('svg text')) {
      const s = t.ownerSVGElement, k = s.getBoundingClientRect().width / s.viewBox.baseVal.width;
      smallest = Math.min(smallest, parseFloat(getComputedStyle(t).fontSize) * k);
    }
    f.blur();
  }
  document.body.dataset.cut = cut;
  for (const t of document.querySelectorAll('p, td, th, figcaption, span, code, a'))
    smallest = Math.min(smallest, parseFloat(getComputedStyle(t).fontSize));
  document.body.dataset.smallest = smallest;
  document.body.dataset.over = document.documentElement.scrollWidth - window.innerWidth;
  const light = c => { const v = c.match(/[\\d.]+/g).map(Number).map(x => x / 255).map(
    x => x <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);
    return 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2]; };
  const paper = light(getComputedStyle(document.body).backgroundColor);
  let contrast = 99;
  for (const t of document.querySelectorAll('p, td, th, h1, h2, figcaption, a, .figure span')) {
    const ink = light(getComputedStyle(t).color), high = Math.max(ink, paper), low = Math.min(ink, paper);
    contrast = Math.min(contrast, (high + 0.05) / (low + 0.05));
  }
  document.body.dataset.paper = paper;
  document.body.dataset.contrast = contrast;
  document.body.dataset.broken = [...document.querySelectorAll('nav a')].filter(
    a => !document.querySelector(a.getAttribute('href'))).length;
})</script>"""


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    top = tmp_path_factory.mktemp("pages")
    for name in ("laser-iso230", "diagnose-log", "drilled-plate"):
        assert main(["init", "--template", name, str(top / name)]) == 0
        assert main(["run", str(top / name / "pipeline.yaml"), "--out", str(top / name / "out")]) == 0
    return sorted(top.rglob("report.html"))


def measured(page: Path, folder: Path, *, dark: bool = False, script: str = MEASURE) -> dict[str, float]:
    """What the script finds on a phone of 390 px; dark: as a person sees it who prefers dark pages."""
    text = page.read_text(encoding="utf-8").replace("</head>", script + "</head>")
    text = text.replace("(prefers-color-scheme: dark)", "all") if dark else text
    copy = folder / "page.html"
    copy.write_text(text, encoding="utf-8")
    seen = screenshots.browse(copy, "--window-size=390,2000", "--dump-dom")
    assert "CONSOLE" not in seen.stderr
    return {key: float(value) for key, value in re.findall(r'data-(\w+)="([-\d.e]+)"', seen.stdout)}


def test_pages_on_a_phone_in_light_and_dark(pages: list[Path], tmp_path: Path) -> None:
    assert len(pages) == 3
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"""(src|href)=["']?(https?:)?//""", text), "something is asked of the network"
        for dark in (False, True):
            seen = measured(page, tmp_path, dark=dark)
            assert seen["smallest"] >= 9.0
            assert seen["over"] <= 0, "the page is wider than the phone"
            assert seen["cut"] <= 0, "a figure is cut at the edge before it is enlarged by a tap"
            assert seen["broken"] == 0, "the contents lead nowhere"
            assert seen["contrast"] >= 4.5, "WCAG 2.1, 1.4.3"
            assert (seen["paper"] < 0.2) == dark


def split_cells(page: Path, folder: Path) -> list[str]:
    """Cells of tables that begin on one sheet of A4 and end on another."""
    pypdf = pytest.importorskip("pypdf", reason="reads the printed pages")
    number = itertools.count()

    def marked(cell: re.Match[str]) -> str:
        k = next(number)
        return f"{cell[1]}A{k}A {cell[2]} Z{k}Z</td>"

    text = re.sub(r"(<td[^>]*>)(.*?)</td>", marked, page.read_text(encoding="utf-8"), flags=re.S)
    (folder / "print.html").write_text(text, encoding="utf-8")
    pdf = folder / "page.pdf"
    screenshots.browse(folder / "print.html", f"--print-to-pdf={pdf}", "--no-pdf-header-footer")
    sheets = [sheet.extract_text() for sheet in pypdf.PdfReader(pdf).pages]
    top, end = ({k: s for s, t in enumerate(sheets) for k in re.findall(mark, t)} for mark in (r"A(\d+)A", r"Z(\d+)Z"))
    assert len(top) > 20 and len(sheets) > 1 and top.keys() == end.keys()
    return [k for k in top if top[k] != end[k]]


def test_no_row_is_split_between_two_sheets(pages: list[Path], tmp_path: Path) -> None:
    for page in pages:
        assert split_cells(page, tmp_path) == []


def test_a_row_that_is_split_is_seen(pages: list[Path], tmp_path: Path) -> None:
    """The fault planted: rows of forty lines that may break."""
    text = pages[-1].read_text(encoding="utf-8").replace("break-inside: avoid", "break-inside: auto")
    text = re.sub(r"<td>([^<]{3,})</td>", lambda m: f"<td>{'<br>'.join([m[1]] * 40)}</td>", text)
    page = tmp_path / "tall.html"
    page.write_text(text, encoding="utf-8")
    assert split_cells(page, tmp_path)


def test_the_pictures_are_taken(tmp_path: Path) -> None:
    screenshots.take(tmp_path)
    for name in screenshots.PICTURES:
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
