"""A page in a headless browser: a script writes its result into the title."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path
from typing import Any

import pytest

_WIDE = """const wide = [...document.querySelectorAll("main *")].filter(e => e.getBoundingClientRect().right > innerWidth + 1);
return {inner: innerWidth, whole: document.documentElement.scrollWidth, wide: wide.length};"""
_NARROWEST = 500  # px: of a headless browser's window; a frame is narrower


def look(page: str, script: str, width: int, folder: Path) -> Any:
    """Run the body of a function in a page and give what it returns; no console errors may be there."""
    script_tag = f"<script>document.title = JSON.stringify((() => {{ {script} }})())</script>"
    whole = page.replace("<details", "<details open").replace("</body>", f"{script_tag}</body>")
    path = folder / "page.html"
    path.write_text(whole, encoding="utf-8")
    if width < _NARROWEST:
        frame = folder / "frame.html"
        frame.write_text(
            f'<title>?</title><iframe src="page.html" style="width:{width}px;height:900px;border:0"></iframe>'
            "<script>onload = () => { document.title = frames[0].document.title }</script>"
        )
        path = frame
    done = subprocess.run(
        [_browser(), "--headless", "--no-sandbox", "--disable-gpu", "--allow-file-access-from-files", "--enable-logging=stderr",
         f"--window-size={max(width, _NARROWEST)},1000", "--dump-dom", path.as_uri()],
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert "CONSOLE" not in done.stderr, done.stderr
    return json.loads(unescape(re.search(r"<title>(.*?)</title>", done.stdout).group(1)))


def assert_fits(page: str, width: int, folder: Path) -> None:
    """Nothing is wider than the window."""
    found = look(page, _WIDE, width, folder)
    assert found["inner"] == width and found["whole"] <= width and found["wide"] == 0, found


def sheets(page: str, folder: Path) -> int:
    """How many sheets of paper a page takes, with everything opened."""
    path, printed = folder / "printed.html", folder / "printed.pdf"
    path.write_text(page, encoding="utf-8")
    subprocess.run(
        [_browser(), "--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer", f"--print-to-pdf={printed}",
         path.as_uri()],
        capture_output=True, timeout=60, check=True,
    )  # fmt: skip
    return len(re.findall(rb"/Type\s*/Page\b", printed.read_bytes()))


def _browser() -> str:
    found = next((b for b in ("chromium", "chromium-browser", "google-chrome") if shutil.which(b)), None)
    if found is None:
        pytest.skip("no Chromium here")
    return found
