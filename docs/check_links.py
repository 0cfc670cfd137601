"""Links of a built manual lead to files and anchors that exist: ``python docs/check_links.py docs/_build/html``."""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """Anchors, and links and pictures, of one page."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: set[str] = set()
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note what the tag names and what it refers to."""
        given = dict(attrs)
        self.anchors |= {v for k in ("id", "name") if (v := given.get(k))}
        self.links |= {v for k in ("href", "src") if (v := given.get(k))}


def broken(folder: Path) -> list[str]:
    """A line per link inside ``folder`` that leads nowhere; links to other hosts are not followed."""
    pages = {file.resolve(): Page(file) for file in sorted(folder.rglob("*.html"))}
    lines = []
    for file, page in pages.items():
        for link in sorted(page.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            anchor = unquote(parts.fragment)
            lost = not target.exists() or (anchor and target in pages and anchor not in pages[target].anchors)
            if lost:
                lines.append(f"{file.relative_to(folder.resolve())}: {link}")
    return lines


if __name__ == "__main__":
    found = broken(Path(sys.argv[1]))
    print("\n".join(found) or "no link is broken")
    sys.exit(bool(found))
