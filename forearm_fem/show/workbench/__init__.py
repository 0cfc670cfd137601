"""One HTML page in which the reduced model runs: waves on the arm to see, aim and change; no server, no network.

::

    write_workbench("results/thesis", "waves.html")     # open it in any browser, give it to anyone
    view("results/thesis")                              # the same in a notebook

Python chooses what goes into the page (``content``, ``field``, ``flat``), packs it (``packed``) and joins the front
end's modules in ``page/`` to one script (``bundle``). These repeat the device's loop, the renderers and S in
JavaScript; the tests hold both against each other.
"""

from .bundle import View, page_of, view, write_workbench
from .content import content_of

__all__ = ["View", "content_of", "page_of", "view", "write_workbench"]
