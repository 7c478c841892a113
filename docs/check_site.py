"""Open each page of the built site in Chromium and report faults.

`python docs/check_site.py [--whole] [SITE]` (by default docs/_build) opens each page at three
window widths in the light theme, and at a laptop's width in the dark theme. The many pages of the
reference are opened at the widths of a phone and a laptop only. With --whole each page is opened at
all widths in both themes. The script prints these faults and exits with 1:

- errors in the console
- bodies wider than the window
- content wider than the column of an article that does not scroll; on a laptop also code and tables
  that must scroll, but not the output of notebooks
- links to pages or anchors that do not exist
- a search that does not find PhongBRDF

It needs the extra `pages`, and Chromium, whose path is in the environment variable CHROMIUM. The
pages are served and loaded from this machine only.
"""

import functools
import os
import re
import sys
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote, urldefrag, urljoin

from playwright.sync_api import sync_playwright

WIDTHS = (360, 1366, 1920)  # CSS pixels: a phone, a laptop, a desk
VIEWS = (*((width, "light") for width in WIDTHS), (WIDTHS[1], "dark"))
VIEWS_OF_REFERENCE = VIEWS[:2]
WHOLE = [(width, scheme) for scheme in ("light", "dark") for width in WIDTHS]
WIDER = """() => [document.documentElement.scrollWidth, window.innerWidth]"""
# Find content of the article, except the theme's scroller, that extends beyond the article or is
# clipped by its own box, and is not in a scrolling box. On a laptop, code and tables must not need
# to scroll either.
CUT = """wide => {
    const article = document.querySelector('.bd-article-container')
    if (!article) return []
    const scrolls = e => ['auto', 'scroll'].includes(getComputedStyle(e).overflowX)
    const within = e => e !== article && (scrolls(e.parentElement) && e.parentElement !== article
        || within(e.parentElement))
    const seen = Math.min(window.innerWidth, article.getBoundingClientRect().right)
    return [...article.querySelectorAll('*')].filter(e => {
        const box = e.getBoundingClientRect(), inside = within(e)
        const hidden = box.width < 2 || !e.checkVisibility()
        const more = e.scrollWidth > e.clientWidth + 1
        const cut = getComputedStyle(e).overflowX === 'hidden' && more && !inside
        const long = wide && more && scrolls(e) && !e.closest('.cell_output')
        return !hidden && (!inside && box.right > seen + 1 || cut || long)
    }).slice(0, 1).map(e => `${e.tagName} ${e.className}: ${e.textContent.trim().slice(0, 60)}`)
}"""


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


def pages(site):
    """Return all pages except the theme's templates."""
    return [page for page in sorted(site.rglob("*.html")) if "_static" not in page.parts]


def places(page):
    """Return the anchors of a page, the targets of links."""
    return set(re.findall(r'\b(?:id|name)="([^"]+)"', page.read_text("utf-8")))


def dead_links(site):
    """Yield (page, link) for links inside the site whose page or anchor does not exist."""
    known = {page: places(page) for page in pages(site)}
    for page in known:
        for link in set(re.findall(r'<a\b[^>]*\bhref="([^"]+)"', page.read_text("utf-8"))):
            if re.match(r"[a-z]+:|//", link):
                continue
            path, place = urldefrag(urljoin(page.as_uri(), link.replace("&amp;", "&")))
            target = Path(unquote(path.partition("?")[0]).removeprefix("file://"))
            target = target / "index.html" if target.is_dir() else target
            lost = place and target in known and unquote(place) not in known[target]
            if lost or not target.exists():
                yield page, link


def opened(browser, site, root, *, whole):
    """Open the pages and yield their faults, one sentence each."""
    window = browser.new_page()
    window.route("**/*", lambda r: r.continue_() if r.request.url.startswith(root) else r.abort())
    errors = []
    foreign = re.compile("ERR_FAILED|ERR_BLOCKED|is not defined.*MathJax|require is not defined")
    window.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
    window.on("pageerror", lambda e: errors.append(str(e)))
    for page in pages(site):
        name = page.relative_to(site).as_posix()
        errors.clear()
        window.set_viewport_size({"width": WIDTHS[1], "height": 900})
        window.goto(f"{root}/{name}")
        window.add_style_tag(content="* { transition: none !important }")  # sizes hold at once
        usual = VIEWS_OF_REFERENCE if name.startswith("reference/") else VIEWS
        for width, scheme in WHOLE if whole else usual:
            window.emulate_media(color_scheme=scheme)
            window.set_viewport_size({"width": width, "height": 900})
            wide, seen = window.evaluate(WIDER)
            if wide > seen:
                yield f"{name}: {wide} wide at {width}, {scheme}"
            for which in window.evaluate(CUT, width >= WIDTHS[1]):
                yield f"{name}: cut at {width}, {scheme}: {which}"
        yield from (f"{name}: {error}" for error in errors if not foreign.search(error))
    window.goto(f"{root}/search.html?q=PhongBRDF")
    window.wait_for_selector("#search-results li a", timeout=20_000)
    if "PhongBRDF" not in window.inner_text("#search-results"):
        yield "search does not find PhongBRDF"


def main():
    given = [argument for argument in sys.argv[1:] if argument != "--whole"]
    site = Path(given[0] if given else Path(__file__).parent / "_build").resolve()
    handler = functools.partial(Quiet, directory=str(site))
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    wrong = [f"{page.relative_to(site)}: dead link {link}" for page, link in dead_links(site)]
    with sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path=os.environ.get("CHROMIUM"), args=["--no-sandbox"]
        )
        root = f"http://127.0.0.1:{server.server_port}"
        wrong += opened(browser, site, root, whole="--whole" in sys.argv)
        browser.close()
    print(*wrong, f"{len(pages(site))} pages, {len(wrong)} faults", sep="\n")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
