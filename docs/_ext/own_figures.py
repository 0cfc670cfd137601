"""Pictures of the gallery that pyplot does not know: the package draws on figures of its own, without global state."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst, matplotlib_scraper


def drawn(value: Any, known: Collection[Figure]) -> Figure | None:
    """The figure that an example's last line gave, or drew on; None for one of pyplot's (``known``)."""
    figure = value.get_figure(root=True) if isinstance(value, Artist) else None
    return figure if isinstance(figure, Figure) and figure not in known else None


def scraper(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any], **options: Any) -> str:
    """Figures of pyplot, and the one that the block's last line gave."""
    known = [plt.figure(number) for number in plt.get_fignums()]  # now: the gallery's scraper closes them
    found = str(matplotlib_scraper(block, block_vars, gallery_conf, **options))
    names = block_vars["example_globals"]
    figure = drawn(names.get("___"), known)
    names["___"] = None  # a later block without a value of its own does not show it again
    if figure is None:
        return found
    path = str(next(block_vars["image_path_iterator"]))
    figure.savefig(path, dpi=150)
    return found + str(figure_rst([path], gallery_conf["src_dir"]))
