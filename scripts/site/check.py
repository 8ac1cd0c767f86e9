"""Check the built site: ``python -m scripts.site.check FOLDER``.

Links lead to files and anchors that are there; what pages load comes from the site itself, so that they work without a
network; addresses elsewhere are well-formed.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADS = {
    ("link", "href"),
    ("script", "src"),
    ("img", "src"),
    ("source", "src"),
    ("video", "src"),
    ("iframe", "src"),
}
METADATA = {"canonical", "next", "prev"}  # links that tell something and load nothing
NOT_FOUND = "404.html"  # its addresses start at the server's root


class Links(HTMLParser):
    """What a page refers to: ``(tag, address)``; and its anchors."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, str]] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        if "id" in given:
            self.anchors.add(given["id"])
        if tag == "a" and "name" in given:
            self.anchors.add(given["name"])
        for name in ("href", "src"):
            if name in given:
                loads = (tag, name) in LOADS and given.get("rel") not in METADATA
                (self.loaded.append(given[name]) if loads else self.found.append((tag, given[name])))


@cache
def links_of(page: Path) -> Links:
    """Read a page."""
    links = Links()
    links.feed(page.read_text(encoding="utf-8"))
    return links


def faults(site: Path) -> Iterator[str]:
    """Yield what is wrong in a site."""
    for page in sorted(site.rglob("*.html")):
        links, name = links_of(page), page.relative_to(site)
        for address in links.loaded:
            if urlsplit(address).scheme not in ("", "data") or address.startswith("//"):
                yield f"{name} loads {address} from elsewhere"
            elif page.name != NOT_FOUND and not address.startswith("data:") and not inside(page, address).is_file():
                yield f"{name} loads {address}, which is not there"
        for _, address in links.found:
            fault = None if page.name == NOT_FOUND else fault_of(page, address)
            if fault:
                yield f"{name}: {address} {fault}"
    for sheet in sorted(site.rglob("*.css")):
        for address in re.findall(r"url\(\s*['\"]?([^'\")]+)", sheet.read_text(encoding="utf-8")):
            if urlsplit(address).scheme not in ("", "data"):
                yield f"{sheet.relative_to(site)} loads {address} from elsewhere"


def fault_of(page: Path, address: str) -> str | None:
    """Return what is wrong with a link on a page, if something is."""
    parts = urlsplit(address)
    if parts.scheme == "mailto":
        return None
    if parts.scheme or parts.netloc:
        well_formed = parts.scheme in ("http", "https") and re.fullmatch(r"[\w-]+(\.[\w-]+)+(:\d+)?", parts.netloc)
        return None if well_formed else "is no address of a page"
    target = inside(page, address)
    if not target.is_file():
        return "leads nowhere"
    if parts.fragment and target.suffix == ".html" and unquote(parts.fragment) not in links_of(target).anchors:
        return "leads to an anchor that is not there"
    return None


def inside(page: Path, address: str) -> Path:
    """Return the file that an address on a page means."""
    path = unquote(urlsplit(address).path)
    target = (page.parent / path).resolve() if path else page
    return target / "index.html" if target.is_dir() else target


def main() -> None:
    """Print what is wrong and fail, or tell how much was looked at."""
    site = Path(sys.argv[1]).resolve()
    found = list(faults(site))
    for fault in found:
        print(fault, file=sys.stderr)
    pages = sorted(site.rglob("*.html"))
    count = sum(len(links_of(page).found) for page in pages)
    print(f"{len(pages)} pages, {count} links, {len(found)} faults: {site / 'index.html'}")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
